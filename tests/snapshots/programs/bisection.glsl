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
layout(location = 0) out float out_0;
layout(location = 1) out int out_status;

// The greater argument; if one is NaN, the other.
float sh_max(precise float a, precise float b) {
    precise float result = a < b || a != a ? b : a;
    return result;
}

void bisection(precise float x, precise out float result, out int status) {  // snapshot_programs.py:185
    result = zero;
    status = 1;
    precise float low = zero;  // snapshot_programs.py:187
    precise float high = sh_max(x, 1.0) - zero;
    precise bool ended = false;  // snapshot_programs.py:188
    int iterations = 0;
    while (true) {
        iterations += 1;
        if (iterations > 1048576) {
            status = 2;
            break;
        }
        precise float middle = (low + high) / 2.0;  // snapshot_programs.py:189
        precise bool t = middle * middle < x;  // snapshot_programs.py:190
        if (t) {
            low = middle;  // snapshot_programs.py:191
        } else {
            high = middle;  // snapshot_programs.py:193
        }
        precise bool t2 = high - low <= 1e-06 * high;  // snapshot_programs.py:194
        ended = t2;
        if (t2) {
            break;
        }
    }
    if (!ended) {  // snapshot_programs.py:188
        if (status != 2) {
            status = -1;
        }
        return;
    }
    result = low;  // snapshot_programs.py:195
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise float result;
    int status;
    bisection(texelFetch(in_x, at * each_x, 0).x, result, status);
    out_0 = result;
    out_status = status;
}
