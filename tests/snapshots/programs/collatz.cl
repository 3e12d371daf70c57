#pragma OPENCL FP_CONTRACT OFF

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod_i(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a % by;
    return rest != 0 && (rest ^ by) < 0 ? (int)(rest + (uint)by) : rest;
}

// floor(a / b); 0 for b = 0, and the least int for itself by -1.
int sh_floordiv_i(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a % by;
    int q = a / by;
    return b == 0 ? 0 : (b == -1 ? (int)(0u - (uint)a) : (int)(q - (uint)(rest != 0 && (rest ^ by) < 0 ? 1 : 0)));
}

void collatz_element(int n, int *result, int *status) {  // snapshot_programs.py:61
    *result = 0;
    *status = 1;
    int steps = 0;  // snapshot_programs.py:63
    int iterations = 0;  // snapshot_programs.py:64
    while (n > 1) {
        iterations += 1u;
        if (iterations > 1048576) {
            *status = 2;
            return;
        }
        n = sh_floormod_i(n, 2) == 0 ? sh_floordiv_i(n, 2) : (int)(3u * n + 1u);  // snapshot_programs.py:65
        steps += 1u;  // snapshot_programs.py:66
    }
    *result = steps;  // snapshot_programs.py:67
}

__kernel void collatz(  // snapshot_programs.py:61
    ulong count,
    ulong first,
    __global const int *n_in,
    int n_step,
    __global int *result_out,
    __global int *status_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    int n = n_in[element * n_step];
    int result;
    int status;
    collatz_element(n, &result, &status);
    result_out[element] = result;
    status_out[element] = status;
}
