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

// The greater argument; if one is NaN, the other.
float sh_max(precise float a, precise float b) {
    precise float result = a < b || a != a ? b : a;
    return result;
}

// The smaller argument; if one is NaN, the other.
float sh_min(precise float a, precise float b) {
    precise float result = b < a || a != a ? b : a;
    return result;
}

// min(max(x, low), high).
float sh_clamp(precise float x, precise float low, precise float high) {
    precise float result = sh_min(sh_max(x, low), high);
    return result;
}

vec2 sh_clamp(precise vec2 a, precise vec2 b, precise vec2 c) {
    precise vec2 result = vec2(sh_clamp(a.x, b.x, c.x), sh_clamp(a.y, b.y, c.y));
    return result;
}

// The float truncated; the nearest int where it is out of range, and 0 for NaN.
int sh_to_int(precise float x) {
    precise bool t = x > -2.1474836e+09 && x < 2.1474836e+09;
    precise bool t2 = x >= 2.1474836e+09;
    precise bool t3 = x < 0.0;
    int result = t ? int(t ? x : zero) : (t2 ? 2147483647 : (t3 ? (-2147483647 - 1) : 0));
    return result;
}

ivec2 sh_to_int(precise vec2 a) {
    ivec2 result = ivec2(sh_to_int(a.x), sh_to_int(a.y));
    return result;
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a - a / by * by;
    int result = rest != 0 && (rest ^ by) < 0 ? rest + by : rest;
    return result;
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

vec3 sample_image(precise vec2 uv) {  // library.py:254
    precise bool linear = (image_mode & 1) != 0;  // library.py:261
    precise bool repeat = (image_mode & 2) != 0;
    int t = image_shape.x;  // library.py:263
    int extents = image_shape.y;
    precise vec2 place = (repeat ? uv - floor(uv) : sh_clamp(uv, vec2(-1.0), vec2(2.0))) * vec2(float(extents) + zero, float(t) + zero);  // library.py:222
    precise float shift = linear ? 0.5 : zero;  // library.py:229
    precise vec2 t2 = place - shift;  // library.py:230
    precise vec2 corner = floor(t2);
    precise vec2 t_3 = t2 - corner;  // library.py:231
    precise vec2 t_4 = linear ? t_3 : vec2(zero);  // library.py:233
    ivec2 cell = sh_to_int(corner);  // library.py:234
    precise vec3 t5 = image_at(ivec2(repeat ? sh_floormod(cell.y, t) : cell.y, repeat ? sh_floormod(cell.x, extents) : cell.x));  // library.py:264
    ivec2 t6 = cell + ivec2(1, 0);  // library.py:239
    precise vec3 t7 = mix3(t5, image_at(ivec2(repeat ? sh_floormod(t6.y, t) : t6.y, repeat ? sh_floormod(t6.x, extents) : t6.x)), vec3(t_4.x));  // library.py:241
    ivec2 t8 = cell + ivec2(0, 1);  // library.py:239
    ivec2 t9 = cell + 1;
    precise vec3 t10 = mix3(image_at(ivec2(repeat ? sh_floormod(t8.y, t) : t8.y, repeat ? sh_floormod(t8.x, extents) : t8.x)), image_at(ivec2(repeat ? sh_floormod(t9.y, t) : t9.y, repeat ? sh_floormod(t9.x, extents) : t9.x)), vec3(t_4.x));  // library.py:241
    precise vec3 result = mix3(t7, t10, vec3(t_4.y));  // library.py:264
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
