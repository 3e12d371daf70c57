#pragma OPENCL FP_CONTRACT OFF

float dot2(float2 a, float2 b) {
    return a.x * b.x + a.y * b.y;
}

void fractal_element(float2 c, float *result, int *status) {  // test_opencl_text.py:31
    *result = 0.0f;
    *status = 1;
    float2 z = (float2)(0.0f);  // test_opencl_text.py:33
    float n = 0.0f;  // test_opencl_text.py:34
    int iterations = 0;  // test_opencl_text.py:35
    do {
        iterations += 1u;
        if (iterations > 1048576) {
            *status = 2;
            return;
        }
        z = (float2)(z.x * z.x - z.y * z.y, 2.0f * z.x * z.y) + c;  // test_opencl_text.py:36
        n += 1.0f;  // test_opencl_text.py:37
    } while (!(dot2(z, z) > 4.0f || n >= 256.0f));  // test_opencl_text.py:38
    *result = n;  // test_opencl_text.py:39
}

__kernel void fractal(  // test_opencl_text.py:31
    ulong count,
    ulong first,
    __global const float2 *c_in,
    int c_step,
    __global float *result_out,
    __global int *status_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float2 c = c_in[element * c_step];
    float result;
    int status;
    fractal_element(c, &result, &status);
    result_out[element] = result;
    status_out[element] = status;
}
