#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_x;
uniform int each_x;  // 0 where one value serves all elements
uniform sampler2D in_k;
uniform int each_k;  // 0 where one value serves all elements
layout(location = 0) out vec2 out_0;

vec3 payne_hanek(precise float x) {
    precise bool large = abs(x) >= 8.307675e+34;
    precise float scaled = large ? x * 1.2621775e-29 : x;
    precise float digit = large ? 1405.0 : zero;
    precise float digit_2 = large ? 501.0 : 163.0;
    precise float digit_3 = large ? 846.0 : -104.0;
    precise float digit_4 = large ? -575.0 : 878.0;
    precise float digit_5 = large ? -586.0 : 1252.0;
    precise float digit_6 = large ? 662.0 : 1045.0;
    precise float digit_7 = large ? -1644.0 : 672.0;
    precise float digit_8 = large ? -956.0 : -985.0;
    precise float digit_9 = large ? -1788.0 : 1405.0;
    precise bool large_2 = abs(scaled) >= 2.951479e+20;
    precise float scaled_2 = large_2 ? scaled * 3.5527137e-15 : scaled;
    precise float digit_10 = large_2 ? digit_5 : digit;
    precise float digit_11 = large_2 ? digit_6 : digit_2;
    precise float digit_12 = large_2 ? digit_7 : digit_3;
    precise float digit_13 = large_2 ? digit_8 : digit_4;
    precise float digit_14 = large_2 ? digit_9 : digit_5;
    precise float digit_15 = large_2 ? 501.0 : digit_6;
    precise float digit_16 = large_2 ? 846.0 : digit_7;
    precise float digit_17 = large_2 ? -575.0 : digit_8;
    precise float digit_18 = large_2 ? -586.0 : digit_9;
    precise float digit_19 = large_2 ? 662.0 : 501.0;
    precise float digit_20 = large_2 ? -1644.0 : 846.0;
    precise float digit_21 = large_2 ? -956.0 : -575.0;
    precise bool large_3 = abs(scaled_2) >= 1.7592186e+13;
    precise float scaled_3 = large_3 ? scaled_2 * 5.9604645e-08 : scaled_2;
    precise float digit_22 = large_3 ? digit_12 : digit_10;
    precise float digit_23 = large_3 ? digit_13 : digit_11;
    precise float digit_24 = large_3 ? digit_14 : digit_12;
    precise float digit_25 = large_3 ? digit_15 : digit_13;
    precise float digit_26 = large_3 ? digit_16 : digit_14;
    precise float digit_27 = large_3 ? digit_17 : digit_15;
    precise float digit_28 = large_3 ? digit_18 : digit_16;
    precise float digit_29 = large_3 ? digit_19 : digit_17;
    precise float digit_30 = large_3 ? digit_20 : digit_18;
    precise float digit_31 = large_3 ? digit_21 : digit_19;
    precise bool large_4 = abs(scaled_3) >= 4.2949673e+09;
    precise float scaled_4 = large_4 ? scaled_3 * 0.00024414062 : scaled_3;
    precise float digit_32 = large_4 ? digit_23 : digit_22;
    precise float digit_33 = large_4 ? digit_24 : digit_23;
    precise float digit_34 = large_4 ? digit_25 : digit_24;
    precise float digit_35 = large_4 ? digit_26 : digit_25;
    precise float digit_36 = large_4 ? digit_27 : digit_26;
    precise float digit_37 = large_4 ? digit_28 : digit_27;
    precise float digit_38 = large_4 ? digit_29 : digit_28;
    precise float digit_39 = large_4 ? digit_30 : digit_29;
    precise float digit_40 = large_4 ? digit_31 : digit_30;
    precise float mantissa = scaled_4 * 9.536743e-07;
    precise float first = mantissa + 1.2582912e+07 - 1.2582912e+07;
    precise float rest = (mantissa - first) * 4096.0;
    precise float second = rest + 1.2582912e+07 - 1.2582912e+07;
    precise float third = (rest - second) * 4096.0;
    precise float column = first * digit_34 + second * digit_33 + third * digit_32;
    precise float column_2 = first * digit_35 + second * digit_34 + third * digit_33;
    precise float column_3 = first * digit_36 + second * digit_35 + third * digit_34;
    precise float column_4 = first * digit_37 + second * digit_36 + third * digit_35;
    precise float column_5 = first * digit_38 + second * digit_37 + third * digit_36;
    precise float column_6 = first * digit_39 + second * digit_38 + third * digit_37;
    precise float column_7 = first * digit_40 + second * digit_39 + third * digit_38;
    precise float carry = column_7 * 0.00024414062 + 1.2582912e+07 - 1.2582912e+07;
    precise float place = column_7 - carry * 4096.0;
    precise float total = column_6 + carry;
    precise float carry_2 = total * 0.00024414062 + 1.2582912e+07 - 1.2582912e+07;
    precise float place_2 = total - carry_2 * 4096.0;
    precise float total_2 = column_5 + carry_2;
    precise float carry_3 = total_2 * 0.00024414062 + 1.2582912e+07 - 1.2582912e+07;
    precise float place_3 = total_2 - carry_3 * 4096.0;
    precise float total_3 = column_4 + carry_3;
    precise float carry_4 = total_3 * 0.00024414062 + 1.2582912e+07 - 1.2582912e+07;
    precise float place_4 = total_3 - carry_4 * 4096.0;
    precise float total_4 = column_3 + carry_4;
    precise float carry_5 = total_4 * 0.00024414062 + 1.2582912e+07 - 1.2582912e+07;
    precise float place_5 = total_4 - carry_5 * 4096.0;
    precise float total_5 = column_2 + carry_5;
    precise float carry_6 = total_5 * 0.00024414062 + 1.2582912e+07 - 1.2582912e+07;
    precise float place_6 = total_5 - carry_6 * 4096.0;
    precise float k = column + carry_6;
    precise float pair = (place_6 * 4096.0 + place_5) * 5.9604645e-08;
    precise float pair_2 = (place_4 * 4096.0 + place_3) * 3.5527137e-15;
    precise float pair_3 = (place_2 * 4096.0 + place) * 2.1175824e-22;
    precise float sum = pair + pair_2;
    precise float sum_low = pair_2 - (sum - pair);
    precise float low = sum_low + pair_3;
    precise float product = sum * 1.5707964;
    precise float t = sum * 4097.0;
    precise float upper = t - (t - sum);
    precise float lower = sum - upper;
    precise float upper_2 = 1.5708008;
    precise float lower_2 = -4.4107437e-06;
    precise float product_low = upper * upper_2 - product + upper * lower_2 + lower * upper_2 + lower * lower_2;
    precise float tail = product_low + (sum * -4.371139e-08 + low * 1.5707964);
    precise float high = product + tail;
    precise float low_2 = tail - (high - product);
    precise vec3 result = vec3(high, low_2, k);
    return result;
}

