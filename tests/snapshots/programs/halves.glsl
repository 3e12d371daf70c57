#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

uniform ivec2 sh_last;
uniform sampler2D in_x;
uniform int each_x;  // 0 where one value serves all elements
uniform sampler2D in_f;
uniform int each_f;  // 0 where one value serves all elements
layout(location = 0) out float out_0;
layout(location = 1) out float out_1;

// The nearest binary16, half to even: by the bits, but for halves that are denormal, where 2^-24 is the last place.
float sh_half(precise float x) {
    uint bits = floatBitsToUint(x);
    uint size = bits & 0x7fffffffu;
    uint rounded = (size + 0xfffu + ((size >> 13) & 1u)) & 0xffffe000u;
    rounded = rounded >= 0x47800000u ? 0x7f800000u : rounded;
    precise float small = (uintBitsToFloat(size) + 0.5) - 0.5;
    rounded = size > 0x7f800000u ? 0x7fc00000u : size < 0x38800000u ? floatBitsToUint(small) : rounded;
    return uintBitsToFloat(rounded | (bits & 0x80000000u));
}

void halves(precise float x, precise float f, precise out float result0, precise out float result1) {  // snapshot_programs.py:180
    result0 = sh_half(sh_half(x * x) + 0.099975586);  // snapshot_programs.py:182
    result1 = f + x;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise float result0;
    precise float result1;
    halves(texelFetch(in_x, at * each_x, 0).x, texelFetch(in_f, at * each_f, 0).x, result0, result1);
    out_0 = result0;
    out_1 = result1;
}
