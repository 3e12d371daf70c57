#pragma OPENCL FP_CONTRACT OFF

// floor(a / b); 0 for b = 0, and the least int for itself by -1.
int sh_floordiv_i(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a % by;
    int q = a / by;
    return b == 0 ? 0 : (b == -1 ? (int)(0u - (uint)a) : (int)(q - (uint)(rest != 0 && (rest ^ by) < 0 ? 1 : 0)));
}

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod_i(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a % by;
    return rest != 0 && (rest ^ by) < 0 ? (int)(rest + (uint)by) : rest;
}

uint scramble(uint state) {  // library.py:31
    uint word = ((state >> ((state >> 28) + 4u)) ^ state) * 277803737u;  // library.py:32
    return (word >> 22) ^ word;  // library.py:33
}

uint pcg(uint x) {  // library.py:39
    return scramble(x * 747796405u + 2891336453u);  // library.py:40
}

__kernel void whole_numbers(  // snapshot_programs.py:155
    ulong count,
    ulong first,
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
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    int a = a_in[element * a_step];
    int b = b_in[element * b_step];
    uint u = u_in[element * u_step];
    result0_out[element] = sh_floordiv_i(a, b);  // snapshot_programs.py:157
    result1_out[element] = sh_floormod_i(a, b);
    result2_out[element] = (a << 2) ^ (b & ~a);
    result3_out[element] = u >> 7;
    result4_out[element] = (float)(pcg(u) >> 8u) * 5.9604645e-08f;
    result5_out[element] = (-2147483647 - 1) - (uint)a;
}
