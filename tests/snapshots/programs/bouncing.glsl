#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_position;
uniform int each_position;  // 0 where one value serves all elements
uniform sampler2D in_velocity;
uniform int each_velocity;  // 0 where one value serves all elements
layout(location = 0) out vec2 out_0;
layout(location = 1) out int out_1;

bool bounce(precise inout vec2 position, precise inout vec2 velocity, precise float floor_) {  // snapshot_programs.py:92
    precise bool t = position.y > floor_;  // snapshot_programs.py:94
    precise bool result = false;  // snapshot_programs.py:92
    if (t) {  // snapshot_programs.py:94
        result = false;  // snapshot_programs.py:95
        return result;
    }
    position.y = 2.0 * floor_ - position.y;  // snapshot_programs.py:96
    velocity.y = -velocity.y;  // snapshot_programs.py:97
    result = true;  // snapshot_programs.py:98
    return result;
}

void bouncing(precise vec2 position, precise vec2 velocity, precise out vec2 result0, out int result1) {  // snapshot_programs.py:101
    int hits = 0;  // snapshot_programs.py:103
    for (int i = 0; i < 10; i += 1) {  // snapshot_programs.py:104
        position += velocity * 0.1;  // snapshot_programs.py:105
        precise bool t = bounce(position, velocity, zero);  // snapshot_programs.py:106
        if (t) {
            hits += 1;  // snapshot_programs.py:107
        }
    }
    result0 = position;  // snapshot_programs.py:108
    result1 = hits;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    precise vec2 result0;
    int result1;
    bouncing(texelFetch(in_position, at * each_position, 0).xy, texelFetch(in_velocity, at * each_velocity, 0).xy, result0, result1);
    out_0 = result0;
    out_1 = result1;
}
