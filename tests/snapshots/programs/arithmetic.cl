#pragma OPENCL FP_CONTRACT OFF

__kernel void arithmetic(  // snapshot_programs.py:21
    ulong count,
    ulong first,
    __global const float *a_in,
    int a_step,
    __global const float *b_in,
    int b_step,
    __global const float *v_in,
    int v_step,
    __global float *result0_out,
    __global float *result1_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float a = a_in[element * a_step];
    float b = b_in[element * b_step];
    float3 v = vload3(element * v_step, v_in);
    float quadratic = (a * a + 2.0f * a * b - b * b) / (1.0f - a * b);  // snapshot_programs.py:23
    float3 scaled = -v * (a - (b - 1.0f)) + 0.5f;  // snapshot_programs.py:24
    result0_out[element] = quadratic;  // snapshot_programs.py:25
    vstore3(scaled, element, result1_out);
}
