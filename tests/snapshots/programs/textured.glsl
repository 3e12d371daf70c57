#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

uniform int image_mode;
uniform sampler2D image;
uniform ivec2 image_shape;
float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_uv;
uniform int each_uv;  // 0 where one value serves all elements
layout(location = 0) out vec3 out_0;

// The number where one is NaN.
float sh_min(precise float a, precise float b) {
    precise bool second = b < a || a != a;
    return second ? b : a;
}

float sh_max(precise float a, precise float b) {
    precise bool second = a < b || a != a;
    return second ? b : a;
}

float sh_clamp(precise float x, precise float low, precise float high) {
    return sh_min(sh_max(x, low), high);
}

vec2 sh_clamp(precise vec2 x, precise vec2 low, precise vec2 high) {
    return vec2(sh_clamp(x.x, low.x, high.x), sh_clamp(x.y, low.y, high.y));
}

// Truncates and saturates; 0 for NaN.
int sh_int(precise float x) {
    precise bool inside = x > -2147483648.0 && x < 2147483648.0;
    precise bool above = x >= 2147483648.0;
    precise bool below = x <= -2147483648.0;
    return inside ? int(x) : above ? 2147483647 : below ? (-2147483647 - 1) : 0;
}

ivec2 sh_int(precise vec2 x) {
    return ivec2(sh_int(x.x), sh_int(x.y));
}

// a - b * floor(a / b); 0 for b = 0. Drivers' own % is unsigned.
int sh_floormod(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a - a / by * by;
    return rest != 0 && (rest ^ by) < 0 ? rest + by : rest;
}

// An element of image, the nearest where the index is out of range.
vec3 image_at(ivec2 at) {
    at = clamp(at, ivec2(0), image_shape - 1);
    int i = at.x * image_shape.y + at.y;
    return texelFetch(image, ivec2(i & 4095, i >> 12), 0).xyz;
}

vec3 mix3(precise vec3 a, precise vec3 b, precise vec3 t) {
    precise vec3 result = a * (1.0 - t) + b * t;
    return result;
}

vec3 sample_image(precise vec2 uv) {  // library.py:182
    int t = image_shape.x;  // library.py:183
    int t2 = image_shape.y;
    precise bool t3 = (image_mode & 1) != 0;  // library.py:185
    precise bool t4 = (image_mode & 2) != 0;
    precise vec2 size = vec2(float(t2) + zero, float(t) + zero);  // library.py:187
    precise vec2 inside = t4 ? uv - floor(uv) : sh_clamp(uv, vec2(-1.0), vec2(2.0));  // library.py:194
    precise vec2 place = inside * size;  // library.py:196
    precise float shift = t3 ? 0.5 : zero;  // library.py:205
    precise vec2 t5 = place - shift;  // library.py:206
    precise vec2 corner = floor(t5);
    precise vec2 t_6 = t5 - corner;  // library.py:207
    precise vec2 t_7 = t3 ? t_6 : vec2(zero);  // library.py:209
    ivec2 cell = sh_int(corner);  // library.py:210
    ivec2 t8 = cell + ivec2(1, 0);  // library.py:211
    precise vec3 top = mix3(image_at(ivec2(t4 ? sh_floormod(cell.y, t) : cell.y, t4 ? sh_floormod(cell.x, t2) : cell.x)), image_at(ivec2(t4 ? sh_floormod(t8.y, t) : t8.y, t4 ? sh_floormod(t8.x, t2) : t8.x)), vec3(t_7.x));
    ivec2 t9 = cell + ivec2(0, 1);  // library.py:212
    ivec2 t10 = cell + 1;
    int column = t10.x;  // library.py:199
    int row = t10.y;  // library.py:200
    precise vec3 bottom = mix3(image_at(ivec2(t4 ? sh_floormod(t9.y, t) : t9.y, t4 ? sh_floormod(t9.x, t2) : t9.x)), image_at(ivec2(t4 ? sh_floormod(row, t) : row, t4 ? sh_floormod(column, t2) : column)), vec3(t_7.x));  // library.py:212
    precise vec3 result = mix3(top, bottom, vec3(t_7.y));  // library.py:213
    return result;
}

vec3 textured(precise vec2 uv) {  // snapshot_programs.py:128
    precise vec3 result = sample_image(uv * 2.0);  // snapshot_programs.py:130
    return result;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    out_0 = textured(texelFetch(in_uv, at * each_uv, 0).xy);
}
