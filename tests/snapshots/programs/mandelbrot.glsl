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

void mandelbrot(precise vec2 c, precise out float result, out int status) {  // snapshot_programs.py:36
    result = zero;
    status = 1;
    precise vec2 z = vec2(zero);  // snapshot_programs.py:38
    precise float n = zero;  // snapshot_programs.py:39
    precise bool ended = false;  // snapshot_programs.py:40
    int iterations = 0;
    while (true) {
        iterations += 1;
        if (iterations > 1048576) {
            status = 2;
            break;
        }
        z = vec2(z.x * z.x - z.y * z.y, 2.0 * z.x * z.y) + c;  // snapshot_programs.py:41
        n += 1.0;  // snapshot_programs.py:42
        precise bool t = dot2(z, z) > 4.0 || n >= 256.0;  // snapshot_programs.py:43
        ended = t;
        if (t) {
            break;
        }
    }
    if (!ended) {  // snapshot_programs.py:40
        if (status != 2) {
            status = -1;
        }
        return;
    }
    result = n;  // snapshot_programs.py:44
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise float result;
    int status;
    mandelbrot(texelFetch(in_c, at * each_c, 0).xy, result, status);
    out_0 = result;
    out_status = status;
}
