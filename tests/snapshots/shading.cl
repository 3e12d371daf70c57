#pragma OPENCL FP_CONTRACT OFF

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

// The nearest index in range. Nearly all are in range: a predicted branch costs less than a clamp before the load.
uint sh_at(int i, int size) {
    return __builtin_expect((uint)i < (uint)size, 1) ? (uint)i : (uint)clamp(i, 0, size - 1);
}

// The greater argument; if one is NaN, the other.
float sh_max(float a, float b) {
    return a < b || a != a ? b : a;
}

// The smaller argument; if one is NaN, the other.
float sh_min(float a, float b) {
    return b < a || a != a ? b : a;
}

float dot3(float3 a, float3 b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

float3 normalize3(float3 v) {
    float t = fabs(v.x);
    float t2 = fabs(v.y);
    float t3 = fabs(v.z);
    float t4 = t < t2 ? t2 : t;
    float largest = t4 < t3 ? t3 : t4;
    float3 scaled = v * (largest > 4.611686e+18f ? 7.888609e-31f : (largest < 8.881784e-16f ? 1.2676506e+30f : 1.0f));
    float size = sqrt(dot3(scaled, scaled));
    bool t5 = size > 0.0f;
    return t5 ? scaled / (t5 ? size : 1.0f) : (float3)(0.0f);
}

float3 shade(float3 n, float3 light, float3 color) {  // test_opencl_text.py:29
    float d = dot3(n, light);  // test_opencl_text.py:31
    if (d < 0.0f) {  // test_opencl_text.py:32
        return color * 0.1f;  // test_opencl_text.py:33
    }
    return color * d;  // test_opencl_text.py:34
}

__kernel void shading(  // test_opencl_text.py:43
    ulong count,
    ulong first,
    __global const float *p_in,
    int p_step,
    __global const float *n_in,
    int n_step,
    __global const float *heights,
    int2 heights_size,
    __global const float *palette,
    int palette_size,
    float3 sky,
    __global float *result_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float3 p = vload3(element * p_step, p_in);
    float3 n = vload3(element * n_step, n_in);
    float3 color = (float3)(0.0f);  // test_opencl_text.py:45
    for (int i = 0; i < 4; i += 1) {  // test_opencl_text.py:46
        if (sh_floormod_i(i, 3) == 0) {  // test_opencl_text.py:47
            continue;  // test_opencl_text.py:48
        }
        float3 t = shade(normalize3(n), p, sky);  // test_opencl_text.py:49
        color += t * heights[sh_at2((int2)(i, i + 1u), heights_size)];
    }
    if (p.x > 1.0f) {  // test_opencl_text.py:50
        color = vload3(sh_at(convert_int_sat(p.y), palette_size), palette);  // test_opencl_text.py:51
    } else if (p.y > 1.0f) {  // test_opencl_text.py:52
        color = p > 0.0f ? color : (float3)(0.25f);  // test_opencl_text.py:53
    } else {
        color.z = sh_min(sh_max(p.z, 0.0f), 1.0f);  // test_opencl_text.py:55
    }
    vstore3(color, element, result_out);  // test_opencl_text.py:56
}
