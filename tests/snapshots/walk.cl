#pragma OPENCL FP_CONTRACT OFF

// The smaller argument; if one is NaN, the other.
float sh_min(float a, float b) {
    return b < a || a != a ? b : a;
}

void walk_element(float x, int n, float *result, int *status) {  // test_opencl_text.py:70
    *result = 0.0f;
    *status = 1;
    float total = 0.0f;  // test_opencl_text.py:72
    if (x < 0.0f) {  // test_opencl_text.py:73
        *status = 0;  // test_opencl_text.py:74
        return;
    }
    int iterations = 0;  // test_opencl_text.py:75
    while (n > 0) {
        iterations += 1u;
        if (iterations > 1048576) {
            *status = 2;
            return;
        }
        n -= 1u;  // test_opencl_text.py:76
        if (total > 100.0f) {  // test_opencl_text.py:77
            break;  // test_opencl_text.py:78
        }
        total += sh_min(x, 1.0f) / (float)n;  // test_opencl_text.py:79
    }
    *result = total;  // test_opencl_text.py:80
}

__kernel void walk(  // test_opencl_text.py:70
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
    walk_element(x, n, &result, &status);
    result_out[element] = result;
    status_out[element] = status;
}
