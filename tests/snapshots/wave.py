import numpy as np

from shpy.backends.numpy.lanes import select, vector


def payne_hanek(x):
    large = np.abs(x) >= 8.307675e+34
    scaled = select(large, x * 1.2621775e-29, x)
    digit = select(large, np.float32(1405.0), 0.0)
    digit_2 = select(large, np.float32(501.0), 163.0)
    digit_3 = select(large, np.float32(846.0), -104.0)
    digit_4 = select(large, np.float32(-575.0), 878.0)
    digit_5 = select(large, np.float32(-586.0), 1252.0)
    digit_6 = select(large, np.float32(662.0), 1045.0)
    digit_7 = select(large, np.float32(-1644.0), 672.0)
    digit_8 = select(large, np.float32(-956.0), -985.0)
    digit_9 = select(large, np.float32(-1788.0), 1405.0)
    large_2 = np.abs(scaled) >= 2.951479e+20
    scaled_2 = select(large_2, scaled * 3.5527137e-15, scaled)
    digit_10 = select(large_2, digit_5, digit)
    digit_11 = select(large_2, digit_6, digit_2)
    digit_12 = select(large_2, digit_7, digit_3)
    digit_13 = select(large_2, digit_8, digit_4)
    digit_14 = select(large_2, digit_9, digit_5)
    digit_15 = select(large_2, 501.0, digit_6)
    digit_16 = select(large_2, 846.0, digit_7)
    digit_17 = select(large_2, -575.0, digit_8)
    digit_18 = select(large_2, -586.0, digit_9)
    digit_19 = select(large_2, np.float32(662.0), 501.0)
    digit_20 = select(large_2, np.float32(-1644.0), 846.0)
    digit_21 = select(large_2, np.float32(-956.0), -575.0)
    large_3 = np.abs(scaled_2) >= 17592186000000.0
    scaled_3 = select(large_3, scaled_2 * 5.9604645e-08, scaled_2)
    digit_22 = select(large_3, digit_12, digit_10)
    digit_23 = select(large_3, digit_13, digit_11)
    digit_24 = select(large_3, digit_14, digit_12)
    digit_25 = select(large_3, digit_15, digit_13)
    digit_26 = select(large_3, digit_16, digit_14)
    digit_27 = select(large_3, digit_17, digit_15)
    digit_28 = select(large_3, digit_18, digit_16)
    digit_29 = select(large_3, digit_19, digit_17)
    digit_30 = select(large_3, digit_20, digit_18)
    digit_31 = select(large_3, digit_21, digit_19)
    large_4 = np.abs(scaled_3) >= 4294967300.0
    scaled_4 = select(large_4, scaled_3 * 0.00024414062, scaled_3)
    digit_32 = select(large_4, digit_23, digit_22)
    digit_33 = select(large_4, digit_24, digit_23)
    digit_34 = select(large_4, digit_25, digit_24)
    digit_35 = select(large_4, digit_26, digit_25)
    digit_36 = select(large_4, digit_27, digit_26)
    digit_37 = select(large_4, digit_28, digit_27)
    digit_38 = select(large_4, digit_29, digit_28)
    digit_39 = select(large_4, digit_30, digit_29)
    digit_40 = select(large_4, digit_31, digit_30)
    mantissa = scaled_4 * 9.536743e-07
    first = mantissa + 12582912.0 - 12582912.0
    rest = (mantissa - first) * 4096.0
    second = rest + 12582912.0 - 12582912.0
    third = (rest - second) * 4096.0
    column = first * digit_34 + second * digit_33 + third * digit_32
    column_2 = first * digit_35 + second * digit_34 + third * digit_33
    column_3 = first * digit_36 + second * digit_35 + third * digit_34
    column_4 = first * digit_37 + second * digit_36 + third * digit_35
    column_5 = first * digit_38 + second * digit_37 + third * digit_36
    column_6 = first * digit_39 + second * digit_38 + third * digit_37
    column_7 = first * digit_40 + second * digit_39 + third * digit_38
    carry = column_7 * 0.00024414062 + 12582912.0 - 12582912.0
    place = column_7 - carry * 4096.0
    total = column_6 + carry
    carry_2 = total * 0.00024414062 + 12582912.0 - 12582912.0
    place_2 = total - carry_2 * 4096.0
    total_2 = column_5 + carry_2
    carry_3 = total_2 * 0.00024414062 + 12582912.0 - 12582912.0
    place_3 = total_2 - carry_3 * 4096.0
    total_3 = column_4 + carry_3
    carry_4 = total_3 * 0.00024414062 + 12582912.0 - 12582912.0
    place_4 = total_3 - carry_4 * 4096.0
    total_4 = column_3 + carry_4
    carry_5 = total_4 * 0.00024414062 + 12582912.0 - 12582912.0
    place_5 = total_4 - carry_5 * 4096.0
    total_5 = column_2 + carry_5
    carry_6 = total_5 * 0.00024414062 + 12582912.0 - 12582912.0
    place_6 = total_5 - carry_6 * 4096.0
    k = column + carry_6
    pair = (place_6 * 4096.0 + place_5) * 5.9604645e-08
    pair_2 = (place_4 * 4096.0 + place_3) * 3.5527137e-15
    pair_3 = (place_2 * 4096.0 + place) * 2.1175824e-22
    sum_ = pair + pair_2
    sum_low = pair_2 - (sum_ - pair)
    low = sum_low + pair_3
    product = sum_ * 1.5707964
    t = sum_ * 4097.0
    upper = t - (t - sum_)
    lower = sum_ - upper
    product_low = upper * 1.5708008 - product + upper * -4.4107437e-06 + lower * 1.5708008 + lower * -4.4107437e-06
    tail = product_low + (sum_ * -4.371139e-08 + low * 1.5707964)
    high = product + tail
    low_2 = tail - (high - product)
    return vector(high, low_2, k)


def sin_strict(x):
    near_k = x * 0.63661975 + 12582912.0 - 12582912.0
    product = near_k * 1.5707964
    k_high = near_k + 6442451000.0 - 6442451000.0
    k_low = near_k - k_high
    rest = k_high * 1.5708008 - product + k_high * -4.4107437e-06
    product_low = rest + k_low * 1.5708008 + k_low * -4.4107437e-06
    left = x - product
    t = -product_low
    sum_ = left + t
    back = sum_ - left
    sum_low = left - (sum_ - back) + (t - back)
    product_2 = near_k * -4.371139e-08
    rest_2 = k_high * -4.3713953e-08 - product_2 + k_high * 2.5650593e-12
    product_low_2 = rest_2 + k_low * -4.3713953e-08 + k_low * 2.5650593e-12
    t2 = -product_2
    sum_2 = sum_ + t2
    back_2 = sum_2 - sum_
    sum_low_2 = sum_ - (sum_2 - back_2) + (t2 - back_2)
    lost = sum_low + sum_low_2 - product_low_2
    tail = lost - near_k * -1.7151245e-15
    near_high = sum_2 + tail
    near_low = tail - (near_high - sum_2)
    t3 = np.abs(x)
    far = t3 > 1048576.0
    high = near_high
    low = near_low
    k = near_k
    any_far = far.any()
    if any_far:
        t4 = payne_hanek(x)
        high = select(far, t4[0], near_high)
        low = select(far, t4[1], near_low)
        k = select(far, t4[2], near_k)
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
    return select(t3 < 0.00012207031, x, select(opposite, -size, size))


def wave(x, k, lanes):
    y = sin_strict(x) * k + 0.25  # test_numpy_text.py:23
    return select(y > 0.0, y, -k)  # test_numpy_text.py:24
