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

// Each lane's element at its own index, clamped.
__attribute__((always_inline)) float8 sh_pick_f4(const float8 *a, int8 i) {
    int8 n = i;
    return n <= 0 ? a[0] : n == 1 ? a[1] : n == 2 ? a[2] : a[3];
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

__kernel void reversing(  // snapshot_programs.py:111
    ulong count,
    int row,
    __global const float *x_in,
    int x_step,
    __global const int *n_in,
    int n_step,
    __global float *result_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8x4 x = sh_read_f4(x_in, x_step, packet);
    int8 n = sh_read_i(n_in, n_step, packet);
    float8 t = x.x;
    float8 t2 = x.y;
    float8 t3 = x.z;
    float8 t4 = x.w;
    float8 stack[4] = {(float8)(0.0f)};  // snapshot_programs.py:113
    for (int i = 0; i < 4; i += 1) {  // snapshot_programs.py:114
        if (i >= 0 && i < 4) {  // snapshot_programs.py:115
            stack[i] = (int8)(-(i <= 0)) ? t : ((int8)(-(i == 1)) ? t2 : ((int8)(-(i == 2)) ? t3 : t4));
        }
    }
    float8 result = sh_pick_f4(stack, as_int8((uint)3 - as_uint8(n)));  // snapshot_programs.py:116
    sh_write_f(result_out, result, packet);
}
