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
    float8x3 t = normalize3(n);  // snapshot_programs.py:139
    float8 result0_x = turn_0.x * p.x + turn_0.y * p.y + turn_0.z * p.z;
    float8 result0_y = turn_1.x * p.x + turn_1.y * p.y + turn_1.z * p.z;
    float8 result0_z = turn_2.x * p.x + turn_2.y * p.y + turn_2.z * p.z;
    float8 result1 = sh_max8(t.x * light.x + t.y * light.y + t.z * light.z, (float8)(0.0f));
    sh_write_f3(result0_out, (float8x3){result0_x, result0_y, result0_z}, packet);
    sh_write_f(result1_out, result1, packet);
}
