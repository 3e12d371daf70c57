#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

uniform vec3 turn_0;
uniform vec3 turn_1;
uniform vec3 turn_2;
uniform vec3 light;
float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_p;
uniform int each_p;  // 0 where one value serves all elements
uniform sampler2D in_n;
uniform int each_n;  // 0 where one value serves all elements
layout(location = 0) out vec3 out_0;
layout(location = 1) out float out_1;

// The greater argument; if one is NaN, the other.
float sh_max(precise float a, precise float b) {
    precise float result = a < b || a != a ? b : a;
    return result;
}

float dot3(precise vec3 a, precise vec3 b) {
    precise float result = a.x * b.x + a.y * b.y + a.z * b.z;
    return result;
}

vec3 normalize3(precise vec3 v) {
    precise float t = abs(v.x);
    precise float t2 = abs(v.y);
    precise float t3 = abs(v.z);
    precise float t4 = t < t2 ? t2 : t;
    precise float largest = t4 < t3 ? t3 : t4;
    precise vec3 scaled = v * (largest > 4.611686e+18 ? 7.888609e-31 : (largest < 8.881784e-16 ? 1.2676506e+30 : 1.0));
    precise float size = sqrt(dot3(scaled, scaled));
    precise bool t5 = size > 0.0;
    precise vec3 result = t5 ? scaled / (t5 ? size : 1.0) : vec3(zero);
    return result;
}

void lit(precise vec3 p, precise vec3 n, precise out vec3 result0, precise out float result1) {  // snapshot_programs.py:137
    result0 = vec3(dot3(turn_0, p), dot3(turn_1, p), dot3(turn_2, p));  // snapshot_programs.py:139
    result1 = sh_max(dot3(normalize3(n), light), zero);
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise vec3 result0;
    precise float result1;
    lit(texelFetch(in_p, at * each_p, 0).xyz, texelFetch(in_n, at * each_n, 0).xyz, result0, result1);
    out_0 = result0;
    out_1 = result1;
}
