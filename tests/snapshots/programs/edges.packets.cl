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
    v = vload8(0, a);
    return v;
}

// The number where one is NaN.
float8 sh_min8(float8 a, float8 b) {
    return !(a <= b) & (b == b) ? b : a;
}

// The number where one is NaN.
float8 sh_max8(float8 a, float8 b) {
    return !(a >= b) & (b == b) ? b : a;
}

// The bits of x; the same ones for every NaN.
uint8 sh_bits8(float8 x) {
    return x != x ? (uint8)(0x7fc00000u) : as_uint8(x);
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
    vstore8(v, 0, a);
}

// Each lane's number into its element of an array, one after the other.
__attribute__((noinline)) void sh_write_u_each(
    __global uint *a, uint8 v, int8 at, int8 active) {
    int place[8], there[8];
    uint part0[8];
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
__attribute__((always_inline)) void sh_write_u(__global uint *a, uint8 v, sh_packet p) {
    a += p.first;
    if (!p.whole) {
        sh_write_u_each(a, v, p.at, p.active);
        return;
    }
    vstore8(v, 0, a);
}

float8 mod1(float8 x, float8 y) {
    return x - y * floor(x / y);
}

__kernel void edges(  // snapshot_programs.py:160
    ulong count,
    int row,
    __global const float *x_in,
    int x_step,
    __global const float *y_in,
    int y_step,
    __global float *result0_out,
    __global float *result1_out,
    __global float *result2_out,
    __global int *result3_out,
    __global float *result4_out,
    __global float *result5_out,
    __global uint *result6_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    float8 y = sh_read_f(y_in, y_step, packet);
    float8 result0 = sh_min8(x, y);  // snapshot_programs.py:162
    float8 result1 = sign(x) + 0.0f;
    float8 result2 = rint(x);
    int8 result3 = convert_int8_sat(x);
    float8 result4 = mod1(x, y);
    float8 result5 = sh_min8(sh_max8(x, (float8)(0.0f)), y);
    uint8 result6 = sh_bits8(x);
    sh_write_f(result0_out, result0, packet);
    sh_write_f(result1_out, result1, packet);
    sh_write_f(result2_out, result2, packet);
    sh_write_i(result3_out, result3, packet);
    sh_write_f(result4_out, result4, packet);
    sh_write_f(result5_out, result5, packet);
    sh_write_u(result6_out, result6, packet);
}
