#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_ray_o;
uniform int each_ray_o;  // 0 where one value serves all elements
uniform sampler2D in_ray_d;
uniform int each_ray_d;  // 0 where one value serves all elements
uniform sampler2D in_height;
uniform int each_height;  // 0 where one value serves all elements
layout(location = 0) out vec3 out_o;
layout(location = 1) out vec3 out_d;
layout(location = 2) out int out_status;

void ray_to_plane(  // snapshot_programs.py:148
    precise vec3 ray_o,
    precise vec3 ray_d,
    precise float height,
    precise out vec3 o,
    precise out vec3 d,
    out int status) {
    o = vec3(zero);
    d = vec3(zero);
    status = 1;
    precise float t = (height - ray_o.y) / ray_d.y;  // snapshot_programs.py:150
    precise bool t2 = t < 0.0;  // snapshot_programs.py:151
    if (t2) {
        status = 0;
        return;
    }
    precise vec3 o_2 = ray_o + t * ray_d;  // snapshot_programs.py:152
    precise vec3 d_2 = -ray_d;
    o = o_2;
    d = d_2;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise vec3 o;
    precise vec3 d;
    int status;
    ray_to_plane(texelFetch(in_ray_o, at * each_ray_o, 0).xyz, texelFetch(in_ray_d, at * each_ray_d, 0).xyz, texelFetch(in_height, at * each_height, 0).x, o, d, status);
    out_o = o;
    out_d = d;
    out_status = status;
}
