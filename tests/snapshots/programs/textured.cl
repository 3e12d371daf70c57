#pragma OPENCL FP_CONTRACT OFF

// The number where one is NaN.
float2 sh_max2(float2 a, float2 b) {
    return !(a >= b) & (b == b) ? b : a;
}

// The number where one is NaN.
float2 sh_min2(float2 a, float2 b) {
    return !(a <= b) & (b == b) ? b : a;
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod_i(int a, int b) {
    if (b == 0 || b == -1) {
        return 0;
    }
    int r = a % b;
    return r != 0 && (r < 0) != (b < 0) ? r + b : r;
}

// The place of an element, the nearest one for an index that is out of range.
size_t sh_at2(int2 at, int2 size) {
    at = clamp(at, (int2)(0), size - 1);
    return (size_t)at.x * size.y + at.y;
}

float3 mix3(float3 a, float3 b, float3 t) {
    return a * (1.0f - t) + b * t;
}

float3 sample_image(float2 uv, __global const float *image, int2 image_size, int image_mode) {  // library.py:182
    int t = image_size.x;  // library.py:183
    int t2 = image_size.y;
    bool t3 = (image_mode & 1) != 0;  // library.py:185
    bool t4 = (image_mode & 2) != 0;
    float2 size = (float2)((float)t2, (float)t);  // library.py:187
    float2 inside = t4 ? uv - __builtin_elementwise_floor(uv) : sh_min2(sh_max2(uv, (float2)(-1.0f)), (float2)(2.0f));  // library.py:194
    float2 place = inside * size;  // library.py:196
    float shift = t3 ? 0.5f : 0.0f;  // library.py:205
    float2 t5 = place - shift;  // library.py:206
    float2 corner = __builtin_elementwise_floor(t5);
    float2 t_6 = t5 - corner;  // library.py:207
    float2 t_7 = t3 ? t_6 : (float2)(0.0f);  // library.py:209
    int2 cell = convert_int2_sat(corner);  // library.py:210
    float3 t8 = vload3(sh_at2((int2)(t4 ? sh_floormod_i(cell.y, t) : cell.y, t4 ? sh_floormod_i(cell.x, t2) : cell.x), image_size), image);  // library.py:201
    int2 t9 = as_int2(as_uint2(cell) + as_uint2((int2)(1, 0)));  // library.py:211
    float3 t10 = vload3(sh_at2((int2)(t4 ? sh_floormod_i(t9.y, t) : t9.y, t4 ? sh_floormod_i(t9.x, t2) : t9.x), image_size), image);  // library.py:201
    float3 top = mix3(t8, t10, (float3)(t_7.x));  // library.py:211
    int2 t11 = as_int2(as_uint2(cell) + as_uint2((int2)(0, 1)));  // library.py:212
    float3 t12 = vload3(sh_at2((int2)(t4 ? sh_floormod_i(t11.y, t) : t11.y, t4 ? sh_floormod_i(t11.x, t2) : t11.x), image_size), image);  // library.py:201
    int2 t13 = as_int2(as_uint2(cell) + (uint)1);  // library.py:212
    int column = t13.x;  // library.py:199
    int row = t13.y;  // library.py:200
    float3 t14 = vload3(sh_at2((int2)(t4 ? sh_floormod_i(row, t) : row, t4 ? sh_floormod_i(column, t2) : column), image_size), image);  // library.py:201
    float3 bottom = mix3(t12, t14, (float3)(t_7.x));  // library.py:212
    return mix3(top, bottom, (float3)(t_7.y));  // library.py:213
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
