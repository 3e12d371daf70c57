#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_x;
uniform int each_x;  // 0 where one value serves all elements
layout(location = 0) out vec3 out_0;

vec3 branches(precise float x) {  // snapshot_programs.py:47
    precise vec3 color = vec3(zero);  // snapshot_programs.py:49
    precise bool t = x < 0.0;  // snapshot_programs.py:50
    if (t) {
        color.x = -x;  // snapshot_programs.py:51
    } else {
        precise bool t2 = x > 1.0;  // snapshot_programs.py:52
        if (t2) {
            color.y = x;  // snapshot_programs.py:53
            precise bool t3 = x > 2.0;  // snapshot_programs.py:54
            if (t3) {
                color *= 0.5;  // snapshot_programs.py:55
            }
        } else {
            color.z = 1.0 - x;  // snapshot_programs.py:57
        }
    }
    precise vec3 result = color;  // snapshot_programs.py:58
    return result;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    out_0 = branches(texelFetch(in_x, at * each_x, 0).x);
}
