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

// The column and line at which this work item's packet begins. The dispatch begins with packet, or line, `first`.
__attribute__((always_inline)) int2 sh_corner(int first, int row) {
    int i = get_global_id(0), j = get_global_id(1);
    return row == 4 ? (int2)(0, (first + i) * 2) : (int2)(i * 4, (first + j) * 2);
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

typedef struct {
    float8 x, y;
} float8x2;

// A vector for each lane of an array, one after the other.
__attribute__((noinline)) float8x2 sh_read_f2_each(__global const float *a, int8 at) {
    int place[8];
    vstore8(at, 0, place);
    float part0[8], part1[8];
    for (int k = 0; k < 8; k += 1) {
        part0[k] = a[(size_t)place[k] * 2];
        part1[k] = a[(size_t)place[k] * 2 + 1];
    }
    float8x2 v;
    v.x = vload8(0, part0);
    v.y = vload8(0, part1);
    return v;
}

// A vector for each lane of an array; with step 0, the same for all.
__attribute__((always_inline)) float8x2 sh_read_f2(__global const float *a, int step, sh_packet p) {
    float8x2 v;
    if (step == 0) {
        v.x = (float8)(a[0]);
        v.y = (float8)(a[1]);
        return v;
    }
    a += p.first * 2;
    if (!p.whole) {
        return sh_read_f2_each(a, p.at);
    }
    float8 ra = (float8)(vload4(0, a), vload4(0, a + 2 * p.row));
    float8 rb = (float8)(vload4(1, a), vload4(1, a + 2 * p.row));
    v.x = (float8)(ra.s0, ra.s2, rb.s0, rb.s2, ra.s4, ra.s6, rb.s4, rb.s6);
    v.y = (float8)(ra.s1, ra.s3, rb.s1, rb.s3, ra.s5, ra.s7, rb.s5, rb.s7);
    return v;
}

// True if any lane is set.
bool sh_any(int8 mask) {
    ulong4 a = as_ulong4(mask);
    ulong2 b = a.lo | a.hi;
    return (b.x | b.y) != 0;
}

// Each lane's number into its element of an array, one after the other.
__attribute__((noinline)) void sh_write_f_each(
    __global float *a, float8 v, int8 at, int8 active) {
    int place[8], there[8];
    vstore8(at, 0, place);
    vstore8(active, 0, there);
    float part0[8];
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
    vstore8(at, 0, place);
    vstore8(active, 0, there);
    int part0[8];
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

__kernel void mandelbrot(  // snapshot_programs.py:36
    ulong count,
    int first,
    int row,
    __global const float *c_in,
    int c_step,
    __global float *result_out,
    __global int *status_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8x2 c = sh_read_f2(c_in, c_step, packet);
    int8 active = packet.active;
    float8 t = c.x;
    float8 t2 = c.y;
    int status = 1;
    float z_x = 0.0f;  // snapshot_programs.py:38
    float z_y = 0.0f;
    float n = 0.0f;  // snapshot_programs.py:39
    int iterations = 0;  // snapshot_programs.py:40
    float8 v = (float8)(z_x * z_x);  // snapshot_programs.py:41
    float8 v2 = (float8)(z_y * z_y);
    float8 n_out = (float8)(n);
    int8 status_out_2 = (int8)(status);
    float8 z_x_out = (float8)(z_x);
    float8 z_y_out = (float8)(z_y);
    int8 live = active;
    while (true) {  // snapshot_programs.py:40
        iterations += 1u;
        if (iterations > 1048576) {
            status = 2;
            status_out_2 = live ? (int8)(status) : status_out_2;
            break;
        }
        float8 t3 = 2.0f * z_x_out * z_y_out + t2;  // snapshot_programs.py:41
        z_x_out = v - v2 + t;
        z_y_out = t3;
        n += 1.0f;  // snapshot_programs.py:42
        v = z_x_out * z_x_out;  // snapshot_programs.py:43
        v2 = z_y_out * z_y_out;
        bool t4 = n >= 256.0f;
        int8 leaving = live & (v + v2 > 4.0f);
        int8 t5 = live;
        if (t4 || sh_any(leaving)) {  // snapshot_programs.py:40
            int8 t6 = leaving | (t5 & (int8)(-t4));
            n_out = t6 ? (float8)(n) : n_out;
            live &= ~t6;
            if (!sh_any(live)) {
                break;
            }
        }
    }
    float8 result = n_out;  // snapshot_programs.py:44
    sh_write_f(result_out, result, packet);
    sh_write_i(status_out, status_out_2, packet);
}
