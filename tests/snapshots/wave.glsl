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

// a * b as a sum of two floats (Dekker 1971), for products that neither overflow nor underflow.
vec2 sh_two_product(precise float a, precise float b) {
    precise float product = a * b;
    precise float a_high = a * 4097.0 - (a * 4097.0 - a);
    precise float b_high = b * 4097.0 - (b * 4097.0 - b);
    precise float a_low = a - a_high;
    precise float b_low = b - b_high;
    precise float rest = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low;
    return vec2(product, rest);
}

// Payne and Hanek's reduction as passes/strict/payne_hanek.py writes it, an iteration for each digit of 2 / pi, and so a
// quarter of the text: where branches skip nothing, one iteration is what an angle costs that is not far.
vec3 sh_payne_hanek(precise float x) {
    const float digits[17] = float[17](0.0, 163.0, -104.0, 878.0, 1252.0, 1045.0, 672.0, -985.0, 1405.0,
        501.0, 846.0, -575.0, -586.0, 662.0, -1644.0, -956.0, -1788.0);
    // By so many digits x is scaled: a twelfth of its exponent.
    int scale = clamp(((floatBitsToInt(x) >> 23 & 255) - 147) * 43 >> 9, 0, 8);
    precise float mantissa = x * intBitsToFloat(107 - 12 * scale << 23);
    precise float first = mantissa + 1.2582912e+07 - 1.2582912e+07;
    precise float rest = (mantissa - first) * 4096.0;
    precise float second = rest + 1.2582912e+07 - 1.2582912e+07;
    precise float third = (rest - second) * 4096.0;
    precise float a = 0.0, b = 0.0, c = 0.0, carry = 0.0, k = 0.0;
    precise float p = 0.0, p_2 = 0.0, p_3 = 0.0, p_4 = 0.0, p_5 = 0.0, p_6 = 0.0, p_7 = 0.0;
    for (int n = scale + 8; n >= scale; n--) {
        a = b;
        b = c;
        c = digits[n];
        k = first * a + second * b + third * c + carry;
        p = p_2;
        p_2 = p_3;
        p_3 = p_4;
        p_4 = p_5;
        p_5 = p_6;
        p_6 = p_7;
        carry = k * 0.00024414062 + 1.2582912e+07 - 1.2582912e+07;
        p_7 = k - carry * 4096.0;
        carry = n > scale + 6 ? 0.0 : carry;
    }
    precise float pair = (p_6 * 4096.0 + p_5) * 5.9604645e-08;
    precise float pair_2 = (p_4 * 4096.0 + p_3) * 3.5527137e-15;
    precise float pair_3 = (p_2 * 4096.0 + p) * 2.1175824e-22;
    precise float sum = pair + pair_2;
    precise float low = pair_2 - (sum - pair) + pair_3;
    precise vec2 product = sh_two_product(sum, 1.5707964);
    precise float tail = product.y + (sum * -4.371139e-08 + low * 1.5707964);
    precise float high = product.x + tail;
    precise vec3 result = vec3(high, tail - (high - product.x), k);
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
        precise vec3 t4 = sh_payne_hanek(x);
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
