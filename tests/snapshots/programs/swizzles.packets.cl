#pragma OPENCL FP_CONTRACT OFF

// The elements of a packet: 1 row of 8 in an array that is `row` wide.
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
    return row == 8 ? (int2)(0, i) : (int2)(i * 8, j);
}

// The packet that begins there; the last one of a row, and the last row, may hold fewer elements.
__attribute__((always_inline)) sh_packet sh_packet_at(int2 corner, ulong count, int row) {
    int x = corner.x, y = corner.y;
    sh_packet p;
    p.first = (size_t)y * row + x;
    p.row = row;
    p.empty = p.first >= count || x >= row;
    int left = (int)min(count - p.first, (ulong)INT_MAX);
    p.x = (int8)(0, 1, 2, 3, 4, 5, 6, 7);
    p.at = p.x;
    p.active = (p.x < row - x) & (p.at < left);
    p.whole = x + 8 <= row && left > 7;
    p.at &= p.active;
    p.x += x;
    p.y = y;
    return p;
}

typedef struct {
    float8 x, y, z, w;
} float8x4;

// A vector for each lane of an array, one after the other.
__attribute__((noinline)) float8x4 sh_read_f4_each(__global const float *a, int8 at) {
    int place[8];
    float part0[8], part1[8], part2[8], part3[8];
    vstore8(at, 0, place);
    for (int k = 0; k < 8; k += 1) {
        part0[k] = a[(size_t)place[k] * 4];
        part1[k] = a[(size_t)place[k] * 4 + 1];
        part2[k] = a[(size_t)place[k] * 4 + 2];
        part3[k] = a[(size_t)place[k] * 4 + 3];
    }
    float8x4 v;
    v.x = vload8(0, part0);
    v.y = vload8(0, part1);
    v.z = vload8(0, part2);
    v.w = vload8(0, part3);
    return v;
}

// A vector for each lane of an array; with step 0, the same for all.
__attribute__((always_inline)) float8x4 sh_read_f4(__global const float *a, int step, sh_packet p) {
    float8x4 v;
    if (step == 0) {
        v.x = (float8)(a[0]);
        v.y = (float8)(a[1]);
        v.z = (float8)(a[2]);
        v.w = (float8)(a[3]);
        return v;
    }
    a += p.first * 4;
    if (!p.whole) {
        return sh_read_f4_each(a, p.at);
    }
    float8 ra = (float8)(vload4(0, a), vload4(0, a + 16));
    float8 rb = (float8)(vload4(1, a), vload4(1, a + 16));
    float8 rc = (float8)(vload4(2, a), vload4(2, a + 16));
    float8 rd = (float8)(vload4(3, a), vload4(3, a + 16));
    float8 lo_ab = (float8)(ra.s0, rb.s0, ra.s1, rb.s1, ra.s4, rb.s4, ra.s5, rb.s5);
    float8 hi_ab = (float8)(ra.s2, rb.s2, ra.s3, rb.s3, ra.s6, rb.s6, ra.s7, rb.s7);
    float8 lo_cd = (float8)(rc.s0, rd.s0, rc.s1, rd.s1, rc.s4, rd.s4, rc.s5, rd.s5);
    float8 hi_cd = (float8)(rc.s2, rd.s2, rc.s3, rd.s3, rc.s6, rd.s6, rc.s7, rd.s7);
    v.x = (float8)(lo_ab.s0, lo_ab.s1, lo_cd.s0, lo_cd.s1, lo_ab.s4, lo_ab.s5, lo_cd.s4, lo_cd.s5);
    v.y = (float8)(lo_ab.s2, lo_ab.s3, lo_cd.s2, lo_cd.s3, lo_ab.s6, lo_ab.s7, lo_cd.s6, lo_cd.s7);
    v.z = (float8)(hi_ab.s0, hi_ab.s1, hi_cd.s0, hi_cd.s1, hi_ab.s4, hi_ab.s5, hi_cd.s4, hi_cd.s5);
    v.w = (float8)(hi_ab.s2, hi_ab.s3, hi_cd.s2, hi_cd.s3, hi_ab.s6, hi_ab.s7, hi_cd.s6, hi_cd.s7);
    return v;
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
    v = vload8(0, a);
    return v;
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
    vstore4(ra.s4567, 0, a + 12);
    vstore4(rb.s4567, 1, a + 12);
    vstore4(rc.s4567, 2, a + 12);
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
    vstore8(v, 0, a);
}

__kernel void swizzles(  // snapshot_programs.py:28
    ulong count,
    int row,
    __global const float *p_in,
    int p_step,
    __global const int *k_in,
    int k_step,
    __global float *result0_out,
    __global float *result1_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8x4 p = sh_read_f4(p_in, p_step, packet);
    int8 k = sh_read_i(k_in, k_step, packet);
    float8 t = p.w + p.z;  // snapshot_programs.py:31
    float result0_x = 0.0f;  // snapshot_programs.py:33
    float8 result0_y = p.y;
    float8 result0_z = t;
    float8 result1 = k <= 0 ? t : (k == 1 ? p.y : (k == 2 ? (float8)(0.0f) : p.y));
    sh_write_f3(result0_out, (float8x3){(float8)(result0_x), result0_y, result0_z}, packet);
    sh_write_f(result1_out, result1, packet);
}
