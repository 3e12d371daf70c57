#pragma OPENCL FP_CONTRACT OFF

// The smaller argument; if one is NaN, the other.
float sh_min(float a, float b) {
    return b < a || a != a ? b : a;
}

// The greater argument; if one is NaN, the other.
float sh_max(float a, float b) {
    return a < b || a != a ? b : a;
}

// The bits of x; every NaN gives the same bits.
uint sh_bits(float x) {
    return x != x ? 2143289344u : as_uint(x);
}

float mod1(float x, float y) {
    float quotient = __builtin_elementwise_floor(x / y);
    return x - y * (quotient == 0.0f && x != 0.0f && (x < 0.0f) != (y < 0.0f) && !isinf(y) ? -1.0f : quotient);
}

__kernel void edges(  // snapshot_programs.py:160
    ulong count,
    ulong first,
    __global const float *x_in,
    int x_step,
    __global const float *y_in,
    int y_step,
    __global float *result0_out,
    __global float *result1_out,
    __global float *result2_out,
    __global int *result3_out,
    __global float *result4_out,
    __global float *result5_out,
    __global uint *result6_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float x = x_in[element * x_step];
    float y = y_in[element * y_step];
    result0_out[element] = sh_min(x, y);  // snapshot_programs.py:162
    result1_out[element] = sign(x) + 0.0f;
    result2_out[element] = __builtin_elementwise_roundeven(x);
    result3_out[element] = convert_int_sat(x);
    result4_out[element] = mod1(x, y);
    result5_out[element] = sh_min(sh_max(x, 0.0f), y);
    result6_out[element] = sh_bits(x);
}
