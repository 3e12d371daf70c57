#pragma OPENCL FP_CONTRACT OFF

// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int sh_floormod_i(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a % by;
    return rest != 0 && (rest ^ by) < 0 ? (int)(rest + (uint)by) : rest;
}

void counting_element(float x, int n, float *result, int *status) {  // snapshot_programs.py:70
    *result = 0.0f;
    *status = 1;
    float total = 0.0f;  // snapshot_programs.py:72
    int iterations = 0;  // snapshot_programs.py:73
    for (int i = 0; i < n; i += 1) {
        iterations += 1u;
        if (iterations > 1048576) {
            *status = 2;
            return;
        }
        if (sh_floormod_i(i, 3) == 0) {  // snapshot_programs.py:74
            continue;
        }
        total += x * (float)i;  // snapshot_programs.py:75
        if (total > 100.0f) {  // snapshot_programs.py:76
            break;
        }
    }
    for (int j = 8; j > 0; j -= 2u) {  // snapshot_programs.py:77
        total -= (float)j;  // snapshot_programs.py:78
    }
    *result = total;  // snapshot_programs.py:79
}

__kernel void counting(  // snapshot_programs.py:70
    ulong count,
    ulong first,
    __global const float *x_in,
    int x_step,
    __global const int *n_in,
    int n_step,
    __global float *result_out,
    __global int *status_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float x = x_in[element * x_step];
    int n = n_in[element * n_step];
    float result;
    int status;
    counting_element(x, n, &result, &status);
    result_out[element] = result;
    status_out[element] = status;
}
