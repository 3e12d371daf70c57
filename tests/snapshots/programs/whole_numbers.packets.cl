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

// A number for each lane of an array, one after the other.
__attribute__((noinline)) uint8 sh_read_u_each(__global const uint *a, int8 at) {
    int place[8];
    uint part0[8];
    vstore8(at, 0, place);
    for (int k = 0; k < 8; k += 1) {
        part0[k] = a[place[k]];
    }
    uint8 v;
    v = vload8(0, part0);
    return v;
}

// A number for each lane of an array; with step 0, the same for all.
__attribute__((always_inline)) uint8 sh_read_u(__global const uint *a, int step, sh_packet p) {
    uint8 v;
    if (step == 0) {
        v = (uint8)(a[0]);
        return v;
    }
    a += p.first;
    if (!p.whole) {
        return sh_read_u_each(a, p.at);
    }
    v = vload8(0, a);
    return v;
}

// floor(a / b), by way of doubles, which are exact enough; 0 for b = 0, and INT_MIN for INT_MIN / -1.
int8 sh_floordiv_i8(int8 a, int8 b) {
    int8 q = convert_int8(floor(convert_double8(a) / convert_double8(b)));
    q = b == -1 ? as_int8(-as_uint8(a)) : q;
    return b == 0 ? (int8)(0) : q;
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0. Doubles are exact enough.
int8 sh_floormod_i8(int8 a, int8 b) {
    uint8 q = as_uint8(convert_int8(floor(convert_double8(a) / convert_double8(b))));
    return (b == 0) | (b == -1) ? (int8)(0) : as_int8(as_uint8(a) - as_uint8(b) * q);
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

uint8 scramble(uint8 state) {  // library.py:30
    uint8 word = ((state >> ((state >> 28) + 4u)) ^ state) * 277803737u;  // library.py:31
    return (word >> 22) ^ word;  // library.py:32
}

uint8 pcg(uint8 x) {  // library.py:38
    return scramble(x * 747796405u + 2891336453u);  // library.py:39
}

__kernel void whole_numbers(  // snapshot_programs.py:155
    ulong count,
    int row,
    __global const int *a_in,
    int a_step,
    __global const int *b_in,
    int b_step,
    __global const uint *u_in,
    int u_step,
    __global int *result0_out,
    __global int *result1_out,
    __global int *result2_out,
    __global uint *result3_out,
    __global float *result4_out,
    __global int *result5_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    int8 a = sh_read_i(a_in, a_step, packet);
    int8 b = sh_read_i(b_in, b_step, packet);
    uint8 u = sh_read_u(u_in, u_step, packet);
    int8 result0 = sh_floordiv_i8(a, b);  // snapshot_programs.py:157
    int8 result1 = sh_floormod_i8(a, b);
    int8 result2 = (a << 2) ^ (b & ~a);
    uint8 result3 = u >> 7;
    float8 result4 = convert_float8(pcg(u) >> 8) * 5.9604645e-08f;
    int8 result5 = as_int8((uint)(-2147483647 - 1) - as_uint8(a));
    sh_write_i(result0_out, result0, packet);
    sh_write_i(result1_out, result1, packet);
    sh_write_i(result2_out, result2, packet);
    sh_write_u(result3_out, result3, packet);
    sh_write_f(result4_out, result4, packet);
    sh_write_i(result5_out, result5, packet);
}
