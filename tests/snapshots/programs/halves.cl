#pragma OPENCL FP_CONTRACT OFF

// x rounded to binary16.
float sh_half(float x) {
    ushort bits;
    vstore_half_rte(x, 0, (half *)&bits);
    return vload_half(0, (half *)&bits);
}

__kernel void halves(  // snapshot_programs.py:180
    ulong count,
    ulong first,
    __global const float *x_in,
    int x_step,
    __global const float *f_in,
    int f_step,
    __global float *result0_out,
    __global float *result1_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float x = x_in[element * x_step];
    float f = f_in[element * f_step];
    result0_out[element] = sh_half(sh_half(x * x) + 0.099975586f);  // snapshot_programs.py:182
    result1_out[element] = f + x;
}
