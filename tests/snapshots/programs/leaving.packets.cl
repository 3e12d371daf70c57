void leaving_packet(  // snapshot_programs.py:82
    float8 x,
    int8 *result0,
    int8 *result1,
    int8 *status_out,
    int2 corner,
    ulong count,
    int row) {
    *result0 = (int8)(0);
    *result1 = (int8)(0);
    sh_packet packet = sh_packet_at(corner, count, row);
    int8 active = packet.active;
    int8 running = active;
    int status = 1;
    *status_out = (int8)(status);
    int8 leaving_2 = active & isnan(x);
    if (sh_any(leaving_2)) {
        *status_out = leaving_2 ? (int8)(0) : *status_out;  // snapshot_programs.py:84
        running &= ~leaving_2;
    }
    if (!sh_any(running)) {
        return;
    }
    int i = 0;  // snapshot_programs.py:85
    int8 result0_in = *result0;
    int8 result1_in = *result1;
    int8 status_in = *status_out;
    int8 returned = (int8)(0);
    int8 returned_in = returned;
    int8 live = running;
    while (true) {
        if (i >= 4) {
            *result0 = live ? result0_in : *result0;
            *result1 = live ? result1_in : *result1;
            *status_out = live ? status_in : *status_out;
            returned = live ? returned_in : returned;
            break;
        }
        int j = 0;  // snapshot_programs.py:86
        int iterations = 0;
        int8 result0_in_2 = result0_in;
        int8 result1_in_2 = result1_in;
        int8 returned_in_2 = returned_in;
        int8 live_2 = live;
        while (j < i) {
            iterations += 1u;
            if (iterations > 1048576) {
                status = 2;
                status_in = live_2 ? (int8)(status) : status_in;
                break;
            }
            int8 leaving_3 = live_2 & (x < (float)(int)(i * (uint)j));
            if (sh_any(leaving_3)) {
                result0_in_2 = leaving_3 ? (int8)(i) : result0_in_2;  // snapshot_programs.py:88
                result1_in_2 = leaving_3 ? (int8)(j) : result1_in_2;
                returned_in_2 = leaving_3 ? (int8)(-1) : returned_in_2;
                result0_in = leaving_3 ? result0_in_2 : result0_in;
                result1_in = leaving_3 ? result1_in_2 : result1_in;
                returned_in = leaving_3 ? returned_in_2 : returned_in;
                live_2 &= ~leaving_3;
                if (!sh_any(live_2)) {
                    break;
                }
            }
            j += 1u;  // snapshot_programs.py:86
        }
        int8 leaving_3 = live & (status_in != 1);
        if (sh_any(leaving_3)) {
            *status_out = leaving_3 ? status_in : *status_out;
            live &= ~leaving_3;
            if (!sh_any(live)) {  // snapshot_programs.py:86
                break;
            }
        }
        int8 leaving_4 = live & returned_in;
        if (sh_any(leaving_4)) {
            *result0 = leaving_4 ? result0_in : *result0;
            *result1 = leaving_4 ? result1_in : *result1;
            *status_out = leaving_4 ? status_in : *status_out;
            returned = leaving_4 ? returned_in : returned;
            live &= ~leaving_4;
            if (!sh_any(live)) {
                break;
            }
        }
        i += 1u;  // snapshot_programs.py:85
    }
    int8 leaving_3 = running & (*status_out != 1);
    if (sh_any(leaving_3)) {
        running &= ~leaving_3;
    }
    int8 leaving_4 = running & returned;
    if (sh_any(leaving_4)) {
        running &= ~leaving_4;
    }
    *result0 = running ? (int8)(-1) : *result0;  // snapshot_programs.py:89
    *result1 = running ? (int8)(-1) : *result1;
}

__kernel void leaving(  // snapshot_programs.py:82
    ulong count,
    int first,
    int row,
    __global const float *x_in,
    int x_step,
    __global int *result0_out,
    __global int *result1_out,
    __global int *status_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    int8 result0;
    int8 result1;
    int8 status_out_2;
    leaving_packet(x, &result0, &result1, &status_out_2, corner, count, row);
    sh_write_i(result0_out, result0, packet);
    sh_write_i(result1_out, result1, packet);
    sh_write_i(status_out, status_out_2, packet);
}
