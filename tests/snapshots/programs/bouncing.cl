#pragma OPENCL FP_CONTRACT OFF

bool bounce(float2 *position, float2 *velocity, float floor_) {  // snapshot_programs.py:92
    if (position->y > floor_) {  // snapshot_programs.py:94
        return false;  // snapshot_programs.py:95
    }
    position->y = 2.0f * floor_ - position->y;  // snapshot_programs.py:96
    velocity->y = -velocity->y;  // snapshot_programs.py:97
    return true;  // snapshot_programs.py:98
}

__kernel void bouncing(  // snapshot_programs.py:101
    ulong count,
    ulong first,
    __global const float2 *position_in,
    int position_step,
    __global const float2 *velocity_in,
    int velocity_step,
    __global float2 *result0_out,
    __global int *result1_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float2 position = position_in[element * position_step];
    float2 velocity = velocity_in[element * velocity_step];
    int hits = 0;  // snapshot_programs.py:103
    for (int i = 0; i < 10; i += 1) {  // snapshot_programs.py:104
        position += velocity * 0.1f;  // snapshot_programs.py:105
        bool t = bounce(&position, &velocity, 0.0f);  // snapshot_programs.py:106
        if (t) {
            hits += 1u;  // snapshot_programs.py:107
        }
    }
    result0_out[element] = position;  // snapshot_programs.py:108
    result1_out[element] = hits;
}
