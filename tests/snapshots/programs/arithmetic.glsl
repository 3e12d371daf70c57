#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

uniform ivec2 sh_last;
uniform sampler2D in_a;
uniform int each_a;  // 0 where one value serves all elements
uniform sampler2D in_b;
uniform int each_b;  // 0 where one value serves all elements
uniform sampler2D in_v;
uniform int each_v;  // 0 where one value serves all elements
layout(location = 0) out float out_0;
layout(location = 1) out vec3 out_1;

void arithmetic(  // snapshot_programs.py:21
    precise float a,
    precise float b,
    precise vec3 v,
    precise out float result0,
    precise out vec3 result1) {
    precise float quadratic = (a * a + 2.0 * a * b - b * b) / (1.0 - a * b);  // snapshot_programs.py:23
    precise vec3 scaled = -v * (a - (b - 1.0)) + 0.5;  // snapshot_programs.py:24
    result0 = quadratic;  // snapshot_programs.py:25
    result1 = scaled;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise float result0;
    precise vec3 result1;
    arithmetic(texelFetch(in_a, at * each_a, 0).x, texelFetch(in_b, at * each_b, 0).x, texelFetch(in_v, at * each_v, 0).xyz, result0, result1);
    out_0 = result0;
    out_1 = result1;
}
