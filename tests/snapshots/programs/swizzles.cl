#pragma OPENCL FP_CONTRACT OFF

// The component at i, clamped.
float sh_pick4(float4 v, int i) {
    return i <= 0 ? v.x : (i == 1 ? v.y : (i == 2 ? v.z : v.w));
}

__kernel void swizzles(  // snapshot_programs.py:28
    ulong count,
    ulong first,
    __global const float4 *p_in,
    int p_step,
    __global const int *k_in,
    int k_step,
    __global float *result0_out,
    __global float *result1_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float4 p = p_in[element * p_step];
    int k = k_in[element * k_step];
    float4 q = (float4)(p.w + p.z, p.y, 0.0f, p.y);  // snapshot_programs.py:32
    vstore3(q.zyx, element, result0_out);  // snapshot_programs.py:33
    result1_out[element] = sh_pick4(q, k);
}
