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
uniform usampler2D in_bits;
uniform int each_bits;  // 0 where one value serves all elements
layout(location = 0) out vec4 out_0;
layout(location = 1) out uint out_1;

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a - a / by * by;
    int result = rest != 0 && (rest ^ by) < 0 ? rest + by : rest;
    return result;
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
uint sh_floormod(uint a, uint b) {
    uint by = max(b, 1u);
    uint result = b == 0u ? 0u : a - a / by * by;
    return result;
}

float push(precise inout vec4 stack, precise float value) {  // test_glsl_text.py:30
    stack = vec4(value, stack.xyz);  // test_glsl_text.py:32
    precise float result = stack.w;  // test_glsl_text.py:33
    return result;
}

void histogram(precise float x, uint bits, precise out vec4 result0, precise out bool result1) {  // test_glsl_text.py:36
    precise vec4 stack = vec4(zero);  // test_glsl_text.py:39
    int counts[4] = int[4](0, 0, 0, 0);  // test_glsl_text.py:38
    for (int i = 0; i < 10; i += 1) {  // test_glsl_text.py:40
        int t = sh_floormod(i, 4);  // test_glsl_text.py:41
        if (t >= 0 && t < 4) {
            counts[t] = counts[clamp(t, 0, 3)] + 1;
        }
        precise float t2 = (float(counts[clamp(i, 0, 3)]) + zero) * x;  // test_glsl_text.py:42
        push(stack, t2);
    }
    result0 = stack;  // test_glsl_text.py:43
    result1 = sh_floormod(bits >> 3, 2u) == 1u;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise vec4 result0;
    precise bool result1;
    histogram(texelFetch(in_x, at * each_x, 0).x, texelFetch(in_bits, at * each_bits, 0).x, result0, result1);
    out_0 = result0;
    out_1 = uint(result1);
}
