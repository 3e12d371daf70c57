#pragma OPENCL FP_CONTRACT OFF

__kernel void packets(  // snapshot_programs.py:165
    ulong count,
    ulong first,
    __global const float *x_in,
    int x_step,
    __global float *result_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float x = x_in[element * x_step];
    float y = x;  // snapshot_programs.py:167
    if (x > 1.0f) {  // snapshot_programs.py:168
        y = sqrt(x);  // snapshot_programs.py:169
    }
    result_out[element] = y;  // snapshot_programs.py:170
}
