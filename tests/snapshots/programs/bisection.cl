#pragma OPENCL FP_CONTRACT OFF

// The greater argument; if one is NaN, the other.
float sh_max(float a, float b) {
    return a < b || a != a ? b : a;
}

void bisection_element(float x, float *result, int *status) {  // snapshot_programs.py:185
    *result = 0.0f;
    *status = 1;
    float low = 0.0f;  // snapshot_programs.py:187
    float high = sh_max(x, 1.0f);
    int iterations = 0;  // snapshot_programs.py:188
    do {
        iterations += 1u;
        if (iterations > 1048576) {
            *status = 2;
            return;
        }
        float middle = (low + high) / 2.0f;  // snapshot_programs.py:189
        if (middle * middle < x) {  // snapshot_programs.py:190
            low = middle;  // snapshot_programs.py:191
        } else {
            high = middle;  // snapshot_programs.py:193
        }
    } while (!(high - low <= 1e-06f * high));  // snapshot_programs.py:194
    *result = low;  // snapshot_programs.py:195
}

__kernel void bisection(  // snapshot_programs.py:185
    ulong count,
    ulong first,
    __global const float *x_in,
    int x_step,
    __global float *result_out,
    __global int *status_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float x = x_in[element * x_step];
    float result;
    int status;
    bisection_element(x, &result, &status);
    result_out[element] = result;
    status_out[element] = status;
}
