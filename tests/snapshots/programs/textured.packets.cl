#pragma OPENCL FP_CONTRACT OFF

typedef struct {
    float8 x, y, z;
} float8x3;

typedef struct {
    float8 x, y;
} float8x2;

// The number where one is NaN.
float8 sh_max8(float8 a, float8 b) {
    return !(a >= b) & (b == b) ? b : a;
}

// The number where one is NaN.
float8 sh_min8(float8 a, float8 b) {
    return !(a <= b) & (b == b) ? b : a;
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0. Doubles are exact enough.
int8 sh_floormod_i8(int8 a, int8 b) {
    uint8 q = as_uint8(convert_int8(floor(convert_double8(a) / convert_double8(b))));
    return (b == 0) | (b == -1) ? (int8)(0) : as_int8(as_uint8(a) - as_uint8(b) * q);
}

typedef struct {
    int8 x, y;
} int8x2;

// The places of elements, the nearest ones for indices that are out of range.
int8 sh_at2_lanes(int8x2 at, int2 size) {
    return clamp(at.x, 0, size.x - 1) * size.y + clamp(at.y, 0, size.y - 1);
}

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

// A vector for each lane of an array, one after the other.
__attribute__((noinline)) float8x2 sh_read_f2_each(__global const float *a, int8 at) {
    int place[8];
    float part0[8], part1[8];
    vstore8(at, 0, place);
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

float8x3 mix3(float8x3 a, float8x3 b, float8x3 t) {
    float8 result_x = a.x * (1.0f - t.x) + b.x * t.x;
    float8 result_y = a.y * (1.0f - t.y) + b.y * t.y;
    float8 result_z = a.z * (1.0f - t.z) + b.z * t.z;
    return (float8x3){result_x, result_y, result_z};
}

float8x3 sample_image(float8x2 uv, __global const float4 *image, int2 image_size, int image_mode) {  // library.py:175
    int t = image_size.x;  // library.py:176
    int t2 = image_size.y;
    bool t3 = (image_mode & 1) != 0;  // library.py:178
    bool t4 = (image_mode & 2) != 0;
    float8 inside_x = (int8)(-t4) ? uv.x - floor(uv.x) : sh_min8(sh_max8(uv.x, (float8)(-1.0f)), (float8)(2.0f));  // library.py:187
    float8 inside_y = (int8)(-t4) ? uv.y - floor(uv.y) : sh_min8(sh_max8(uv.y, (float8)(-1.0f)), (float8)(2.0f));
    float8 place_x = inside_x * (float)t2;  // library.py:189
    float8 place_y = inside_y * (float)t;
    float shift = t3 ? 0.5f : 0.0f;  // library.py:198
    float8 t5 = place_x - shift;  // library.py:199
    float8 t6 = place_y - shift;
    float8 corner_x = floor(t5);
    float8 corner_y = floor(t6);
    float8 t_x = t5 - corner_x;  // library.py:200
    float8 t_y = t6 - corner_y;
    float8 t_x_2 = (int8)(-t3) ? t_x : (float8)(0.0f);  // library.py:202
    float8 t_y_2 = (int8)(-t3) ? t_y : (float8)(0.0f);
    int8 cell_x = convert_int8_sat(corner_x);  // library.py:203
    int8 cell_y = convert_int8_sat(corner_y);
    int8 t7 = (int8)(-t4) ? sh_floormod_i8(cell_x, (int8)(t2)) : cell_x;  // library.py:167
    int8 t8 = (int8)(-t4) ? sh_floormod_i8(cell_y, (int8)(t)) : cell_y;
    int8 t9 = as_int8(as_uint8(cell_x) + (uint)1);  // library.py:204
    int8 t10 = (int8)(-t4) ? sh_floormod_i8(t9, (int8)(t2)) : t9;  // library.py:167
    float8x3 top = mix3(sh_gather_f3(image, sh_at2_lanes((int8x2){t8, t7}, image_size)), sh_gather_f3(image, sh_at2_lanes((int8x2){t8, t10}, image_size)), (float8x3){t_x_2, t_x_2, t_x_2});  // library.py:204
    int8 t11 = as_int8(as_uint8(cell_y) + (uint)1);  // library.py:205
    int8 t12 = (int8)(-t4) ? sh_floormod_i8(t11, (int8)(t)) : t11;  // library.py:167
    float8x3 bottom = mix3(sh_gather_f3(image, sh_at2_lanes((int8x2){t12, t7}, image_size)), sh_gather_f3(image, sh_at2_lanes((int8x2){t12, t10}, image_size)), (float8x3){t_x_2, t_x_2, t_x_2});  // library.py:205
    return mix3(top, bottom, (float8x3){t_y_2, t_y_2, t_y_2});
}

__kernel void textured(  // snapshot_programs.py:128
    ulong count,
    int row,
    __global const float *uv_in,
    int uv_step,
    __global const float4 *image,
    int2 image_size,
    int image_mode,
    __global float *result_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8x2 uv = sh_read_f2(uv_in, uv_step, packet);
    float8x3 t = sample_image((float8x2){uv.x * 2.0f, uv.y * 2.0f}, image, image_size, image_mode);  // snapshot_programs.py:130
    float8 result_x = t.x;
    float8 result_y = t.y;
    float8 result_z = t.z;
    sh_write_f3(result_out, (float8x3){result_x, result_y, result_z}, packet);
}
