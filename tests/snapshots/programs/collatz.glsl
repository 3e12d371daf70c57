#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

uniform ivec2 sh_last;
uniform isampler2D in_n;
uniform int each_n;  // 0 where one value serves all elements
layout(location = 0) out int out_0;
layout(location = 1) out int out_status;

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a - a / by * by;
    int result = rest != 0 && (rest ^ by) < 0 ? rest + by : rest;
    return result;
}

// floor(a / b); 0 for b = 0, and the least int for itself by -1.
int sh_floordiv(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a - a / by * by;
    int q = a / by;
    int result = b == 0 ? 0 : (b == -1 ? int(0u - uint(a)) : q - (rest != 0 && (rest ^ by) < 0 ? 1 : 0));
    return result;
}

void collatz(int n, out int result, out int status) {  // snapshot_programs.py:61
    result = 0;
    status = 1;
    int steps = 0;  // snapshot_programs.py:63
    precise bool ended = false;  // snapshot_programs.py:64
    int iterations = 0;
    while (true) {
        if (n <= 1) {
            ended = true;
            break;
        }
        iterations += 1;
        if (iterations > 1048576) {
            status = 2;
            break;
        }
        n = sh_floormod(n, 2) == 0 ? sh_floordiv(n, 2) : 3 * n + 1;  // snapshot_programs.py:65
        steps += 1;  // snapshot_programs.py:66
    }
    if (!ended) {  // snapshot_programs.py:64
        if (status != 2) {
            status = -1;
        }
        return;
    }
    result = steps;  // snapshot_programs.py:67
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    int result;
    int status;
    collatz(texelFetch(in_n, at * each_n, 0).x, result, status);
    out_0 = result;
    out_status = status;
}
