#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_p;
uniform int each_p;  // 0 where one value serves all elements
uniform isampler2D in_k;
uniform int each_k;  // 0 where one value serves all elements
layout(location = 0) out vec3 out_0;
layout(location = 1) out float out_1;

void swizzles(precise vec4 p, int k, precise out vec3 result0, precise out float result1) {  // snapshot_programs.py:28
    precise vec4 q = vec4(p.w + p.z, p.y, zero, p.y);  // snapshot_programs.py:32
    result0 = q.zyx;  // snapshot_programs.py:33
    result1 = q[clamp(k, 0, 3)];
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise vec3 result0;
    precise float result1;
    swizzles(texelFetch(in_p, at * each_p, 0), texelFetch(in_k, at * each_k, 0).x, result0, result1);
    out_0 = result0;
    out_1 = result1;
}
