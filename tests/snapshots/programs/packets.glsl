#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

uniform ivec2 sh_last;
uniform sampler2D in_x;
uniform int each_x;  // 0 where one value serves all elements
layout(location = 0) out float out_0;

float packets(precise float x) {  // snapshot_programs.py:165
    precise float y = x;  // snapshot_programs.py:167
    precise bool t = x > 1.0;  // snapshot_programs.py:168
    if (t) {
        y = sqrt(x);  // snapshot_programs.py:169
    }
    precise float result = y;  // snapshot_programs.py:170
    return result;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    out_0 = packets(texelFetch(in_x, at * each_x, 0).x);
}
