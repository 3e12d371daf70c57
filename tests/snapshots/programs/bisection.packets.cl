__kernel void bisection(  // snapshot_programs.py:185
    ulong count,
    int first,
    int row,
    __global const float *x_in,
    int x_step,
    __global float *result_out,
    __global int *status_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    int8 active = packet.active;
    int status = 1;
    float8 low = (float8)(0.0f);  // snapshot_programs.py:187
    float8 high = sh_max8(x, (float8)(1.0f));
    int iterations = 0;  // snapshot_programs.py:188
    int8 status_out_2 = (int8)(status);
    float8 low_in = low;
    int8 live = active;
    while (true) {
        iterations += 1u;
        if (iterations > 1048576) {
            status = 2;
            status_out_2 = live ? (int8)(status) : status_out_2;
            break;
        }
        float8 middle = (low_in + high) / 2.0f;  // snapshot_programs.py:189
        int8 t = middle * middle < x;  // snapshot_programs.py:190
        int8 active_2 = live & t;
        low_in = active_2 ? middle : low_in;  // snapshot_programs.py:191
        int8 active_3 = live & ~t;
        high = active_3 ? middle : high;  // snapshot_programs.py:193
        int8 leaving = live & (high - low_in <= 1e-06f * high);
        if (sh_any(leaving)) {  // snapshot_programs.py:188
            low = leaving ? low_in : low;
            live &= ~leaving;
            if (!sh_any(live)) {
                break;
            }
        }
    }
    float8 result = low;  // snapshot_programs.py:195
    sh_write_f(result_out, result, packet);
    sh_write_i(status_out, status_out_2, packet);
}
