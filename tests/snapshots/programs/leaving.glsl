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
layout(location = 0) out int out_0;
layout(location = 1) out int out_1;
layout(location = 2) out int out_status;

// Whether x is NaN, by its bits.
bool sh_isnan(precise float x) {
    precise bool result = (floatBitsToUint(x) & 2147483647u) > 2139095040u;
    return result;
}

void leaving(precise float x, out int result0, out int result1, out int status) {  // snapshot_programs.py:82
    result0 = 0;
    result1 = 0;
    status = 1;
    if (sh_isnan(x)) {  // snapshot_programs.py:84
        status = 0;
        return;
    }
    int i = 0;  // snapshot_programs.py:85
    precise bool ended = false;
    while (sh_running) {
        if (i >= 4) {
            ended = true;
            break;
        }
        int j = 0;  // snapshot_programs.py:86
        precise bool ended_2 = false;
        int iterations = 0;
        while (true) {
            if (j >= i) {
                ended_2 = true;
                break;
            }
            iterations += 1;
            if (iterations > 1048576) {
                status = 2;
                break;
            }
            precise bool t = x < float(i * j) + zero;  // snapshot_programs.py:87
            if (t) {
                result0 = i;  // snapshot_programs.py:88
                result1 = j;
                return;
            }
            j += 1;  // snapshot_programs.py:86
        }
        if (!ended_2) {  // snapshot_programs.py:86
            if (status != 2) {
                status = -1;
            }
            return;
        }
        i += 1;  // snapshot_programs.py:85
    }
    if (!ended) {  // snapshot_programs.py:85
        status = -1;
        return;
    }
    result0 = -1;  // snapshot_programs.py:89
    result1 = -1;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    int result0;
    int result1;
    int status;
    leaving(texelFetch(in_x, at * each_x, 0).x, result0, result1, status);
    out_0 = result0;
    out_1 = result1;
    out_status = status;
}
