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

// The 64 bits of a * b: low, high.
uvec2 sh_product(uint a, uint b) {
    uint low = (a & 0xffffu) * (b & 0xffffu);
    uint left = (a >> 16) * (b & 0xffffu) + (low >> 16);
    uint right = (a & 0xffffu) * (b >> 16) + (left & 0xffffu);
    return uvec2((right << 16) | (low & 0xffffu), (a >> 16) * (b >> 16) + (left >> 16) + (right >> 16));
}

// x - n pi/2 for large x, exactly (Payne and Hanek 1983): the 96 bits of 2/pi that matter for the quadrant and what
// follows it, times the 24 bits of x.
float sh_quadrant_large(float x, out int n) {
    const uint two_over_pi[9] = uint[9](0u, 0xa2f9836eu, 0x4e441529u, 0xfc2757d1u, 0xf534ddc0u, 0xdb629599u,
        0x3c439041u, 0xfe5163abu, 0xdebbc561u);
    uint bits = floatBitsToUint(x);
    uint mantissa = (bits & 0x7fffffu) | 0x800000u;
    int start = int((bits >> 23) & 255u) - 120;
    int word = start >> 5;
    uint left = uint(start & 31);
    uvec4 w = uvec4(two_over_pi[word], two_over_pi[word + 1], two_over_pi[word + 2], two_over_pi[word + 3]);
    uvec3 window = left == 0u ? w.xyz : (w.xyz << left) | (w.yzw >> (32u - left));
    uvec2 third = sh_product(window.z, mantissa);
    uvec2 second = sh_product(window.y, mantissa);
    uint middle = second.x + third.y;
    uint high = window.x * mantissa + second.y + (middle < third.y ? 1u : 0u);
    uint fraction = (high << 2) | (middle >> 30);
    n = int((high >> 30) + (fraction >> 31));
    uint rest = (middle << 2) | (third.x >> 30);
    precise float r = float(int(fraction)) * 2.3283064e-10 + float(rest) * 5.4210109e-20;
    r = r * 1.57079633;
    n = x < 0.0 ? -n : n;
    return x < 0.0 ? -r : r;
}

// x - n pi/2, in [-pi/4, pi/4]: up to 1600 by pi/2 in three parts (Cody and Waite 1980), n times the first two exact.
float sh_quadrant(float x, out int n) {
    precise float k = roundEven(x * 0.636619772);
    precise float r = x - k * 1.57080078125 + k * 4.454515874385834e-6 - k * 6.0771005e-11;
    n = int(k);
    if (abs(x) > 1600.0) {
        r = sh_quadrant_large(x, n);
    }
    precise bool finite = abs(x) < uintBitsToFloat(0x7f800000u);
    return finite ? r : uintBitsToFloat(0x7fc00000u);
}

float sh_sin_near_zero(float r) {
    precise float z = r * r;
    precise float s = r + r * z * ((z * -1.9512029e-4 + 8.332137e-3) * z - 1.6666654e-1);
    return s;
}

float sh_cos_near_zero(float r) {
    precise float z = r * r;
    precise float c = z * z * ((z * 2.4429439e-5 - 1.3887284e-3) * z + 4.1666646e-2) - 0.5 * z + 1.0;
    return c;
}

float sh_sin(float x) {
    int n;
    float r = sh_quadrant(x, n);
    float s = (n & 1) == 0 ? sh_sin_near_zero(r) : sh_cos_near_zero(r);
    s = (n & 2) == 0 ? s : -s;
    return abs(x) < 2.44140625e-4 ? x : s;
}

vec2 wave(precise float x, precise vec2 k) {  // test_glsl_text.py:18
    precise vec2 y = sh_sin(x) * k + zero;  // test_glsl_text.py:20
    precise vec2 result = mix(-k, y, greaterThan(y, vec2(0.0)));  // test_glsl_text.py:21
    return result;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    out_0 = wave(texelFetch(in_x, at * each_x, 0).x, texelFetch(in_k, at * each_k, 0).xy);
}
