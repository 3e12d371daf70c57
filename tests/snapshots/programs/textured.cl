#pragma OPENCL FP_CONTRACT OFF

// The greater argument; if one is NaN, the other.
float2 sh_max2(float2 a, float2 b) {
    return (a < b) | (a != a) ? b : a;
}

// The smaller argument; if one is NaN, the other.
float2 sh_min2(float2 a, float2 b) {
    return (b < a) | (a != a) ? b : a;
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod_i(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a % by;
    return rest != 0 && (rest ^ by) < 0 ? (int)(rest + (uint)by) : rest;
}

// The place of an element, the nearest one for an index that is out of range.
size_t sh_at2(int2 at, int2 size) {
    at = clamp(at, (int2)(0), size - 1);
    return (size_t)at.x * size.y + at.y;
}

float3 mix3(float3 a, float3 b, float3 t) {
    return a * (1.0f - t) + b * t;
}

float3 sample_image(float2 uv, __global const float *image, int2 image_size, int image_mode) {  // library.py:254
    bool linear = (image_mode & 1) != 0;  // library.py:261
    bool repeat = (image_mode & 2) != 0;
    int t = image_size.x;  // library.py:263
    int extents = image_size.y;
    float2 t2 = repeat ? uv - __builtin_elementwise_floor(uv) : sh_min2(sh_max2(uv, (float2)(-1.0f)), (float2)(2.0f));  // library.py:193
    float2 place = t2 * (float2)((float)extents, (float)t);  // library.py:222
    float shift = linear ? 0.5f : 0.0f;  // library.py:229
    float2 t3 = place - shift;  // library.py:230
    float2 corner = __builtin_elementwise_floor(t3);
    float2 t_4 = t3 - corner;  // library.py:231
    float2 t_5 = linear ? t_4 : (float2)(0.0f);  // library.py:233
    int2 cell = convert_int2_sat(corner);  // library.py:234
    float3 t6 = vload3(sh_at2((int2)(repeat ? sh_floormod_i(cell.y, t) : cell.y, repeat ? sh_floormod_i(cell.x, extents) : cell.x), image_size), image);  // library.py:264
    int2 t7 = as_int2(as_uint2(cell) + as_uint2((int2)(1, 0)));  // library.py:239
    float3 t8 = vload3(sh_at2((int2)(repeat ? sh_floormod_i(t7.y, t) : t7.y, repeat ? sh_floormod_i(t7.x, extents) : t7.x), image_size), image);  // library.py:264
    int2 t9 = as_int2(as_uint2(cell) + as_uint2((int2)(0, 1)));  // library.py:239
    float3 t10 = vload3(sh_at2((int2)(repeat ? sh_floormod_i(t9.y, t) : t9.y, repeat ? sh_floormod_i(t9.x, extents) : t9.x), image_size), image);  // library.py:264
    int2 t11 = as_int2(as_uint2(cell) + (uint)1);  // library.py:239
    float3 t12 = vload3(sh_at2((int2)(repeat ? sh_floormod_i(t11.y, t) : t11.y, repeat ? sh_floormod_i(t11.x, extents) : t11.x), image_size), image);  // library.py:264
    return mix3(mix3(t6, t8, (float3)(t_5.x)), mix3(t10, t12, (float3)(t_5.x)), (float3)(t_5.y));
}

__kernel void textured(  // snapshot_programs.py:128
    ulong count,
    ulong first,
    __global const float2 *uv_in,
    int uv_step,
    __global const float *image,
    int2 image_size,
    int image_mode,
    __global float *result_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float2 uv = uv_in[element * uv_step];
    vstore3(sample_image(uv * 2.0f, image, image_size, image_mode), element, result_out);  // snapshot_programs.py:130
}
