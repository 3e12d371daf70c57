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

// A number for each lane of an array, one after the other.
__attribute__((noinline)) int8 sh_read_i_each(__global const int *a, int8 at) {
    int place[8];
    int part0[8];
    vstore8(at, 0, place);
    for (int k = 0; k < 8; k += 1) {
        part0[k] = a[place[k]];
    }
    int8 v;
    v = vload8(0, part0);
    return v;
}

// A number for each lane of an array; with step 0, the same for all.
__attribute__((always_inline)) int8 sh_read_i(__global const int *a, int step, sh_packet p) {
    int8 v;
    if (step == 0) {
        v = (int8)(a[0]);
        return v;
    }
    a += p.first;
    if (!p.whole) {
        return sh_read_i_each(a, p.at);
    }
    if (p.row == 4) {
        v = vload8(0, a);
        return v;
    }
    v = (int8)(vload4(0, a), vload4(0, a + p.row));
    return v;
}

// Whether a lane is set.
bool sh_any(int8 mask) {
    ulong4 a = as_ulong4(mask);
    ulong2 b = a.lo | a.hi;
    return (b.x | b.y) != 0;
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0. Doubles are exact enough.
int8 sh_floormod_i8(int8 a, int8 b) {
    uint8 q = as_uint8(convert_int8(floor(convert_double8(a) / convert_double8(b))));
    return (b == 0) | (b == -1) ? (int8)(0) : as_int8(as_uint8(a) - as_uint8(b) * q);
}

// floor(a / b), by way of doubles, which are exact enough; 0 for b = 0, and INT_MIN for INT_MIN / -1.
int8 sh_floordiv_i8(int8 a, int8 b) {
    int8 q = convert_int8(floor(convert_double8(a) / convert_double8(b)));
    q = b == -1 ? as_int8(-as_uint8(a)) : q;
    return b == 0 ? (int8)(0) : q;
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

__kernel void collatz(  // snapshot_programs.py:61
    ulong count,
    int row,
    __global const int *n_in,
    int n_step,
    __global int *result_out,
    __global int *status_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    int8 n = sh_read_i(n_in, n_step, packet);
    int8 active = packet.active;
    int status = 1;
    int steps = 0;  // snapshot_programs.py:63
    int turns = 0;  // snapshot_programs.py:64
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
        turns += 1u;
        if (turns > 1048576) {
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
