#pragma OPENCL FP_CONTRACT OFF

// The greater argument; if one is NaN, the other.
float sh_max(float a, float b) {
    return a < b || a != a ? b : a;
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

__kernel void lit(  // snapshot_programs.py:137
    ulong count,
    ulong first,
    __global const float *p_in,
    int p_step,
    __global const float *n_in,
    int n_step,
    float3 turn_0,
    float3 turn_1,
    float3 turn_2,
    float3 light,
    __global float *result0_out,
    __global float *result1_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float3 p = vload3(element * p_step, p_in);
    float3 n = vload3(element * n_step, n_in);
    vstore3((float3)(dot3(turn_0, p), dot3(turn_1, p), dot3(turn_2, p)), element, result0_out);  // snapshot_programs.py:139
    result1_out[element] = sh_max(dot3(normalize3(n), light), 0.0f);
}
