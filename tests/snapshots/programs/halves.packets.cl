__kernel void halves(  // snapshot_programs.py:180
    ulong count,
    int first,
    __global const float *x_in,
    int x_step,
    __global const float *f_in,
    int f_step,
    __global float *result0_out,
    __global float *result1_out) {
    size_t start = ((size_t)first + get_global_id(0)) * 8;
    sh_packet packet = sh_packet_at(start, count);
    if (packet.left == 0) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    float8 f = sh_read_f(f_in, f_step, packet);
    float8 result0 = sh_half8(sh_half8(x * x) + 0.099975586f);  // snapshot_programs.py:182
    float8 result1 = f + x;
    sh_write_f(result0_out, result0, packet);
    sh_write_f(result1_out, result1, packet);
}
