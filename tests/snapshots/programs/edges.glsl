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
uniform sampler2D in_y;
uniform int each_y;  // 0 where one value serves all elements
layout(location = 0) out float out_0;
layout(location = 1) out float out_1;
layout(location = 2) out float out_2;
layout(location = 3) out int out_3;
layout(location = 4) out float out_4;
layout(location = 5) out float out_5;
layout(location = 6) out uint out_6;

// Whether x is infinite, by its bits.
bool sh_isinf(precise float x) {
    precise bool result = (floatBitsToUint(x) & 2147483647u) == 2139095040u;
    return result;
}

// The smaller argument; if one is NaN, the other.
float sh_min(precise float a, precise float b) {
    precise float result = b < a || a != a ? b : a;
    return result;
}

// The sign of a float; 0 for NaN and both zeros.
float sh_sign(precise float x) {
    precise float result = (x > 0.0 ? 1.0 : zero) - (x < 0.0 ? 1.0 : zero);
    return result;
}

// The float truncated; the nearest int where it is out of range, and 0 for NaN.
int sh_to_int(precise float x) {
    precise bool t = x > -2.1474836e+09 && x < 2.1474836e+09;
    precise bool t2 = x >= 2.1474836e+09;
    precise bool t3 = x < 0.0;
    int result = t ? int(t ? x : zero) : (t2 ? 2147483647 : (t3 ? (-2147483647 - 1) : 0));
    return result;
}

// The greater argument; if one is NaN, the other.
float sh_max(precise float a, precise float b) {
    precise float result = a < b || a != a ? b : a;
    return result;
}

// min(max(x, low), high).
float sh_clamp(precise float x, precise float low, precise float high) {
    precise float result = sh_min(sh_max(x, low), high);
    return result;
}

// The bits of x; every NaN gives the same bits.
uint sh_bits(precise float x) {
    precise bool t = x != x;
    uint result = t ? 2143289344u : floatBitsToUint(x);
    return result;
}

float mod1(precise float x, precise float y) {
    precise float quotient = floor(x / y);
    precise float result = x - y * (quotient == 0.0 && x != 0.0 && (x < 0.0) != (y < 0.0) && !sh_isinf(y) ? -1.0 : quotient);
    return result;
}

void edges(  // snapshot_programs.py:160
    precise float x,
    precise float y,
    precise out float result0,
    precise out float result1,
    precise out float result2,
    out int result3,
    precise out float result4,
    precise out float result5,
    out uint result6) {
    result0 = sh_min(x, y);  // snapshot_programs.py:162
    result1 = sh_sign(x);
    result2 = roundEven(x);
    result3 = sh_to_int(x);
    result4 = mod1(x, y);
    result5 = sh_clamp(x, zero, y);
    result6 = sh_bits(x);
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise float result0;
    precise float result1;
    precise float result2;
    int result3;
    precise float result4;
    precise float result5;
    uint result6;
    edges(texelFetch(in_x, at * each_x, 0).x, texelFetch(in_y, at * each_y, 0).x, result0, result1, result2, result3, result4, result5, result6);
    out_0 = result0;
    out_1 = result1;
    out_2 = result2;
    out_3 = result3;
    out_4 = result4;
    out_5 = result5;
    out_6 = result6;
}
