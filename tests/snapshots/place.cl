#pragma OPENCL FP_CONTRACT OFF

__kernel void place(  // test_opencl_text.py:83
    ulong count,
    ulong first,
    int2 grid_shape,
    __global const int2 *offset_in,
    int offset_step,
    __global int2 *result0_out,
    __global uchar *result1_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    int2 grid_index = (int2)(element / grid_shape.y, element % grid_shape.y);
    int2 offset = offset_in[element * offset_step];
    int2 at = as_int2(as_uint2(grid_index) + as_uint2(offset));  // test_opencl_text.py:85
    result0_out[element] = at;  // test_opencl_text.py:86
    result1_out[element] = all(at < grid_shape);
}
