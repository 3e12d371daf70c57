// Transcendental functions within the bounds of OpenCL's full profile (OpenCL C 3.0 section 7.4), for one component.
// GLSL 3.30 bounds none of its own: llvmpipe's log is 300,000 ULP off near 1 and its asin 0.0004 everywhere.
// Read by prologue.py, which emits what a program uses. Coefficients: weighted minimax fits, made for these ranges.

// x times 2 to the n, for |n| < 250, in two steps that stay in range.
float sh_scale(float x, int n) {
    int first = n >> 1;
    precise float r = x * intBitsToFloat((127 + first) << 23) * intBitsToFloat((127 + n - first) << 23);
    return r;
}

// e to the r for |r| < 0.36, as 1 + r + r * r * P(r).
float sh_exp_near_zero(float r) {
    precise float p = 1.9789262e-4;
    p = p * r + 1.3945752e-3;
    p = p * r + 8.333504e-3;
    p = p * r + 4.166628e-2;
    p = p * r + 1.6666666e-1;
    p = p * r + 0.5;
    precise float e = r * r * p + r + 1.0;
    return e;
}

// e to the x, times 2 to the n for small n: r = x - k ln 2, with ln 2 in two parts.
float sh_exp_times(float x, int n) {
    precise float t = x > 91.0 ? 91.0 : x < -105.0 ? -105.0 : x;
    precise float k = roundEven(t * 1.44269504);
    precise float r = t - k * 0.693359375 + k * 2.12194440e-4;
    return sh_scale(sh_exp_near_zero(r), int(k) + n);
}

float sh_exp(float x) {
    return sh_exp_times(x, 0);
}

float sh_exp2(float x) {
    precise float t = x > 130.0 ? 130.0 : x < -152.0 ? -152.0 : x;
    precise float k = roundEven(t);
    precise float r = (t - k) * 0.693147181;
    return sh_scale(sh_exp_near_zero(r), int(k));
}

// x > 0 as 2 to the k times 1 + f, 1 + f in [sqrt(1/2), sqrt(2)): (f, log(1 + f) - f, k).
vec3 sh_log_parts(float x) {
    bool tiny = x < 1.17549435e-38;
    int bits = floatBitsToInt(tiny ? x * 8388608.0 : x) - 0x3f3504f3;
    precise float f = intBitsToFloat((bits & 0x7fffff) + 0x3f3504f3) - 1.0;
    precise float p = 6.74664e-2;
    p = p * f - 1.1675652e-1;
    p = p * f + 1.1888162e-1;
    p = p * f - 1.2405589e-1;
    p = p * f + 1.4219552e-1;
    p = p * f - 1.6667996e-1;
    p = p * f + 2.0002119e-1;
    p = p * f - 2.500001e-1;
    p = p * f + 3.3333313e-1;
    precise float rest = f * f * (f * p - 0.5);
    return vec3(f, rest, float((bits >> 23) - (tiny ? 23 : 0)));
}

// The logarithm r of x > 0; what a logarithm is elsewhere.
float sh_log_edges(float x, float r) {
    float infinity = uintBitsToFloat(0x7f800000u);
    precise float ended = x == 0.0 ? -infinity : x < 0.0 ? uintBitsToFloat(0x7fc00000u) : x;
    precise bool inside = x > 0.0 && x < infinity;
    return inside ? r : ended;
}

float sh_log(float x) {
    vec3 parts = sh_log_parts(x);
    precise float r = parts.y - parts.z * 2.12194440e-4 + parts.x + parts.z * 0.693359375;
    return sh_log_edges(x, r);
}

float sh_log2(float x) {
    vec3 parts = sh_log_parts(x);
    precise float r = parts.y * 0.44269504 + parts.x * 0.44269504 + parts.y + parts.x + parts.z;
    return sh_log_edges(x, r);
}

// log(1 + x): what the sum loses comes back as a correction.
float sh_log1p(float x) {
    precise float u = 1.0 + x;
    precise float lost = (x - (u - 1.0)) / u;
    precise float r = sh_log(u) + lost;
    precise bool inside = u > 0.0 && u < uintBitsToFloat(0x7f800000u);
    return inside ? r : sh_log(u);
}

