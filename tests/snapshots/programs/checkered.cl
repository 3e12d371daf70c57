#pragma OPENCL FP_CONTRACT OFF

__kernel void checkered(ulong count, ulong first, int2 grid_shape, __global float *result_out) {  // snapshot_programs.py:173
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    int2 grid_index = (int2)(element / grid_shape.y, element % grid_shape.y);
    float2 uv = convert_float2(grid_index) / convert_float2(grid_shape);  // snapshot_programs.py:176
    vstore3((float3)(uv, (float)((grid_index.x ^ grid_index.y) & 1)), element, result_out);  // snapshot_programs.py:177
}
