#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_c;
uniform int each_c;  // 0 where one value serves all elements
layout(location = 0) out float out_0;
layout(location = 1) out int out_status;

float dot2(precise vec2 a, precise vec2 b) {
    precise float result = a.x * b.x + a.y * b.y;
    return result;
}

void mandelbrot(precise vec2 c, precise out float result, out int status) {  // test_glsl_text.py:24
    result = zero;
    status = 1;
    precise vec2 z = vec2(zero);  // test_glsl_text.py:26
    precise float n = zero;  // test_glsl_text.py:27
    precise bool ended = false;  // test_glsl_text.py:28
    int iterations = 0;
    while (true) {
        iterations += 1;
        if (iterations > 1048576) {
            status = 2;
            break;
        }
        z = vec2(z.x * z.x - z.y * z.y, 2.0 * z.x * z.y) + c;  // test_glsl_text.py:29
        n += 1.0;  // test_glsl_text.py:30
        precise bool t = dot2(z, z) > 4.0 || n >= 256.0;  // test_glsl_text.py:31
        ended = t;
        if (t) {
            break;
        }
    }
    if (!ended) {  // test_glsl_text.py:28
        if (status != 2) {
            status = -1;
        }
        return;
    }
    result = n;  // test_glsl_text.py:32
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise float result;
    int status;
    mandelbrot(texelFetch(in_c, at * each_c, 0).xy, result, status);
    out_0 = result;
    out_status = status;
}
