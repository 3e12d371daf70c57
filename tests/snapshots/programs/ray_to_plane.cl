#pragma OPENCL FP_CONTRACT OFF

void ray_to_plane_element(float3 ray_o, float3 ray_d, float height, float3 *o, float3 *d, int *status) {  // snapshot_programs.py:148
    *o = (float3)(0.0f);
    *d = (float3)(0.0f);
    *status = 1;
    float t = (height - ray_o.y) / ray_d.y;  // snapshot_programs.py:150
    if (t < 0.0f) {  // snapshot_programs.py:151
        *status = 0;
        return;
    }
    float3 o_2 = ray_o + t * ray_d;  // snapshot_programs.py:152
    float3 d_2 = -ray_d;
    *o = o_2;
    *d = d_2;
}

__kernel void ray_to_plane(  // snapshot_programs.py:148
    ulong count,
    ulong first,
    __global const float *ray_o_in,
    int ray_o_step,
    __global const float *ray_d_in,
    int ray_d_step,
    __global const float *height_in,
    int height_step,
    __global float *o_out,
    __global float *d_out,
    __global int *status_out) {
    size_t element = first + get_global_id(0);
    if (element >= count) {
        return;
    }
    float3 ray_o = vload3(element * ray_o_step, ray_o_in);
    float3 ray_d = vload3(element * ray_d_step, ray_d_in);
    float height = height_in[element * height_step];
    float3 o;
    float3 d;
    int status;
    ray_to_plane_element(ray_o, ray_d, height, &o, &d, &status);
    vstore3(o, element, o_out);
    vstore3(d, element, d_out);
    status_out[element] = status;
}