float sin_strict(precise float x) {
    precise float near_k = x * 0.63661975 + 1.2582912e+07 - 1.2582912e+07;
    precise float product = near_k * 1.5707964;
    precise float k_high = near_k + 6.442451e+09 - 6.442451e+09;
    precise float k_low = near_k - k_high;
    precise float rest = k_high * 1.5708008 - product + k_high * -4.4107437e-06;
    precise float product_low = rest + k_low * 1.5708008 + k_low * -4.4107437e-06;
    precise float left = x - product;
    precise float t = -product_low;
    precise float sum = left + t;
    precise float back = sum - left;
    precise float sum_low = left - (sum - back) + (t - back);
    precise float product_2 = near_k * -4.371139e-08;
    precise float rest_2 = k_high * -4.3713953e-08 - product_2 + k_high * 2.5650593e-12;
    precise float product_low_2 = rest_2 + k_low * -4.3713953e-08 + k_low * 2.5650593e-12;
    precise float t2 = -product_2;
    precise float sum_2 = sum + t2;
    precise float back_2 = sum_2 - sum;
    precise float sum_low_2 = sum - (sum_2 - back_2) + (t2 - back_2);
    precise float lost = sum_low + sum_low_2 - product_low_2;
    precise float tail = lost - near_k * -1.7151245e-15;
    precise float near_high = sum_2 + tail;
    precise float near_low = tail - (near_high - sum_2);
    precise float t3 = abs(x);
    precise bool far = t3 > 1.048576e+06;
    precise float high = near_high;
    precise float low = near_low;
    precise float k = near_k;
    precise bool any_far = far;
    if (any_far) {
        precise vec3 t4 = payne_hanek(x);
        high = far ? t4.x : near_high;
        low = far ? t4.y : near_low;
        k = far ? t4.z : near_k;
    }
    precise float k_by_2 = k * 0.5;
    precise float pairs = floor(k_by_2);
    precise float k_by_4 = pairs * 0.5;
    precise bool odd = k_by_2 != pairs;
    precise bool opposite = k_by_4 != floor(k_by_4);
    precise float z = high * high;
    precise float z_by_2 = z * 0.5;
    precise float whole = 1.0 - z_by_2;
    precise float series = (z * 2.451498e-05 - 0.0013888152) * z + 0.041666664;
    precise float rest_3 = z * z * series - high * low;
    precise float cosine_rest = 1.0 - whole - z_by_2 + rest_3;
    precise float series_2 = ((z * 2.8502463e-06 - 0.00019855748) * z + 0.008333388) * z - 0.16666667;
    precise float sine_rest = high * (z * series_2) + low;
    precise float size = odd ? whole + cosine_rest : high + sine_rest;
    precise float result = t3 < 0.00012207031 ? x : (opposite ? -size : size);
    return result;
}

vec2 wave(precise float x, precise vec2 k) {  // test_glsl_text.py:18
    precise vec2 y = sin_strict(x) * k + zero;  // test_glsl_text.py:20
    precise vec2 result = mix(-k, y, greaterThan(y, vec2(0.0)));  // test_glsl_text.py:21
    return result;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    out_0 = wave(texelFetch(in_x, at * each_x, 0).x, texelFetch(in_k, at * each_k, 0).xy);
}
