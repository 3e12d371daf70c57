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
uniform isampler2D in_n;
uniform int each_n;  // 0 where one value serves all elements
layout(location = 0) out float out_0;
layout(location = 1) out int out_status;

// The smaller argument; if one is NaN, the other.
float sh_min(precise float a, precise float b) {
    precise float result = b < a || a != a ? b : a;
    return result;
}

void positive(precise float x, int n, precise out float result, out int status) {  // test_glsl_text.py:46
    result = zero;
    status = 1;
    precise float total = zero;  // test_glsl_text.py:48
    precise bool t = x < 0.0;  // test_glsl_text.py:49
    if (t) {
        status = 0;  // test_glsl_text.py:50
        return;
    } else {
        precise bool ended = false;  // test_glsl_text.py:52
        int iterations = 0;
        while (true) {
            if (n <= 0) {
                ended = true;
                break;
            }
            iterations += 1;
            if (iterations > 1048576) {
                status = 2;
                break;
            }
            total += sh_min(x, 1.0) / (float(n) + zero);  // test_glsl_text.py:53
            n -= 1;  // test_glsl_text.py:54
        }
        if (!ended) {  // test_glsl_text.py:52
            if (status != 2) {
                status = -1;
            }
            return;
        }
    }
    result = total;  // test_glsl_text.py:55
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise float result;
    int status;
    positive(texelFetch(in_x, at * each_x, 0).x, texelFetch(in_n, at * each_n, 0).x, result, status);
    out_0 = result;
    out_status = status;
}
