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

// Whether a lane is set.
bool sh_any(int8 mask) {
    ulong4 a = as_ulong4(mask);
    ulong2 b = a.lo | a.hi;
    return (b.x | b.y) != 0;
}

typedef struct {
    float8 x, y, z;
} float8x3;

// Each lane's vector into its element of an array, one after the other.
__attribute__((noinline)) void sh_write_f3_each(
    __global float *a, float8x3 v, int8 at, int8 active) {
    int place[8], there[8];
    float part0[8], part1[8], part2[8];
    vstore8(at, 0, place);
    vstore8(active, 0, there);
    vstore8(v.x, 0, part0);
    vstore8(v.y, 0, part1);
    vstore8(v.z, 0, part2);
    for (int k = 0; k < 8; k += 1) {
        if (there[k]) {
            a[(size_t)place[k] * 3] = part0[k];
            a[(size_t)place[k] * 3 + 1] = part1[k];
            a[(size_t)place[k] * 3 + 2] = part2[k];
        }
    }
}

// Each lane's vector into its element of an array.
__attribute__((always_inline)) void sh_write_f3(__global float *a, float8x3 v, sh_packet p) {
    a += p.first * 3;
    if (!p.whole) {
        sh_write_f3_each(a, v, p.at, p.active);
        return;
    }
    float8 x = v.x;
    float8 y = v.y;
    float8 z = v.z;
    float8 ra0 = (float8)(x.s0, x.s0, y.s0, y.s0, x.s4, x.s4, y.s4, y.s4);
    float8 ra1 = (float8)(z.s0, z.s0, x.s1, x.s1, z.s4, z.s4, x.s5, x.s5);
    float8 ra = (float8)(ra0.s0, ra0.s2, ra1.s0, ra1.s2, ra0.s4, ra0.s6, ra1.s4, ra1.s6);
    float8 rb0 = (float8)(y.s1, y.s1, z.s1, z.s1, y.s5, y.s5, z.s5, z.s5);
    float8 rb1 = (float8)(x.s2, x.s2, y.s2, y.s2, x.s6, x.s6, y.s6, y.s6);
    float8 rb = (float8)(rb0.s0, rb0.s2, rb1.s0, rb1.s2, rb0.s4, rb0.s6, rb1.s4, rb1.s6);
    float8 rc0 = (float8)(z.s2, z.s2, x.s3, x.s3, z.s6, z.s6, x.s7, x.s7);
    float8 rc1 = (float8)(y.s3, y.s3, z.s3, z.s3, y.s7, y.s7, z.s7, z.s7);
    float8 rc = (float8)(rc0.s0, rc0.s2, rc1.s0, rc1.s2, rc0.s4, rc0.s6, rc1.s4, rc1.s6);
    vstore4(ra.s0123, 0, a);
    vstore4(rb.s0123, 1, a);
    vstore4(rc.s0123, 2, a);
    vstore4(ra.s4567, 0, a + 3 * p.row);
    vstore4(rb.s4567, 1, a + 3 * p.row);
    vstore4(rc.s4567, 2, a + 3 * p.row);
}

__kernel void branches(  // snapshot_programs.py:47
    ulong count,
    int row,
    __global const float *x_in,
    int x_step,
    __global float *result_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    int8 active = packet.active;
    float8 color_x = (float8)(0.0f);  // snapshot_programs.py:49
    float8 color_y = (float8)(0.0f);
    float8 color_z = (float8)(0.0f);
    int8 t = x < 0.0f;  // snapshot_programs.py:50
    int8 active_2 = active & t;
    color_x = active_2 ? -x : color_x;  // snapshot_programs.py:51
    int8 active_3 = active & ~t;
    if (sh_any(active_3)) {
        int8 t2 = x > 1.0f;  // snapshot_programs.py:52
        int8 active_4 = active_3 & t2;
        color_y = active_4 ? x : color_y;  // snapshot_programs.py:53
        int8 active_5 = active_4 & (x > 2.0f);
        color_x = active_5 ? (float8)(0.0f) : color_x;  // snapshot_programs.py:55
        color_y = active_5 ? color_y * 0.5f : color_y;
        color_z = active_5 ? (float8)(0.0f) : color_z;
        int8 active_6 = active_3 & ~t2;
        color_z = active_6 ? 1.0f - x : color_z;  // snapshot_programs.py:57
    }
    float8 result_x = color_x;  // snapshot_programs.py:58
    float8 result_y = color_y;
    float8 result_z = color_z;
    sh_write_f3(result_out, (float8x3){result_x, result_y, result_z}, packet);
}
