__kernel void edges(  // snapshot_programs.py:160
    ulong count,
    int first,
    __global const float *x_in,
    int x_step,
    __global const float *y_in,
    int y_step,
    __global float *result0_out,
    __global float *result1_out,
    __global float *result2_out,
    __global int *result3_out,
    __global float *result4_out,
    __global float *result5_out,
    __global uint *result6_out) {
    size_t start = ((size_t)first + get_global_id(0)) * 8;
    sh_packet packet = sh_packet_at(start, count);
    if (packet.left == 0) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    float8 y = sh_read_f(y_in, y_step, packet);
    float8 result0 = sh_min8(x, y);  // snapshot_programs.py:162
    float8 result1 = sign(x) + 0.0f;
    float8 result2 = rint(x);
    int8 result3 = convert_int8_sat(x);
    float8 result4 = mod1(x, y);
    float8 result5 = sh_min8(sh_max8(x, (float8)(0.0f)), y);
    uint8 result6 = sh_bits8(x);
    sh_write_f(result0_out, result0, packet);
    sh_write_f(result1_out, result1, packet);
    sh_write_f(result2_out, result2, packet);
    sh_write_i(result3_out, result3, packet);
    sh_write_f(result4_out, result4, packet);
    sh_write_f(result5_out, result5, packet);
    sh_write_u(result6_out, result6, packet);
}
