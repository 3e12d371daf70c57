#pragma OPENCL FP_CONTRACT OFF

__kernel void branches(  // snapshot_programs.py:47
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
    float3 color = (float3)(0.0f);  // snapshot_programs.py:49
    if (x < 0.0f) {  // snapshot_programs.py:50
        color.x = -x;  // snapshot_programs.py:51
    } else if (x > 1.0f) {  // snapshot_programs.py:52
        color.y = x;  // snapshot_programs.py:53
        if (x > 2.0f) {  // snapshot_programs.py:54
            color *= 0.5f;  // snapshot_programs.py:55
        }
    } else {
        color.z = 1.0f - x;  // snapshot_programs.py:57
    }
    vstore3(color, element, result_out);  // snapshot_programs.py:58
}
