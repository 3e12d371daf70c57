#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif
#extension GL_ARB_gpu_shader_fp64 : require

float zero = float(min(int(gl_FragCoord.x), 0));  // 0.0, but the driver must not know
uniform ivec2 sh_last;
uniform sampler2D in_x;
uniform int each_x;  // 0 where one value serves all elements
uniform sampler2D in_k;
uniform int each_k;  // 0 where one value serves all elements
layout(location = 0) out vec2 out_0;

float sin_strict(precise float x) {
    precise double t = double(x);
    precise double product = t * 0.3183098854497075lf;
    precise double near_k = product + 6755399441055744.0lf - 6755399441055744.0lf;
    precise double near_f = t * 1.138005036539198e-18lf + (t * 7.340831623126043e-10lf + (product - near_k));
    precise float t2 = abs(x);
    precise bool far = t2 >= 1.6777216e+07;
    precise double f = near_f;
    precise float k = float(near_k);
    if (far) {
        precise bool above = t2 >= 1.1258999e+15;
        precise double digit = above ? 1.2841276625374931e-08lf : 0.3183098854497075lf;
        precise double digit_2 = above ? 8.076898927812296e-18lf : 7.340831623126043e-10lf;
        precise double digit_3 = above ? 1.2634130177915748e-26lf : 1.138005036539198e-18lf;
        precise bool above_2 = t2 >= 7.5557864e+22;
        precise double digit_4 = above_2 ? 1.468547768767099e-16lf : digit;
        precise double digit_5 = above_2 ? 1.4188110080591198e-25lf : digit_2;
        precise double digit_6 = above_2 ? 8.341433834304119e-35lf : digit_3;
        precise bool above_3 = t2 >= 5.0706024e+30;
        precise double digit_7 = above_3 ? 3.037013239734091e-24lf : digit_4;
        precise double digit_8 = above_3 ? 5.090832185799798e-33lf : digit_5;
        precise double digit_9 = above_3 ? 7.95005651784451e-42lf : digit_6;
        precise double product_2 = t * digit_7;
        precise double rest = t * digit_8;
        precise double k_2 = product_2 + 6755399441055744.0lf - 6755399441055744.0lf;
        precise double more = rest + 6755399441055744.0lf - 6755399441055744.0lf;
        precise double left = product_2 - k_2 + (rest - more);
        precise double last = left + 6755399441055744.0lf - 6755399441055744.0lf;
        precise double t3 = k_2 - floor(k_2 * 0.5lf) * 2.0lf + (more + last);
        f = t * digit_9 + (left - last);
        k = float(t3);
    }
    precise float half_ = k * 0.5;
    precise bool odd = half_ != floor(half_);
    precise double z = f * f;
    precise double t3 = ((7.407082011743356e-07lf * z + -2.187234610985848e-05lf) * z + 0.0004662860726569745lf) * z + -0.007370427288701782lf;
    precise double t4 = (((t3 * z + 0.08214588614421396lf) * z + -0.5992645292865307lf) * z + 2.5501640398760044lf) * z + -5.167712780049945lf;
    precise double series = t4 * z + 3.141592653589793lf;
    precise float size = float(f * series);
    precise float result = odd ? -size : size;
    return result;
}

vec2 wave(precise float x, precise vec2 k) {  // test_glsl_text.py:18
    precise vec2 y = sin_strict(x) * k + zero;  // test_glsl_text.py:20
    precise vec2 result = mix(-k, y, greaterThan(y, vec2(0.0)));  // test_glsl_text.py:21
    return result;
}

void main() {
    ivec2 at = min(ivec2(gl_FragCoord.xy), sh_last);
    out_0 = wave(texelFetch(in_x, at * each_x, 0).x, texelFetch(in_k, at * each_k, 0).xy);
}
