#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

uniform isampler2D names;
uniform int names_shape;
uniform sampler2D heights;
uniform ivec2 heights_shape;
uniform sampler2D path;
uniform int path_shape;
uniform ivec2 sh_last;
uniform isampler2D in_i;
uniform int each_i;  // 0 where one value serves all elements
uniform isampler2D in_row;
uniform int each_row;  // 0 where one value serves all elements
layout(location = 0) out float out_0;
layout(location = 1) out vec3 out_1;
layout(location = 2) out int out_2;

// An element of names, the nearest where the index is out of range.
int names_at(int at) {
    at = clamp(at, int(0), names_shape - 1);
    int i = at;
    return texelFetch(names, ivec2(i & 4095, i >> 12), 0).x;
}

// An element of heights, the nearest where the index is out of range.
float heights_at(ivec2 at) {
    at = clamp(at, ivec2(0), heights_shape - 1);
    int i = at.x * heights_shape.y + at.y;
    return texelFetch(heights, ivec2(i & 4095, i >> 12), 0).x;
}

// An element of path, the nearest where the index is out of range.
vec3 path_at(int at) {
    at = clamp(at, int(0), path_shape - 1);
    int i = at;
    return texelFetch(path, ivec2(i & 4095, i >> 12), 0).xyz;
}

void lookups(int i, int row, precise out float result0, precise out vec3 result1, out int result2) {  // snapshot_programs.py:123
    result0 = heights_at(ivec2(row, names_at(i)));  // snapshot_programs.py:125
    result1 = path_at(i) - path_at(0);
    result2 = path_shape;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise float result0;
    precise vec3 result1;
    int result2;
    lookups(texelFetch(in_i, at * each_i, 0).x, texelFetch(in_row, at * each_row, 0).x, result0, result1, result2);
    out_0 = result0;
    out_1 = result1;
    out_2 = result2;
}
