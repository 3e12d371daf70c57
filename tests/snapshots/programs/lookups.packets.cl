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

// The elements at these places, which are in range.
__attribute__((always_inline)) int8 sh_gather_i(__global const int *a, int8 at) {
    return (int8)(a[at.s0], a[at.s1], a[at.s2], a[at.s3], a[at.s4], a[at.s5], a[at.s6], a[at.s7]);
}

typedef struct {
    int8 x, y;
} int8x2;

// The places of elements, the nearest ones for indices that are out of range.
int8 sh_at2_lanes(int8x2 at, int2 size) {
    return clamp(at.x, 0, size.x - 1) * size.y + clamp(at.y, 0, size.y - 1);
}

// The elements at these places, which are in range.
__attribute__((always_inline)) float8 sh_gather_f(__global const float *a, int8 at) {
    return (float8)(a[at.s0], a[at.s1], a[at.s2], a[at.s3], a[at.s4], a[at.s5], a[at.s6], a[at.s7]);
}

typedef struct {
    float8 x, y, z;
} float8x3;

// The elements at these places, which are in range.
__attribute__((always_inline)) float8x3 sh_gather_f3(__global const float4 *a, int8 at) {
    float8x3 v;
    float8 ra = (float8)(a[at.s0], a[at.s4]);
    float8 rb = (float8)(a[at.s1], a[at.s5]);
    float8 rc = (float8)(a[at.s2], a[at.s6]);
    float8 rd = (float8)(a[at.s3], a[at.s7]);
    float8 lo_ab = (float8)(ra.s0, rb.s0, ra.s1, rb.s1, ra.s4, rb.s4, ra.s5, rb.s5);
    float8 hi_ab = (float8)(ra.s2, rb.s2, ra.s3, rb.s3, ra.s6, rb.s6, ra.s7, rb.s7);
    float8 lo_cd = (float8)(rc.s0, rd.s0, rc.s1, rd.s1, rc.s4, rd.s4, rc.s5, rd.s5);
    float8 hi_cd = (float8)(rc.s2, rd.s2, rc.s3, rd.s3, rc.s6, rd.s6, rc.s7, rd.s7);
    v.x = (float8)(lo_ab.s0, lo_ab.s1, lo_cd.s0, lo_cd.s1, lo_ab.s4, lo_ab.s5, lo_cd.s4, lo_cd.s5);
    v.y = (float8)(lo_ab.s2, lo_ab.s3, lo_cd.s2, lo_cd.s3, lo_ab.s6, lo_ab.s7, lo_cd.s6, lo_cd.s7);
    v.z = (float8)(hi_ab.s0, hi_ab.s1, hi_cd.s0, hi_cd.s1, hi_ab.s4, hi_ab.s5, hi_cd.s4, hi_cd.s5);
    return v;
}

// The nearest index in range. Nearly all are: a branch that foresees it costs less than a clamp that a load waits for.
uint sh_at(int i, int size) {
    return __builtin_expect((uint)i < (uint)size, 1) ? (uint)i : (uint)clamp(i, 0, size - 1);
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

__kernel void lookups(  // snapshot_programs.py:123
    ulong count,
    int row,
    __global const int *i_in,
    int i_step,
    __global const int *row_in,
    int row_step,
    __global const int *names,
    int names_size,
    __global const float *heights,
    int2 heights_size,
    __global const float4 *path,
    int path_size,
    __global float *result0_out,
    __global float *result1_out,
    __global int *result2_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    int8 i = sh_read_i(i_in, i_step, packet);
    int8 row_2 = sh_read_i(row_in, row_step, packet);
    float8 t = sh_gather_f(heights, sh_at2_lanes((int8x2){row_2, sh_gather_i(names, clamp(i, 0, names_size - 1))}, heights_size));  // snapshot_programs.py:125
    float8x3 t2 = sh_gather_f3(path, clamp(i, 0, path_size - 1));
    float3 t3 = path[sh_at(0, path_size)].xyz;
    float8 result0 = t;
    float8 result1_x = t2.x - t3.x;
    float8 result1_y = t2.y - t3.y;
    float8 result1_z = t2.z - t3.z;
    int result2 = path_size;
    sh_write_f(result0_out, result0, packet);
    sh_write_f3(result1_out, (float8x3){result1_x, result1_y, result1_z}, packet);
    sh_write_i(result2_out, (int8)(result2), packet);
}
