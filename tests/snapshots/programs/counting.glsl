#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform bool sh_running;  // true, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_x;
uniform int each_x;  // 0 where one value serves all elements
uniform isampler2D in_n;
uniform int each_n;  // 0 where one value serves all elements
layout(location = 0) out float out_0;
layout(location = 1) out int out_status;

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a - a / by * by;
    int result = rest != 0 && (rest ^ by) < 0 ? rest + by : rest;
    return result;
}

void counting(precise float x, int n, precise out float result, out int status) {  // snapshot_programs.py:70
    result = zero;
    status = 1;
    precise float total = zero;  // snapshot_programs.py:72
    int i = 0;  // snapshot_programs.py:73
    precise bool ended = false;
    int iterations = 0;
    for (;; i += 1) {
        if (i >= n) {
            ended = true;
            break;
        }
        iterations += 1;
        if (iterations > 1048576) {
            status = 2;
            break;
        }
        if (sh_floormod(i, 3) == 0) {  // snapshot_programs.py:74
            continue;
        }
        total += x * (float(i) + zero);  // snapshot_programs.py:75
        precise bool t = total > 100.0;  // snapshot_programs.py:76
        if (t) {
            ended = true;
            break;
        }
    }
    if (!ended) {  // snapshot_programs.py:73
        if (status != 2) {
            status = -1;
        }
        return;
    }
    int j = 8;  // snapshot_programs.py:77
    precise bool ended_2 = false;
    while (sh_running) {
        if (j <= 0) {
            ended_2 = true;
            break;
        }
        total -= float(j) + zero;  // snapshot_programs.py:78
        j += -2;  // snapshot_programs.py:77
    }
    if (!ended_2) {  // snapshot_programs.py:77
        status = -1;
        return;
    }
    result = total;  // snapshot_programs.py:79
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise float result;
    int status;
    counting(texelFetch(in_x, at * each_x, 0).x, texelFetch(in_n, at * each_n, 0).x, result, status);
    out_0 = result;
    out_status = status;
}
