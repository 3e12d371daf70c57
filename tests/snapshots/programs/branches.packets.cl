__kernel void branches(  // snapshot_programs.py:47
    ulong count,
    int first,
    int row,
    __global const float *x_in,
    int x_step,
    __global float *result_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    int8 active = packet.active;
    float8 color_x = (float8)(0.0f);  // snapshot_programs.py:49
    float8 color_y = (float8)(0.0f);
    float8 color_z = (float8)(0.0f);
    int8 t = x < 0.0f;  // snapshot_programs.py:50
    int8 active_2 = active & t;
    color_x = active_2 ? -x : color_x;  // snapshot_programs.py:51
    int8 active_3 = active & ~t;
    if (sh_any(active_3)) {
        int8 t2 = x > 1.0f;  // snapshot_programs.py:52
        int8 active_4 = active_3 & t2;
        color_y = active_4 ? x : color_y;  // snapshot_programs.py:53
        int8 active_5 = active_4 & (x > 2.0f);
        color_x = active_5 ? (float8)(0.0f) : color_x;  // snapshot_programs.py:55
        color_y = active_5 ? color_y * 0.5f : color_y;
        color_z = active_5 ? (float8)(0.0f) : color_z;
        int8 active_6 = active_3 & ~t2;
        color_z = active_6 ? 1.0f - x : color_z;  // snapshot_programs.py:57
    }
    float8 result_x = color_x;  // snapshot_programs.py:58
    float8 result_y = color_y;
    float8 result_z = color_z;
    sh_write_f3(result_out, (float8x3){result_x, result_y, result_z}, packet);
}
