#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

uniform vec3 sky;
uniform sampler2D heights;
uniform ivec2 heights_shape;
uniform ivec2 sh_last;
uniform int sh_first;
uniform int sh_width;
uniform ivec4 sh_grid_shape;
uniform isampler2D in_cell;
uniform int each_cell;  // 0 where one value serves all elements
layout(location = 0) out vec3 out_0;
layout(location = 1) out ivec2 out_1;

// i / n and i % n for i >= 0, n > 0, by way of floats: drivers divide the integers of each fragment on its own.
ivec2 sh_split(int i, int n) {
    int q = int(float(i) / float(n));
    q += int(floor(float(i - q * n) / float(n)));
    int r = i - q * n;
    return r < 0 ? ivec2(q - 1, r + n) : r < n ? ivec2(q, r) : ivec2(q + 1, r - n);
}

// An element of heights, the nearest where the index is out of range.
float heights_at(ivec2 at) {
    at = clamp(at, ivec2(0), heights_shape - 1);
    int i = at.x * heights_shape.y + at.y;
    return texelFetch(heights, ivec2(i & 4095, i >> 12), 0).x;
}

ivec2 sh_grid_index2() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    int i = sh_first + at.y * sh_width + at.x;
    return sh_split(i, sh_grid_shape.y);
}

void terrain(ivec2 cell, precise out vec3 result0, out ivec2 result1) {  // test_glsl_text.py:24
    precise float h = heights_at(cell);  // test_glsl_text.py:26
    result0 = sky * h;  // test_glsl_text.py:27
    result1 = sh_grid_index2();
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise vec3 result0;
    ivec2 result1;
    terrain(texelFetch(in_cell, at * each_cell, 0).xy, result0, result1);
    out_0 = result0;
    out_1 = result1;
}
