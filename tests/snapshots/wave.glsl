#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

uniform float zero;  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_x;
uniform int each_x;  // 0 where one value serves all elements
uniform sampler2D in_k;
uniform int each_k;  // 0 where one value serves all elements
layout(location = 0) out vec2 out_0;

float sin_strict(precise float x) {
    precise float t = abs(x);
    precise float near = t <= 1.048576e+06 ? x : x - x;
    precise float k = near * 0.63661975 + 1.2582912e+07 - 1.2582912e+07;
    precise float product = k * 1.5707964;
    precise float k_high = k + 6.442451e+09 - 6.442451e+09;
    precise float k_low = k - k_high;
    precise float rest = k_high * 1.5708008 - product + k_high * -4.4107437e-06;
    precise float product_low = rest + k_low * 1.5708008 + k_low * -4.4107437e-06;
    precise float left = near - product;
    precise float t2 = -product_low;
    precise float sum = left + t2;
    precise float back = sum - left;
    precise float sum_low = left - (sum - back) + (t2 - back);
    precise float product_2 = k * -4.371139e-08;
    precise float rest_2 = k_high * -4.3713953e-08 - product_2 + k_high * 2.5650593e-12;
    precise float product_low_2 = rest_2 + k_low * -4.3713953e-08 + k_low * 2.5650593e-12;
    precise float t3 = -product_2;
    precise float sum_2 = sum + t3;
    precise float back_2 = sum_2 - sum;
    precise float sum_low_2 = sum - (sum_2 - back_2) + (t3 - back_2);
    precise float lost = sum_low + sum_low_2 - product_low_2;
    precise float tail = lost - k * -1.7151245e-15;
    precise float high = sum_2 + tail;
    precise float low = tail - (high - sum_2);
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
    precise float result = t < 0.00012207031 ? x : (opposite ? -size : size);
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
