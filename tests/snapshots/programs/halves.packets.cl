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

// x rounded to binary16.
float8 sh_half8(float8 x) {
    ushort8 bits;
    vstore_half8_rte(x, 0, (half *)&bits);
    return vload_half8(0, (half *)&bits);
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

__kernel void halves(  // snapshot_programs.py:180
    ulong count,
    int row,
    __global const float *x_in,
    int x_step,
    __global const float *f_in,
    int f_step,
    __global float *result0_out,
    __global float *result1_out) {
    int2 corner = sh_corner(row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8 x = sh_read_f(x_in, x_step, packet);
    float8 f = sh_read_f(f_in, f_step, packet);
    float8 result0 = sh_half8(sh_half8(x * x) + 0.099975586f);  // snapshot_programs.py:182
    float8 result1 = f + x;
    sh_write_f(result0_out, result0, packet);
    sh_write_f(result1_out, result1, packet);
}
