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

// The number where one is NaN.
float8 sh_max8(float8 a, float8 b) {
    return !(a >= b) & (b == b) ? b : a;
}

// Whether a lane is set.
bool sh_any(int8 mask) {
    ulong4 a = as_ulong4(mask);
    ulong2 b = a.lo | a.hi;
    return (b.x | b.y) != 0;
}

// Each lane's number into its element of an array, one after the other.
__attribute__((noinline)) void sh_write_f_each(
    __global float *a, float8 v, int8 at, int8 active) {
    int place[8], there[8];
    float part0[8];
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
__attribute__((always_inline)) void sh_write_f(__global float *a, float8 v, sh_packet p) {
    a += p.first;
    if (!p.whole) {
        sh_write_f_each(a, v, p.at, p.active);
        return;
    }
    if (p.row == 4) {
        vstore8(v, 0, a);
        return;
    }
    float8 x = v;
    vstore4(x.s0123, 0, a);
    vstore4(x.s4567, 0, a + p.row);
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

__kernel void bisection(  // snapshot_programs.py:185
    ulong count,
    int row,
    __global const float *x_in,
    int x_step,
    __global float *result_out,
    __global int *status_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    int8 active = packet.active;
    int status = 1;
    float8 low = (float8)(0.0f);  // snapshot_programs.py:187
    float8 high = sh_max8(x, (float8)(1.0f));
    int turns = 0;  // snapshot_programs.py:188
    int8 status_out_2 = (int8)(status);
    float8 low_in = low;
    int8 live = active;
    while (true) {
        turns += 1u;
        if (turns > 1048576) {
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
