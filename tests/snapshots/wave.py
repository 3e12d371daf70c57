import numpy as np

from shpy.backend.numpy.lanes import select


def sin_strict(x):
    t = x.astype(np.float64)
    product = t * 0.3183098854497075
    near_k = product + 6755399441055744.0 - 6755399441055744.0
    near_f = t * 1.138005036539198e-18 + (t * 7.340831623126043e-10 + (product - near_k))
    t2 = np.abs(x)
    far = t2 >= 16777216.0
    f = near_f
    k = near_k.astype(np.float32)
    t3 = k
    if far.any():
        above = t2 >= 1125899900000000.0
        digit = select(above, np.float64(1.2841276625374931e-08), 0.3183098854497075)
        digit_2 = select(above, np.float64(8.076898927812296e-18), 7.340831623126043e-10)
        digit_3 = select(above, np.float64(1.2634130177915748e-26), 1.138005036539198e-18)
        above_2 = t2 >= 7.5557864e+22
        digit_4 = select(above_2, 1.468547768767099e-16, digit)
        digit_5 = select(above_2, 1.4188110080591198e-25, digit_2)
        digit_6 = select(above_2, 8.341433834304119e-35, digit_3)
        above_3 = t2 >= 5.0706024e+30
        digit_7 = select(above_3, 3.037013239734091e-24, digit_4)
        digit_8 = select(above_3, 5.090832185799798e-33, digit_5)
        digit_9 = select(above_3, 7.95005651784451e-42, digit_6)
        product_2 = t * digit_7
        rest = t * digit_8
        k_2 = product_2 + 6755399441055744.0 - 6755399441055744.0
        more = rest + 6755399441055744.0 - 6755399441055744.0
        left = product_2 - k_2 + (rest - more)
        last = left + 6755399441055744.0 - 6755399441055744.0
        f = select(far, t * digit_9 + (left - last), near_f)
        k = select(far, (k_2 - np.floor(k_2 * 0.5) * 2.0 + (more + last)).astype(np.float32), t3)
    half_2 = k * 0.5
    odd = half_2 != np.floor(half_2)
    z = f * f
    t4 = ((7.407082011743356e-07 * z + -2.187234610985848e-05) * z + 0.0004662860726569745) * z + -0.007370427288701782
    t5 = (((t4 * z + 0.08214588614421396) * z + -0.5992645292865307) * z + 2.5501640398760044) * z
    series = (t5 + -5.167712780049945) * z + 3.141592653589793
    size = (f * series).astype(np.float32)
    return select(odd, -size, size)


def wave(x, k, lanes):
    y = sin_strict(x) * k + 0.25  # test_numpy_text.py:23
    return select(y > 0.0, y, -k)  # test_numpy_text.py:24