// The 64 bits of a * b: low, high.
uvec2 sh_product(uint a, uint b) {
    uint low = (a & 0xffffu) * (b & 0xffffu);
    uint left = (a >> 16) * (b & 0xffffu) + (low >> 16);
    uint right = (a & 0xffffu) * (b >> 16) + (left & 0xffffu);
    return uvec2((right << 16) | (low & 0xffffu), (a >> 16) * (b >> 16) + (left >> 16) + (right >> 16));
}

// x - n pi/2 for large x, exactly (Payne and Hanek 1983): the 96 bits of 2/pi that matter for the quadrant and what
// follows it, times the 24 bits of x.
float sh_quadrant_large(float x, out int n) {
    const uint two_over_pi[9] = uint[9](0u, 0xa2f9836eu, 0x4e441529u, 0xfc2757d1u, 0xf534ddc0u, 0xdb629599u,
        0x3c439041u, 0xfe5163abu, 0xdebbc561u);
    uint bits = floatBitsToUint(x);
    uint mantissa = (bits & 0x7fffffu) | 0x800000u;
    int start = int((bits >> 23) & 255u) - 120;
    int word = start >> 5;
    uint left = uint(start & 31);
    uvec4 w = uvec4(two_over_pi[word], two_over_pi[word + 1], two_over_pi[word + 2], two_over_pi[word + 3]);
    uvec3 window = left == 0u ? w.xyz : (w.xyz << left) | (w.yzw >> (32u - left));
    uvec2 third = sh_product(window.z, mantissa);
    uvec2 second = sh_product(window.y, mantissa);
    uint middle = second.x + third.y;
    uint high = window.x * mantissa + second.y + (middle < third.y ? 1u : 0u);
    uint fraction = (high << 2) | (middle >> 30);
    n = int((high >> 30) + (fraction >> 31));
    uint rest = (middle << 2) | (third.x >> 30);
    precise float r = float(int(fraction)) * 2.3283064e-10 + float(rest) * 5.4210109e-20;
    r = r * 1.57079633;
    n = x < 0.0 ? -n : n;
    return x < 0.0 ? -r : r;
}

// x - n pi/2, in [-pi/4, pi/4]: up to 1600 by pi/2 in three parts (Cody and Waite 1980), n times the first two exact.
float sh_quadrant(float x, out int n) {
    precise float k = roundEven(x * 0.636619772);
    precise float r = x - k * 1.57080078125 + k * 4.454515874385834e-6 - k * 6.0771005e-11;
    n = int(k);
    if (abs(x) > 1600.0) {
        r = sh_quadrant_large(x, n);
    }
    precise bool finite = abs(x) < uintBitsToFloat(0x7f800000u);
    return finite ? r : uintBitsToFloat(0x7fc00000u);
}

float sh_sin_near_zero(float r) {
    precise float z = r * r;
    precise float s = r + r * z * ((z * -1.9512029e-4 + 8.332137e-3) * z - 1.6666654e-1);
    return s;
}

float sh_cos_near_zero(float r) {
    precise float z = r * r;
    precise float c = z * z * ((z * 2.4429439e-5 - 1.3887284e-3) * z + 4.1666646e-2) - 0.5 * z + 1.0;
    return c;
}

float sh_sin(float x) {
    int n;
    float r = sh_quadrant(x, n);
    float s = (n & 1) == 0 ? sh_sin_near_zero(r) : sh_cos_near_zero(r);
    s = (n & 2) == 0 ? s : -s;
    return abs(x) < 2.44140625e-4 ? x : s;
}

float sh_cos(float x) {
    int n;
    float r = sh_quadrant(x, n);
    float c = (n & 1) == 0 ? sh_cos_near_zero(r) : sh_sin_near_zero(r);
    return ((n + 1) & 2) == 0 ? c : -c;
}

float sh_tan(float x) {
    int n;
    float r = sh_quadrant(x, n);
    float s = sh_sin_near_zero(r);
    float c = sh_cos_near_zero(r);
    precise float t = (n & 1) == 0 ? s / c : -c / s;
    return abs(x) < 2.44140625e-4 ? x : t;
}

