__attribute__((always_inline)) void bounce(  // snapshot_programs.py:92
    float8 position_x,
    float8 position_y,
    float8 velocity_x,
    float8 velocity_y,
    float floor_,
    int8 active,
    int8 *result,
    float8 *position_x_2,
    float8 *position_y_2,
    float8 *velocity_x_2,
    float8 *velocity_y_2) {
    *result = (int8)(0);
    int8 running = active;
    *position_x_2 = position_x;
    *position_y_2 = position_y;
    *velocity_x_2 = velocity_x;
    *velocity_y_2 = velocity_y;
    int8 leaving = active & (position_y > floor_);
    if (sh_any(leaving)) {
        *result = (int8)(0);  // snapshot_programs.py:95
        running &= ~leaving;
    }
    *position_y_2 = running ? 2.0f * floor_ - position_y : *position_y_2;  // snapshot_programs.py:96
    *velocity_y_2 = running ? -velocity_y : *velocity_y_2;  // snapshot_programs.py:97
    *result = running ? (int8)(-1) : *result;  // snapshot_programs.py:98
}

__kernel void bouncing(  // snapshot_programs.py:101
    ulong count,
    int first,
    int row,
    __global const float *position_in,
    int position_step,
    __global const float *velocity_in,
    int velocity_step,
    __global float *result0_out,
    __global int *result1_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8x2 position = sh_read_f2(position_in, position_step, packet);
    float8x2 velocity = sh_read_f2(velocity_in, velocity_step, packet);
    int8 active = packet.active;
    float8 position_x = position.x;
    float8 position_y = position.y;
    float8 velocity_x = velocity.x;
    float8 velocity_y = velocity.y;
    int8 hits = (int8)(0);  // snapshot_programs.py:103
    for (int i = 0; i < 10; i += 1) {  // snapshot_programs.py:104
        position_x += velocity_x * 0.1f;  // snapshot_programs.py:105
        position_y += velocity_y * 0.1f;
        int8 t;  // snapshot_programs.py:106
        float8 position_x_2;
        float8 position_y_2;
        float8 velocity_x_2;
        float8 velocity_y_2;
        bounce(position_x, position_y, velocity_x, velocity_y, 0.0f, active, &t, &position_x_2, &position_y_2, &velocity_x_2, &velocity_y_2);
        position_x = position_x_2;
        position_y = position_y_2;
        velocity_x = velocity_x_2;
        velocity_y = velocity_y_2;
        int8 active_2 = active & t;
        hits = active_2 ? as_int8(as_uint8(hits) + (uint)1) : hits;  // snapshot_programs.py:107
    }
    float8 result0_x = position_x;  // snapshot_programs.py:108
    float8 result0_y = position_y;
    int8 result1 = hits;
    sh_write_f2(result0_out, (float8x2){result0_x, result0_y}, packet);
    sh_write_i(result1_out, result1, packet);
}
