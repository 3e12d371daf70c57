__kernel void collatz(  // snapshot_programs.py:61
    ulong count,
    int first,
    int row,
    __global const int *n_in,
    int n_step,
    __global int *result_out,
    __global int *status_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    int8 n = sh_read_i(n_in, n_step, packet);
    int8 active = packet.active;
    int status = 1;
    int steps = 0;  // snapshot_programs.py:63
    int iterations = 0;  // snapshot_programs.py:64
    int8 steps_out = (int8)(steps);
    int8 status_out_2 = (int8)(status);
    int8 live = active;
    while (true) {
        int8 leaving = live & (n <= 1);
        if (sh_any(leaving)) {
            steps_out = leaving ? (int8)(steps) : steps_out;
            live &= ~leaving;
            if (!sh_any(live)) {
                break;
            }
        }
        iterations += 1u;
        if (iterations > 1048576) {
            status = 2;
            status_out_2 = live ? (int8)(status) : status_out_2;
            break;
        }
        int8 t = sh_floormod_i8(n, (int8)(2)) == 0 ? sh_floordiv_i8(n, (int8)(2)) : as_int8(as_uint8(as_int8((uint)3 * as_uint8(n))) + (uint)1);  // snapshot_programs.py:65
        n = t;
        steps += 1u;  // snapshot_programs.py:66
    }
    int8 result = steps_out;  // snapshot_programs.py:67
    sh_write_i(result_out, result, packet);
    sh_write_i(status_out, status_out_2, packet);
}
