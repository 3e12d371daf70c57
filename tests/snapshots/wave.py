import numpy as np

from shpy.backends.numpy.lanes import select


def sin_strict(x):
    t = np.abs(x)
    near = select(t <= 1048576.0, x, x - x)
    k = near * 0.63661975 + 12582912.0 - 12582912.0
    product = k * 1.5707964
    k_high = k + 6442451000.0 - 6442451000.0
    k_low = k - k_high
    rest = k_high * 1.5708008 - product + k_high * -4.4107437e-06
    product_low = rest + k_low * 1.5708008 + k_low * -4.4107437e-06
    left = near - product
    t2 = -product_low
    sum_ = left + t2
    back = sum_ - left
    sum_low = left - (sum_ - back) + (t2 - back)
    product_2 = k * -4.371139e-08
    rest_2 = k_high * -4.3713953e-08 - product_2 + k_high * 2.5650593e-12
    product_low_2 = rest_2 + k_low * -4.3713953e-08 + k_low * 2.5650593e-12
    t3 = -product_2
    sum_2 = sum_ + t3
    back_2 = sum_2 - sum_
    sum_low_2 = sum_ - (sum_2 - back_2) + (t3 - back_2)
    lost = sum_low + sum_low_2 - product_low_2
    tail = lost - k * -1.7151245e-15
    high = sum_2 + tail
    low = tail - (high - sum_2)
    k_by_2 = k * 0.5
    pairs = np.floor(k_by_2)
    k_by_4 = pairs * 0.5
    odd = k_by_2 != pairs
    opposite = k_by_4 != np.floor(k_by_4)
    z = high * high
    z_by_2 = z * 0.5
    whole = 1.0 - z_by_2
    series = (z * 2.451498e-05 - 0.0013888152) * z + 0.041666664
    rest_3 = z * z * series - high * low
    cosine_rest = 1.0 - whole - z_by_2 + rest_3
    series_2 = ((z * 2.8502463e-06 - 0.00019855748) * z + 0.008333388) * z - 0.16666667
    sine_rest = high * (z * series_2) + low
    size = select(odd, whole + cosine_rest, high + sine_rest)
    return select(t < 0.00012207031, x, select(opposite, -size, size))


def wave(x, k, lanes):
    y = sin_strict(x) * k + 0.25  # test_numpy_text.py:23
    return select(y > 0.0, y, -k)  # test_numpy_text.py:24
