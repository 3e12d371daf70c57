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

float reversing(precise vec4 x, int n) {  // snapshot_programs.py:111
    precise float stack[4] = float[4](zero, zero, zero, zero);  // snapshot_programs.py:113
    for (int i = 0; i < 4; i += 1) {  // snapshot_programs.py:114
        if (i >= 0 && i < 4) {  // snapshot_programs.py:115
            stack[i] = x[clamp(i, 0, 3)] - zero;
        }
    }
    precise float result = stack[clamp(3 - n, 0, 3)];  // snapshot_programs.py:116
    return result;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    out_0 = reversing(texelFetch(in_x, at * each_x, 0), texelFetch(in_n, at * each_n, 0).x);
}
