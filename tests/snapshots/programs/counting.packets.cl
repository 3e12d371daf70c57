void counting_packet(float8 x, int8 n, float8 *result, int8 *status_out, int2 corner, ulong count, int row) {  // snapshot_programs.py:70
    *result = (float8)(0.0f);
    sh_packet packet = sh_packet_at(corner, count, row);
    int8 active = packet.active;
    int8 running = active;
    int status = 1;
    float8 total = (float8)(0.0f);  // snapshot_programs.py:72
    int i = 0;  // snapshot_programs.py:73
    int iterations = 0;
    *status_out = (int8)(status);
    float8 total_in = total;
    int8 live = active;
    for (;; i += 1u) {
        int8 leaving = live & (i >= n);
        if (sh_any(leaving)) {
            total = leaving ? total_in : total;
            live &= ~leaving;
            if (!sh_any(live)) {
                break;
            }
        }
        iterations += 1u;
        if (iterations > 1048576) {
            status = 2;
            *status_out = live ? (int8)(status) : *status_out;
            break;
        }
        if (sh_floormod_i(i, 3) == 0) {  // snapshot_programs.py:74
            continue;
        }
        total_in += x * (float)i;  // snapshot_programs.py:75
        int8 leaving_2 = live & (total_in > 100.0f);
        if (sh_any(leaving_2)) {
            total = leaving_2 ? total_in : total;
            live &= ~leaving_2;
            if (!sh_any(live)) {  // snapshot_programs.py:76
                break;
            }
        }
    }
    int8 leaving = active & (*status_out != 1);
    if (sh_any(leaving)) {
        running &= ~leaving;
    }
    if (!sh_any(running)) {
        return;
    }
    for (int j = 8; j > 0; j -= 2u) {  // snapshot_programs.py:77
        total -= (float)j;  // snapshot_programs.py:78
    }
    *result = total;  // snapshot_programs.py:79
}

__kernel void counting(  // snapshot_programs.py:70
    ulong count,
    int first,
    int row,
    __global const float *x_in,
    int x_step,
    __global const int *n_in,
    int n_step,
    __global float *result_out,
    __global int *status_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    int8 n = sh_read_i(n_in, n_step, packet);
    float8 result;
    int8 status_out_2;
    counting_packet(x, n, &result, &status_out_2, corner, count, row);
    sh_write_f(result_out, result, packet);
    sh_write_i(status_out, status_out_2, packet);
}
