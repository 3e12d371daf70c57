#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform isampler2D in_a;
uniform int each_a;  // 0 where one value serves all elements
uniform isampler2D in_b;
uniform int each_b;  // 0 where one value serves all elements
uniform usampler2D in_u;
uniform int each_u;  // 0 where one value serves all elements
layout(location = 0) out int out_0;
layout(location = 1) out int out_1;
layout(location = 2) out int out_2;
layout(location = 3) out uint out_3;
layout(location = 4) out float out_4;
layout(location = 5) out int out_5;

// floor(a / b); 0 for b = 0, and the least int for itself by -1.
int sh_floordiv(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a - a / by * by;
    int q = a / by;
    int result = b == 0 ? 0 : (b == -1 ? int(0u - uint(a)) : q - (rest != 0 && (rest ^ by) < 0 ? 1 : 0));
    return result;
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a - a / by * by;
    int result = rest != 0 && (rest ^ by) < 0 ? rest + by : rest;
    return result;
}

uint scramble(uint state) {  // library.py:31
    uint word = ((state >> ((state >> 28) + 4u)) ^ state) * 277803737u;  // library.py:32
    uint result = (word >> 22) ^ word;  // library.py:33
    return result;
}

uint pcg(uint x) {  // library.py:39
    uint result = scramble(x * 747796405u + 2891336453u);  // library.py:40
    return result;
}

void whole_numbers(  // snapshot_programs.py:155
    int a,
    int b,
    uint u,
    out int result0,
    out int result1,
    out int result2,
    out uint result3,
    precise out float result4,
    out int result5) {
    result0 = sh_floordiv(a, b);  // snapshot_programs.py:157
    result1 = sh_floormod(a, b);
    result2 = (a << 2) ^ (b & ~a);
    result3 = u >> 7;
    result4 = (float(pcg(u) >> 8u) + zero) * 5.9604645e-08;
    result5 = (-2147483647 - 1) - a;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    int result0;
    int result1;
    int result2;
    uint result3;
    precise float result4;
    int result5;
    whole_numbers(texelFetch(in_a, at * each_a, 0).x, texelFetch(in_b, at * each_b, 0).x, texelFetch(in_u, at * each_u, 0).x, result0, result1, result2, result3, result4, result5);
    out_0 = result0;
    out_1 = result1;
    out_2 = result2;
    out_3 = result3;
    out_4 = result4;
    out_5 = result5;
}
