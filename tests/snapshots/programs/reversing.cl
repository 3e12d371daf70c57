#pragma OPENCL FP_CONTRACT OFF

// The component at i, clamped.
float sh_pick4(float4 v, int i) {
    return i <= 0 ? v.x : (i == 1 ? v.y : (i == 2 ? v.z : v.w));
}

// The nearest index in range. Nearly all are in range: a predicted branch costs less than a clamp before the load.
uint sh_at(int i, int size) {
    return __builtin_expect((uint)i < (uint)size, 1) ? (uint)i : (uint)clamp(i, 0, size - 1);
}

__kernel void reversing(  // snapshot_programs.py:111
    ulong count,
    ulong first,
    __global const float4 *x_in,
    int x_step,
    __global const int *n_in,
    int n_step,
    __global float *result_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float4 x = x_in[element * x_step];
    int n = n_in[element * n_step];
    float stack[4] = {0.0f};  // snapshot_programs.py:113
    for (int i = 0; i < 4; i += 1) {  // snapshot_programs.py:114
        if (i >= 0 && i < 4) {  // snapshot_programs.py:115
            stack[i] = sh_pick4(x, i);
        }
    }
    result_out[element] = stack[sh_at((int)(3u - n), 4)];  // snapshot_programs.py:116
}
