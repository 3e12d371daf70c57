__kernel void packets(  // snapshot_programs.py:165
    ulong count,
    int first,
    int row,
    __global const float *x_in,
    int x_step,
    __global float *result_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    int8 active = packet.active;
    float8 y = x;  // snapshot_programs.py:167
    int8 t = x > 1.0f;  // snapshot_programs.py:168
    if (sh_any(active & t)) {
        y = t ? sqrt(x) : y;  // snapshot_programs.py:169
    }
    float8 result = y;  // snapshot_programs.py:170
    sh_write_f(result_out, result, packet);
}
