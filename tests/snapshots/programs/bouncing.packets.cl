#pragma OPENCL FP_CONTRACT OFF

// Whether a lane is set.
bool sh_any(int8 mask) {
    ulong4 a = as_ulong4(mask);
    ulong2 b = a.lo | a.hi;
    return (b.x | b.y) != 0;
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

typedef struct {
    float8 x, y;
} float8x2;

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
__attribute__((noinline)) void sh_write_f2_each(
    __global float *a, float8x2 v, int8 at, int8 active) {
    int place[8], there[8];
    float part0[8], part1[8];
    vstore8(at, 0, place);
    vstore8(active, 0, there);
    vstore8(v.x, 0, part0);
    vstore8(v.y, 0, part1);
    for (int k = 0; k < 8; k += 1) {
        if (there[k]) {
            a[(size_t)place[k] * 2] = part0[k];
            a[(size_t)place[k] * 2 + 1] = part1[k];
        }
    }
}

// Each lane's vector into its element of an array.
__attribute__((always_inline)) void sh_write_f2(__global float *a, float8x2 v, sh_packet p) {
    a += p.first * 2;
    if (!p.whole) {
        sh_write_f2_each(a, v, p.at, p.active);
        return;
    }
    float8 x = v.x;
    float8 y = v.y;
    float8 ra = (float8)(x.s0, y.s0, x.s1, y.s1, x.s4, y.s4, x.s5, y.s5);
    float8 rb = (float8)(x.s2, y.s2, x.s3, y.s3, x.s6, y.s6, x.s7, y.s7);
    vstore4(ra.s0123, 0, a);
    vstore4(rb.s0123, 1, a);
    vstore4(ra.s4567, 0, a + 2 * p.row);
    vstore4(rb.s4567, 1, a + 2 * p.row);
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

void bounce(  // snapshot_programs.py:92
    float8 position_x,
    float8 position_y,
    float8 velocity_x,
    float8 velocity_y,
    float floor_,
    int8 active,
    int8 *result,
    float8 *position_x_2,
    float8 *position_y_2,
    float8 *velocity_x_2,
    float8 *velocity_y_2) {
    *result = (int8)(0);
    int8 running = active;
    *position_x_2 = position_x;
    *position_y_2 = position_y;
    *velocity_x_2 = velocity_x;
    *velocity_y_2 = velocity_y;
    int8 leaving = active & (position_y > floor_);
    if (sh_any(leaving)) {
        *result = (int8)(0);  // snapshot_programs.py:95
        running &= ~leaving;
    }
    *position_y_2 = running ? 2.0f * floor_ - position_y : *position_y_2;  // snapshot_programs.py:96
    *velocity_y_2 = running ? -velocity_y : *velocity_y_2;  // snapshot_programs.py:97
    *result = running ? (int8)(-1) : *result;  // snapshot_programs.py:98
}

__kernel void bouncing(  // snapshot_programs.py:101
    ulong count,
    int row,
    __global const float *position_in,
    int position_step,
    __global const float *velocity_in,
    int velocity_step,
    __global float *result0_out,
    __global int *result1_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8x2 position = sh_read_f2(position_in, position_step, packet);
    float8x2 velocity = sh_read_f2(velocity_in, velocity_step, packet);
    int8 active = packet.active;
    float8 position_x = position.x;
    float8 position_y = position.y;
    float8 velocity_x = velocity.x;
    float8 velocity_y = velocity.y;
    int8 hits = (int8)(0);  // snapshot_programs.py:103
    for (int i = 0; i < 10; i += 1) {  // snapshot_programs.py:104
        position_x += velocity_x * 0.1f;  // snapshot_programs.py:105
        position_y += velocity_y * 0.1f;
        int8 t;  // snapshot_programs.py:106
        float8 position_x_2;
        float8 position_y_2;
        float8 velocity_x_2;
        float8 velocity_y_2;
        bounce(position_x, position_y, velocity_x, velocity_y, 0.0f, active, &t, &position_x_2, &position_y_2, &velocity_x_2, &velocity_y_2);
        position_x = position_x_2;
        position_y = position_y_2;
        velocity_x = velocity_x_2;
        velocity_y = velocity_y_2;
        int8 active_2 = active & t;
        hits = active_2 ? as_int8(as_uint8(hits) + (uint)1) : hits;  // snapshot_programs.py:107
    }
    float8 result0_x = position_x;  // snapshot_programs.py:108
    float8 result0_y = position_y;
    int8 result1 = hits;
    sh_write_f2(result0_out, (float8x2){result0_x, result0_y}, packet);
    sh_write_i(result1_out, result1, packet);
}
