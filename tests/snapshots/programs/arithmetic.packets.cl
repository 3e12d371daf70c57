__kernel void arithmetic(  // snapshot_programs.py:21
    ulong count,
    int first,
    __global const float *a_in,
    int a_step,
    __global const float *b_in,
    int b_step,
    __global const float *v_in,
    int v_step,
    __global float *result0_out,
    __global float *result1_out) {
    size_t start = ((size_t)first + get_global_id(0)) * 8;
    sh_packet packet = sh_packet_at(start, count);
    if (packet.left == 0) {
        return;
    }
    float8 a = sh_read_f(a_in, a_step, packet);
    float8 b = sh_read_f(b_in, b_step, packet);
    float8x3 v = sh_read_f3(v_in, v_step, packet);
    float8 quadratic = (a * a + 2.0f * a * b - b * b) / (1.0f - a * b);  // snapshot_programs.py:23
    float8 t = a - (b - 1.0f);  // snapshot_programs.py:24
    float8 scaled_x = -v.x * t + 0.5f;
    float8 scaled_y = -v.y * t + 0.5f;
    float8 scaled_z = -v.z * t + 0.5f;
    float8 result0 = quadratic;  // snapshot_programs.py:25
    float8 result1_x = scaled_x;
    float8 result1_y = scaled_y;
    float8 result1_z = scaled_z;
    sh_write_f(result0_out, result0, packet);
    sh_write_f3(result1_out, (float8x3){result1_x, result1_y, result1_z}, packet);
}
