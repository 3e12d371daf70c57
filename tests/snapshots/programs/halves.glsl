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

// The nearest binary16, half to even: by the bits, but for halves that are denormal.
float sh_half(precise float x) {
    uint bits = floatBitsToUint(x);
    uint size = bits & 2147483647u;
    uint rounded = (size + 4095u + ((size >> 13u) & 1u)) & 4294959104u;
    precise float t = uintBitsToFloat(size) + 0.5 - 0.5;
    uint t2 = size > 2139095040u ? 2143289344u : (size < 947912704u ? floatBitsToUint(t) : (rounded >= 1199570944u ? 2139095040u : rounded));
    precise float result = uintBitsToFloat(t2 | (bits & 2147483648u));
    return result;
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
