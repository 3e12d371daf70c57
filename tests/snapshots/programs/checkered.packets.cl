__kernel void checkered(ulong count, int first, int row, int2 grid_shape, __global float *result_out) {  // snapshot_programs.py:173
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    int grid_line = corner.y;
    int8x2 grid_index = (int8x2){packet.y, packet.x};
    int8 t = grid_index.y;  // snapshot_programs.py:175
    float uv_x = (float)grid_line / (float)grid_shape.x;  // snapshot_programs.py:176
    float8 uv_y = convert_float8(t) / (float)grid_shape.y;
    float result_x = uv_x;  // snapshot_programs.py:177
    float8 result_y = uv_y;
    float8 result_z = convert_float8((grid_line ^ t) & 1);
    sh_write_f3(result_out, (float8x3){(float8)(result_x), result_y, result_z}, packet);
}
