#pragma OPENCL FP_CONTRACT OFF

// The elements of a packet: 2 rows of 4 in an array that is `row` wide.
// Each lane holds the element `first + at`, which is in column x of line y.
typedef struct {
    size_t first;
    int row;
    int8 at;
    int8 x;
    int8 y;
    int8 active;
    bool whole;
    bool empty;
} sh_packet;

// Where this work item's packet begins: its column and line.
__attribute__((always_inline)) int2 sh_corner(int row) {
    int i = get_global_id(0), j = get_global_id(1);
    return row == 4 ? (int2)(0, i * 2) : (int2)(i * 4, j * 2);
}

// The packet that begins there; the last one of a row, and the last row, may hold fewer elements.
__attribute__((always_inline)) sh_packet sh_packet_at(int2 corner, ulong count, int row) {
    int x = corner.x, y = corner.y;
    sh_packet p;
    p.first = (size_t)y * row + x;
    p.row = row;
    p.empty = p.first >= count || x >= row;
    int left = (int)min(count - p.first, (ulong)INT_MAX);
    p.x = (int8)(0, 1, 2, 3, 0, 1, 2, 3);
    p.at = p.x + row * (int8)(0, 0, 0, 0, 1, 1, 1, 1);
    p.active = (p.x < row - x) & (p.at < left);
    p.whole = x + 4 <= row && left > row + 3;
    p.at &= p.active;
    p.x += x;
    p.y = y + (int8)(0, 0, 0, 0, 1, 1, 1, 1);
    return p;
}

// Whether a lane is set.
bool sh_any(int8 mask) {
    ulong4 a = as_ulong4(mask);
    ulong2 b = a.lo | a.hi;
    return (b.x | b.y) != 0;
}

// A number for each lane of an array, one after the other.
__attribute__((noinline)) float8 sh_read_f_each(__global const float *a, int8 at) {
    int place[8];
    float part0[8];
    vstore8(at, 0, place);
    for (int k = 0; k < 8; k += 1) {
        part0[k] = a[place[k]];
    }
    float8 v;
    v = vload8(0, part0);
    return v;
}

// A number for each lane of an array; with step 0, the same for all.
__attribute__((always_inline)) float8 sh_read_f(__global const float *a, int step, sh_packet p) {
    float8 v;
    if (step == 0) {
        v = (float8)(a[0]);
        return v;
    }
    a += p.first;
    if (!p.whole) {
        return sh_read_f_each(a, p.at);
    }
    if (p.row == 4) {
        v = vload8(0, a);
        return v;
    }
    v = (float8)(vload4(0, a), vload4(0, a + p.row));
    return v;
}

// Each lane's number into its element of an array, one after the other.
__attribute__((noinline)) void sh_write_i_each(
    __global int *a, int8 v, int8 at, int8 active) {
    int place[8], there[8];
    int part0[8];
    vstore8(at, 0, place);
    vstore8(active, 0, there);
    vstore8(v, 0, part0);
    for (int k = 0; k < 8; k += 1) {
        if (there[k]) {
            a[place[k]] = part0[k];
        }
    }
}

// Each lane's number into its element of an array.
__attribute__((always_inline)) void sh_write_i(__global int *a, int8 v, sh_packet p) {
    a += p.first;
    if (!p.whole) {
        sh_write_i_each(a, v, p.at, p.active);
        return;
    }
    if (p.row == 4) {
        vstore8(v, 0, a);
        return;
    }
    int8 x = v;
    vstore4(x.s0123, 0, a);
    vstore4(x.s4567, 0, a + p.row);
}

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
        int turns = 0;
        int8 result0_in_2 = result0_in;
        int8 result1_in_2 = result1_in;
        int8 returned_in_2 = returned_in;
        int8 live_2 = live;
        while (j < i) {
            turns += 1u;
            if (turns > 1048576) {
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
    int row,
    __global const float *x_in,
    int x_step,
    __global int *result0_out,
    __global int *result1_out,
    __global int *status_out) {
    int2 corner = sh_corner(row);
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
