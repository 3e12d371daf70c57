__kernel void lookups(  // snapshot_programs.py:123
    ulong count,
    int first,
    int row,
    __global const int *i_in,
    int i_step,
    __global const int *row_in,
    int row_step,
    __global const int *names,
    int names_size,
    __global const float *heights,
    int2 heights_size,
    __global const float4 *path,
    int path_size,
    __global float *result0_out,
    __global float *result1_out,
    __global int *result2_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    int8 i = sh_read_i(i_in, i_step, packet);
    int8 row_2 = sh_read_i(row_in, row_step, packet);
    float8 t = sh_gather_f(heights, sh_at2_lanes((int8x2){row_2, sh_gather_i(names, clamp(i, 0, names_size - 1))}, heights_size));  // snapshot_programs.py:125
    float8x3 t2 = sh_gather_f3(path, clamp(i, 0, path_size - 1));
    float3 t3 = path[sh_at(0, path_size)].xyz;
    float8 result0 = t;
    float8 result1_x = t2.x - t3.x;
    float8 result1_y = t2.y - t3.y;
    float8 result1_z = t2.z - t3.z;
    int result2 = path_size;
    sh_write_f(result0_out, result0, packet);
    sh_write_f3(result1_out, (float8x3){result1_x, result1_y, result1_z}, packet);
    sh_write_i(result2_out, (int8)(result2), packet);
}
