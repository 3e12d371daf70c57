__kernel void reversing(  // snapshot_programs.py:111
    ulong count,
    int first,
    __global const float *x_in,
    int x_step,
    __global const int *n_in,
    int n_step,
    __global float *result_out) {
    size_t start = ((size_t)first + get_global_id(0)) * 8;
    sh_packet packet = sh_packet_at(start, count);
    if (packet.left == 0) {
        return;
    }
    float8x4 x = sh_read_f4(x_in, x_step, packet);
    int8 n = sh_read_i(n_in, n_step, packet);
    float8 t = x.x;
    float8 t2 = x.y;
    float8 t3 = x.z;
    float8 t4 = x.w;
    float8 stack[4] = {(float8)(0.0f)};  // snapshot_programs.py:113
    for (int i = 0; i < 4; i += 1) {  // snapshot_programs.py:114
        if (i >= 0 && i < 4) {  // snapshot_programs.py:115
            stack[i] = (int8)(-(i <= 0)) ? t : ((int8)(-(i == 1)) ? t2 : ((int8)(-(i == 2)) ? t3 : t4));
        }
    }
    float8 result = sh_pick_f4(stack, as_int8((uint)3 - as_uint8(n)));  // snapshot_programs.py:116
    sh_write_f(result_out, result, packet);
}
