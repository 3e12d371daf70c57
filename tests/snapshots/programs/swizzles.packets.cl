__kernel void swizzles(  // snapshot_programs.py:28
    ulong count,
    int first,
    __global const float *p_in,
    int p_step,
    __global const int *k_in,
    int k_step,
    __global float *result0_out,
    __global float *result1_out) {
    size_t start = ((size_t)first + get_global_id(0)) * 8;
    sh_packet packet = sh_packet_at(start, count);
    if (packet.left == 0) {
        return;
    }
    float8x4 p = sh_read_f4(p_in, p_step, packet);
    int8 k = sh_read_i(k_in, k_step, packet);
    float8 t = p.w + p.z;  // snapshot_programs.py:31
    float result0_x = 0.0f;  // snapshot_programs.py:33
    float8 result0_y = p.y;
    float8 result0_z = t;
    float8 result1 = k <= 0 ? t : (k == 1 ? p.y : (k == 2 ? (float8)(0.0f) : p.y));
    sh_write_f3(result0_out, (float8x3){(float8)(result0_x), result0_y, result0_z}, packet);
    sh_write_f(result1_out, result1, packet);
}
