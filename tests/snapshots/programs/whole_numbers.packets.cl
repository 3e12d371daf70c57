uint8 scramble(uint8 state) {  // library.py:31
    uint8 word = ((state >> ((state >> 28) + 4u)) ^ state) * 277803737u;  // library.py:32
    return (word >> 22) ^ word;  // library.py:33
}

uint8 pcg(uint8 x) {  // library.py:39
    return scramble(x * 747796405u + 2891336453u);  // library.py:40
}

__kernel void whole_numbers(  // snapshot_programs.py:155
    ulong count,
    int first,
    __global const int *a_in,
    int a_step,
    __global const int *b_in,
    int b_step,
    __global const uint *u_in,
    int u_step,
    __global int *result0_out,
    __global int *result1_out,
    __global int *result2_out,
    __global uint *result3_out,
    __global float *result4_out,
    __global int *result5_out) {
    size_t start = ((size_t)first + get_global_id(0)) * 8;
    sh_packet packet = sh_packet_at(start, count);
    if (packet.left == 0) {
        return;
    }
    int8 a = sh_read_i(a_in, a_step, packet);
    int8 b = sh_read_i(b_in, b_step, packet);
    uint8 u = sh_read_u(u_in, u_step, packet);
    int8 result0 = sh_floordiv_i8(a, b);  // snapshot_programs.py:157
    int8 result1 = sh_floormod_i8(a, b);
    int8 result2 = (a << 2) ^ (b & ~a);
    uint8 result3 = u >> 7;
    float8 result4 = convert_float8(pcg(u) >> 8u) * 5.9604645e-08f;
    int8 result5 = as_int8((uint)(-2147483647 - 1) - as_uint8(a));
    sh_write_i(result0_out, result0, packet);
    sh_write_i(result1_out, result1, packet);
    sh_write_i(result2_out, result2, packet);
    sh_write_u(result3_out, result3, packet);
    sh_write_f(result4_out, result4, packet);
    sh_write_i(result5_out, result5, packet);
}
