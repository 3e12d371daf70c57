__kernel void lit(  // snapshot_programs.py:137
    ulong count,
    int first,
    __global const float *p_in,
    int p_step,
    __global const float *n_in,
    int n_step,
    float3 turn_0,
    float3 turn_1,
    float3 turn_2,
    float3 light,
    __global float *result0_out,
    __global float *result1_out) {
    size_t start = ((size_t)first + get_global_id(0)) * 8;
    sh_packet packet = sh_packet_at(start, count);
    if (packet.left == 0) {
        return;
    }
    float8x3 p = sh_read_f3(p_in, p_step, packet);
    float8x3 n = sh_read_f3(n_in, n_step, packet);
    float8 t = sh_max8(dot3(normalize3(n), (float8x3){(float8)(light.x), (float8)(light.y), (float8)(light.z)}), (float8)(0.0f));  // snapshot_programs.py:139
    float8 result0_x = dot3((float8x3){(float8)(turn_0.x), (float8)(turn_0.y), (float8)(turn_0.z)}, p);
    float8 result0_y = dot3((float8x3){(float8)(turn_1.x), (float8)(turn_1.y), (float8)(turn_1.z)}, p);
    float8 result0_z = dot3((float8x3){(float8)(turn_2.x), (float8)(turn_2.y), (float8)(turn_2.z)}, p);
    float8 result1 = t;
    sh_write_f3(result0_out, (float8x3){result0_x, result0_y, result0_z}, packet);
    sh_write_f(result1_out, result1, packet);
}