// asin of 0 <= a <= 1/2.
float sh_asin_near_zero(float a) {
    precise float z = a * a;
    precise float p = 4.217823e-2;
    p = p * z + 2.4172952e-2;
    p = p * z + 4.547161e-2;
    p = p * z + 7.4952886e-2;
    p = p * z + 1.6666752e-1;
    precise float r = a + a * z * p;
    return r;
}

// Past 1/2: asin(a) = pi/2 - 2 asin(sqrt((1 - a) / 2)).
float sh_asin(float x) {
    float a = abs(x);
    precise float far = sqrt((1.0 - a) * 0.5);
    bool near = a < 0.5;
    float part = sh_asin_near_zero(near ? a : far);
    precise float r = near ? part : (0.785398185 - part - 2.1855694e-8) * 2.0;
    return x < 0.0 ? -r : near && a < 2.44140625e-4 ? x : r;
}

float sh_acos(float x) {
    float a = abs(x);
    precise float far = sqrt((1.0 - a) * 0.5);
    bool near = a < 0.5;
    float part = sh_asin_near_zero(near ? a : far);
    precise float middle = 1.57079637 - (x < 0.0 ? -part : part) - 4.3711388e-8;
    precise float ends = x < 0.0 ? 3.14159274 - (2.0 * part + 8.7422777e-8) : 2.0 * part;
    return near ? middle : ends;
}

// atan of 0 <= q <= 1.
float sh_atan_near_zero(float q) {
    precise float z = q * q;
    precise float p = -1.7936218e-3;
    p = p * z + 1.0914606e-2;
    p = p * z - 3.1177847e-2;
    p = p * z + 5.7957593e-2;
    p = p * z - 8.40345e-2;
    p = p * z + 1.0952186e-1;
    p = p * z - 1.4264242e-1;
    p = p * z + 1.9998549e-1;
    p = p * z - 3.33333e-1;
    precise float r = q + q * z * p;
    return r;
}

float sh_atan(float x) {
    float a = abs(x);
    bool far = a > 1.0;
    precise float q = far ? 1.0 / a : a;
    float part = sh_atan_near_zero(q);
    precise float r = far ? 1.57079637 - (part + 4.3711388e-8) : part;
    r = a < 2.44140625e-4 ? a : r;
    return floatBitsToInt(x) < 0 ? -r : r;
}

// C99 7.12.4.4 and F.9.1.4: the angle of the quotient of the smaller by the larger, put into its octant.
float sh_atan2(float y, float x) {
    float ax = abs(x);
    float ay = abs(y);
    bool steep = ay > ax;
    float larger = steep ? ay : ax;
    float smaller = steep ? ax : ay;
    float size = larger > 1.0e37 ? 0.0009765625 : larger < 1.0e-30 ? 1048576.0 : 1.0;
    precise float q = (smaller * size) / (larger * size);
    q = larger == 0.0 ? 0.0 : smaller == uintBitsToFloat(0x7f800000u) ? 1.0 : q;
    float part = sh_atan_near_zero(q);
    precise float r = steep ? 1.57079637 - (part + 4.3711388e-8) : part;
    r = floatBitsToInt(x) < 0 ? 3.14159274 - (r + 8.7422777e-8) : r;
    r = floatBitsToInt(y) < 0 ? -r : r;
    precise bool ordered = x == x && y == y;
    return ordered ? r : uintBitsToFloat(0x7fc00000u);
}

float sh_sinh(float x) {
    float a = abs(x);
    precise float z = a * a;
    precise float p = ((z * 2.8169513e-6 + 1.983616e-4) * z + 8.33335e-3) * z + 1.6666667e-1;
    float e = sh_exp_times(a, -1);
    precise float r = a < 1.0 ? a + a * z * p : e - 0.25 / e;
    return floatBitsToInt(x) < 0 ? -r : r;
}

float sh_cosh(float x) {
    float e = sh_exp_times(abs(x), -1);
    precise float r = e + 0.25 / e;
    return r;
}

