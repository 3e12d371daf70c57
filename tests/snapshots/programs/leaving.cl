#pragma OPENCL FP_CONTRACT OFF

void leaving_element(float x, int *result0, int *result1, int *status) {  // snapshot_programs.py:82
    *result0 = 0;
    *result1 = 0;
    *status = 1;
    if (isnan(x)) {  // snapshot_programs.py:84
        *status = 0;
        return;
    }
    for (int i = 0; i < 4; i += 1) {  // snapshot_programs.py:85
        int iterations = 0;  // snapshot_programs.py:86
        for (int j = 0; j < i; j += 1) {
            iterations += 1u;
            if (iterations > 1048576) {
                *status = 2;
                return;
            }
            if (x < (float)(int)(i * (uint)j)) {  // snapshot_programs.py:87
                *result0 = i;  // snapshot_programs.py:88
                *result1 = j;
                return;
            }
        }
    }
    *result0 = -1;  // snapshot_programs.py:89
    *result1 = -1;
}

__kernel void leaving(  // snapshot_programs.py:82
    ulong count,
    ulong first,
    __global const float *x_in,
    int x_step,
    __global int *result0_out,
    __global int *result1_out,
    __global int *status_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float x = x_in[element * x_step];
    int result0;
    int result1;
    int status;
    leaving_element(x, &result0, &result1, &status);
    result0_out[element] = result0;
    result1_out[element] = result1;
    status_out[element] = status;
}
