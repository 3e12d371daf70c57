#pragma OPENCL FP_CONTRACT OFF

// The nearest index in range. Nearly all are in range: a predicted branch costs less than a clamp before the load.
uint sh_at(int i, int size) {
    return __builtin_expect((uint)i < (uint)size, 1) ? (uint)i : (uint)clamp(i, 0, size - 1);
}

// The place of an element, the nearest one for an index that is out of range.
size_t sh_at2(int2 at, int2 size) {
    at = clamp(at, (int2)(0), size - 1);
    return (size_t)at.x * size.y + at.y;
}

__kernel void lookups(  // snapshot_programs.py:123
    ulong count,
    ulong first,
    __global const int *i_in,
    int i_step,
    __global const int *row_in,
    int row_step,
    __global const int *names,
    int names_size,
    __global const float *heights,
    int2 heights_size,
    __global const float *path,
    int path_size,
    __global float *result0_out,
    __global float *result1_out,
    __global int *result2_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    int i = i_in[element * i_step];
    int row = row_in[element * row_step];
    result0_out[element] = heights[sh_at2((int2)(row, names[sh_at(i, names_size)]), heights_size)];  // snapshot_programs.py:125
    vstore3(vload3(sh_at(i, path_size), path) - vload3(sh_at(0, path_size), path), element, result1_out);
    result2_out[element] = path_size;
}
