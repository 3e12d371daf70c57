#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform int sh_first;
uniform int sh_width;
uniform ivec4 sh_grid_shape;
layout(location = 0) out vec3 out_0;

// i / n and i % n for i >= 0, n > 0, by way of floats: drivers divide the integers of each fragment on its own.
ivec2 sh_split(int i, int n) {
    int q = int(float(i) / float(n));
    q += int(floor(float(i - q * n) / float(n)));
    int r = i - q * n;
    return r < 0 ? ivec2(q - 1, r + n) : r < n ? ivec2(q, r) : ivec2(q + 1, r - n);
}

ivec2 sh_grid_index2() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    int i = sh_first + at.y * sh_width + at.x;
    return sh_split(i, sh_grid_shape.y);
}

vec3 checkered() {  // snapshot_programs.py:173
    precise vec2 uv = (vec2(sh_grid_index2()) + zero) / (vec2(sh_grid_shape.xy) + zero);  // snapshot_programs.py:176
    precise vec3 result = vec3(uv, float((sh_grid_index2().x ^ sh_grid_index2().y) & 1) + zero);  // snapshot_programs.py:177
    return result;
}

void main() {
    out_0 = checkered();
}
