#pragma OPENCL FP_CONTRACT OFF

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod_i(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a % by;
    return rest != 0 && (rest ^ by) < 0 ? (int)(rest + (uint)by) : rest;
}

// The nearest index in range. Nearly all are in range: a predicted branch costs less than a clamp before the load.
uint sh_at(int i, int size) {
    return __builtin_expect((uint)i < (uint)size, 1) ? (uint)i : (uint)clamp(i, 0, size - 1);
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
uint sh_floormod_u(uint a, uint b) {
    uint by = max(b, 1u);
    return b == 0u ? 0u : a % by;
}

float push(float4 *stack, float value) {  // test_opencl_text.py:37
    *stack = (float4)(value, stack->xyz);  // test_opencl_text.py:39
    return stack->w;  // test_opencl_text.py:40
}

__kernel void counting(  // test_opencl_text.py:59
    ulong count,
    ulong first,
    __global const float *x_in,
    int x_step,
    __global const uint *bits_in,
    int bits_step,
    __global float4 *result0_out,
    __global uchar *result1_out,
    __global int *result2_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float x = x_in[element * x_step];
    uint bits = bits_in[element * bits_step];
    float4 stack = (float4)(0.0f);  // test_opencl_text.py:62
    int counts[4] = {0};  // test_opencl_text.py:61
    for (int i = 0; i < 10; i += 1) {  // test_opencl_text.py:63
        int t = sh_floormod_i(i, 4);  // test_opencl_text.py:64
        if (t >= 0 && t < 4) {
            counts[t] = counts[sh_at(t, 4)] + 1u;
        }
        push(&stack, (float)counts[sh_at(i, 4)] * x);  // test_opencl_text.py:65
    }
    int3 mask = (int3)(-(sh_floormod_u(bits >> 3, 2u) == 1u), -(x > 0.0f), 0);  // test_opencl_text.py:66
    result0_out[element] = stack;  // test_opencl_text.py:67
    vstore3(convert_uchar3(-(mask & (stack.xyz > 1.0f))), element, result1_out);
    result2_out[element] = counts[1] * (uint)counts[2] - 7u;
}