float sh_tanh(float x) {
    float a = abs(x);
    precise float z = a * a;
    precise float p = 2.1180182e-3;
    p = p * z - 8.150698e-3;
    p = p * z + 2.1690154e-2;
    p = p * z - 5.394489e-2;
    p = p * z + 1.3333191e-1;
    p = p * z - 3.333333e-1;
    precise float r = a < 0.625 ? a + a * z * p : 1.0 - 2.0 / (sh_exp(2.0 * a) + 1.0);
    return floatBitsToInt(x) < 0 ? -r : r;
}

float sh_asinh(float x) {
    float a = abs(x);
    precise float z = a * a;
    precise float r = a > 4096.0 ? sh_log(a) + 0.693147181 : sh_log1p(a + z / (1.0 + sqrt(z + 1.0)));
    return floatBitsToInt(x) < 0 ? -r : r;
}

float sh_acosh(float x) {
    precise float t = x - 1.0;
    precise float r = t > 4096.0 ? sh_log(x) + 0.693147181 : sh_log1p(t + sqrt(2.0 * t + t * t));
    return x < 1.0 ? uintBitsToFloat(0x7fc00000u) : r;
}

float sh_atanh(float x) {
    float a = abs(x);
    precise float r = 0.5 * sh_log1p(2.0 * a / (1.0 - a));
    r = a > 1.0 ? uintBitsToFloat(0x7fc00000u) : r;
    return floatBitsToInt(x) < 0 ? -r : r;
}

// log2(a) of a positive finite a as a sum of two floats: 2 / ln 2 * atanh(f / (2 + f)), the quotient in two parts.
vec2 sh_log2_twice(float a) {
    bool tiny = a < 1.17549435e-38;
    int bits = floatBitsToInt(tiny ? a * 8388608.0 : a) - 0x3f3504f3;
    precise float f = intBitsToFloat((bits & 0x7fffff) + 0x3f3504f3) - 1.0;
    precise float below = 2.0 + f;
    precise float below_rest = f - (below - 2.0);
    precise float s = f / below;
    vec2 back = sh_two_product(s, below);
    precise float s_rest = (((f - back.x) - back.y) - s * below_rest) / below;
    precise float z = s * s;
    precise float p = ((z * 1.1797058e-1 + 1.426836e-1) * z + 2.0000172e-1) * z + 3.333333e-1;
    vec2 main_part = sh_two_product(s, 2.88539004);
    precise float rest = main_part.y + s * 3.851926e-8 + (s_rest + s * z * p) * 2.88539004;
    vec2 sum = sh_two_sum(float((bits >> 23) - (tiny ? 23 : 0)), main_part.x);
    return sh_two_sum(sum.x, sum.y + rest);
}

// C99 7.12.7.4 and F.9.4.4.
float sh_pow(float x, float y) {
    float infinity = uintBitsToFloat(0x7f800000u);
    float a = abs(x);
    vec2 l = sh_log2_twice(a);
    float exponent = y > 1.0e10 ? 1.0e10 : y < -1.0e10 ? -1.0e10 : y;
    vec2 t = sh_two_product(exponent, l.x);
    precise float high = t.x > 200.0 ? 200.0 : t.x < -200.0 ? -200.0 : t.x;
    precise float low = high == t.x ? t.y + exponent * l.y : 0.0;
    precise float k = roundEven(high);
    precise float e = (high - k) * 0.693147181 + low * 0.693147181;
    float r = sh_scale(sh_exp_near_zero(e), int(k));
    r = a == 0.0 || a == infinity ? ((y > 0.0) == (a > 1.0) ? infinity : 0.0) : r;
    bool whole = floor(y) == y;
    bool odd = whole && abs(y) < 16777216.0 && floor(y * 0.5) * 2.0 != y;
    r = floatBitsToInt(x) < 0 && odd ? -r : r;
    precise bool lost = x != x || y != y || (x < 0.0 && !whole && a != infinity);
    r = lost ? uintBitsToFloat(0x7fc00000u) : r;
    return y == 0.0 || x == 1.0 || (a == 1.0 && abs(y) == infinity) ? 1.0 : r;
}
