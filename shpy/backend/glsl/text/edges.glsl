// Operations of one component that GLSL 3.30 leaves undefined, or drivers compute differently, as the op table says.
// Read by prologue.py, which emits what a program uses and adds the vector forms. Parameters are precise, for what is
// computed where they are handed over must be as well: a driver may take `sh_isnan(a - a)` for `sh_isnan(0.0)`.

// x, from which the driver cannot derive other conditions.
bool sh_keep(precise bool x) {
    return (uint(x) ^ sh_nothing) != 0u;
}

bool sh_and(precise bool a, precise bool b) {
    return a && b;
}

bool sh_or(precise bool a, precise bool b) {
    return a || b;
}

bool sh_xor(precise bool a, precise bool b) {
    return a != b;
}

float sh_select(precise bool c, precise float a, precise float b) {
    return c ? a : b;
}

int sh_select(precise bool c, int a, int b) {
    return c ? a : b;
}

uint sh_select(precise bool c, uint a, uint b) {
    return c ? a : b;
}

bool sh_select(precise bool c, precise bool a, precise bool b) {
    return c ? a : b;
}

// The smaller argument; if one is NaN, the other.
float sh_min(precise float a, precise float b) {
    precise bool second = b < a || a != a;
    return second ? b : a;
}

float sh_max(precise float a, precise float b) {
    precise bool second = a < b || a != a;
    return second ? b : a;
}

float sh_clamp(precise float x, precise float low, precise float high) {
    return sh_min(sh_max(x, low), high);
}

// The square root of a device that rounds it wrong: one step of Newton's method, with the exact remainder.
double sh_sqrt(precise double x) {
    precise double root = sqrt(x);
    precise double rest = fma(-root, root, x);
    precise double exact = fma(rest, 0.5lf / root, root);
    precise bool finite = x > 0.0lf && x < 1e300lf;
    return finite ? exact : root;
}

// The least int is its own absolute value; a driver may take abs(i) < 0 for false.
int sh_abs(int i) {
    return i < 0 ? int(0u - uint(i)) : i;
}

// Truncates and saturates; 0 for NaN.
int sh_int(precise float x) {
    precise bool inside = x > -2147483648.0 && x < 2147483648.0;
    precise bool above = x >= 2147483648.0;
    precise bool below = x <= -2147483648.0;
    return inside ? int(x) : above ? 2147483647 : below ? (-2147483647 - 1) : 0;
}

// In two halves: a driver may convert through int.
uint sh_uint(precise float x) {
    precise bool inside = x > 0.0 && x < 4294967296.0;
    precise bool above = x >= 4294967296.0;
    precise float past = x - 2147483648.0;
    uint whole = x >= 2147483648.0 ? uint(int(past)) + 2147483648u : uint(int(x));
    return inside ? whole : above ? 4294967295u : 0u;
}

// floor(a / b) from a division that truncates; 0 for b = 0.
int sh_floordiv(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int q = a / by;
    int rest = a - q * by;
    q -= rest != 0 && (rest ^ by) < 0 ? 1 : 0;
    return b == 0 ? 0 : b == -1 ? -a : q;
}

uint sh_floordiv(uint a, uint b) {
    return b == 0u ? 0u : a / max(b, 1u);
}

// a - b * floor(a / b); 0 for b = 0. Drivers' own % is unsigned.
int sh_floormod(int a, int b) {
    int by = b == 0 || b == -1 ? 1 : b;
    int rest = a - a / by * by;
    return rest != 0 && (rest ^ by) < 0 ? rest + by : rest;
}

uint sh_floormod(uint a, uint b) {
    return b == 0u ? 0u : a % max(b, 1u);
}

// Counts pairs, fours, bytes, and sums the bytes by a product.
uint sh_popcount(uint a) {
    a -= (a >> 1) & 0x55555555u;
    a = (a & 0x33333333u) + ((a >> 2) & 0x33333333u);
    return (((a + (a >> 4)) & 0x0f0f0f0fu) * 0x01010101u) >> 24;
}

// i / n and i % n for i >= 0, n > 0, by way of floats: drivers divide the integers of each fragment on its own.
ivec2 sh_split(int i, int n) {
    int q = int(float(i) / float(n));
    q += int(floor(float(i - q * n) / float(n)));
    int r = i - q * n;
    return r < 0 ? ivec2(q - 1, r + n) : r < n ? ivec2(q, r) : ivec2(q + 1, r - n);
}

int sh_popcount(int a) {
    return int(sh_popcount(uint(a)));
}

// Makes ones of all bits below the highest one bit, and counts the others.
uint sh_count_leading_zeros(uint a) {
    a |= a >> 1;
    a |= a >> 2;
    a |= a >> 4;
    a |= a >> 8;
    a |= a >> 16;
    return 32u - sh_popcount(a);
}

int sh_count_leading_zeros(int a) {
    return int(sh_count_leading_zeros(uint(a)));
}

uint sh_bits(precise float x) {
    precise bool nan = x != x;
    return nan ? 0x7fc00000u : floatBitsToUint(x);
}

bool sh_isnan(precise float x) {
    return (floatBitsToUint(x) & 0x7fffffffu) > 0x7f800000u;
}

bool sh_isinf(precise float x) {
    return (floatBitsToUint(x) & 0x7fffffffu) == 0x7f800000u;
}

float sh_sign(precise float x) {
    precise bool above = x > 0.0;
    precise bool below = x < 0.0;
    return float(above) - float(below);
}

// x * 2^n rounded once: by the bits, but for results that are denormal (one product) or too large.
float sh_ldexp(precise float x, int n) {
    uint bits = floatBitsToUint(x);
    int raised = (bits & 0x7f800000u) == 0u ? 24 : 0;
    precise float normal = raised == 0 ? x : x * 16777216.0;
    int own = int((floatBitsToUint(normal) >> 23) & 255u);
    int e = own - raised + clamp(n, -1000, 1000);
    float at_e = uintBitsToFloat((floatBitsToUint(normal) & 0x807fffffu) | (uint(clamp(e, 1, 254)) << 23));
    precise float small = at_e * uintBitsToFloat(uint(clamp(126 + e, 1, 126)) << 23);
    float infinity = uintBitsToFloat(0x7f800000u | (bits & 0x80000000u));
    precise bool kept = x == 0.0 || own == 255;
    return kept ? x : e > 254 ? infinity : e < 1 ? small : at_e;
}

// The nearest binary16, half to even: by the bits, but for halves that are denormal, where 2^-24 is the last place.
float sh_half(precise float x) {
    uint bits = floatBitsToUint(x);
    uint size = bits & 0x7fffffffu;
    uint rounded = (size + 0xfffu + ((size >> 13) & 1u)) & 0xffffe000u;
    rounded = rounded >= 0x47800000u ? 0x7f800000u : rounded;
    precise float small = (uintBitsToFloat(size) + 0.5) - 0.5;
    rounded = size > 0x7f800000u ? 0x7fc00000u : size < 0x38800000u ? floatBitsToUint(small) : rounded;
    return uintBitsToFloat(rounded | (bits & 0x80000000u));
}

// a * b as a sum of two floats (Dekker 1971), for products that neither overflow nor underflow.
vec2 sh_two_product(precise float a, precise float b) {
    precise float product = a * b;
    precise float a_high = a * 4097.0 - (a * 4097.0 - a);
    precise float b_high = b * 4097.0 - (b * 4097.0 - b);
    precise float a_low = a - a_high;
    precise float b_low = b - b_high;
    precise float rest = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low;
    return vec2(product, rest);
}

// a + b as a sum of two floats (Knuth 1969).
vec2 sh_two_sum(precise float a, precise float b) {
    precise float sum = a + b;
    precise float back = sum - a;
    precise float rest = (a - (sum - back)) + (b - back);
    return vec2(sum, rest);
}

// a * b + c rounded once: the exact parts of the product and of the sums, the lower ones rounded to odd (Boldo and
// Melquiond 2008). Mantissas are taken to [1, 2), so that no part leaves the range.
float sh_fma(precise float a, precise float b, precise float c) {
    uvec3 bits = floatBitsToUint(vec3(a, b, c));
    ivec3 e = ivec3((bits >> 23) & 255u) - 127;
    vec3 m = uintBitsToFloat((bits & 0x807fffffu) | 0x3f800000u);
    int scale = e.x + e.y;
    int above = max(e.z - scale, -60);
    vec2 product = sh_two_product(m.x, m.y);
    vec2 low = sh_two_sum(uintBitsToFloat((bits.z & 0x807fffffu) | (uint(clamp(above, -60, 60) + 127) << 23)), product.y);
    vec2 high = sh_two_sum(product.x, low.x);
    vec2 rest = sh_two_sum(low.y, high.y);
    uint odd = floatBitsToUint(rest.x);
    bool outward = (rest.y < 0.0) == (rest.x < 0.0);
    odd = rest.y != 0.0 && (odd & 1u) == 0u ? (outward ? odd + 1u : odd - 1u) : odd;
    precise float sum = high.x + uintBitsToFloat(odd);
    bool huge = max(e.x, e.y) < 128 && e.z == 128;
    bool alone = c == 0.0 && a != 0.0 && b != 0.0;  // a product that is flushed to zero keeps its sign
    precise float plain = huge ? c : alone ? a * b : a * b + c;
    bool simple = a == 0.0 || b == 0.0 || c == 0.0 || max(e.x, max(e.y, e.z)) == 128 || min(e.x, min(e.y, e.z)) == -127;
    return simple ? plain : above > 55 ? c : sh_ldexp(sum, scale);
}

// Payne and Hanek's reduction of passes/formulas/portable/payne_hanek.py, as a loop over the digits of 2 / pi, which is a quarter
// of the text: a small angle takes one iteration, also on devices that execute both sides of a branch.
vec3 sh_payne_hanek(precise float x) {
    const float digits[17] = float[17](0.0, 163.0, -104.0, 878.0, 1252.0, 1045.0, 672.0, -985.0, 1405.0,
        501.0, 846.0, -575.0, -586.0, 662.0, -1644.0, -956.0, -1788.0);
    // The number of digits by which x is scaled: a twelfth of its exponent.
    int scale = clamp(((floatBitsToInt(x) >> 23 & 255) - 147) * 43 >> 9, 0, 8);
    precise float mantissa = x * intBitsToFloat(107 - 12 * scale << 23);
    precise float first = mantissa + 1.2582912e+07 - 1.2582912e+07;
    precise float rest = (mantissa - first) * 4096.0;
    precise float second = rest + 1.2582912e+07 - 1.2582912e+07;
    precise float third = (rest - second) * 4096.0;
    precise float a = 0.0, b = 0.0, c = 0.0, carry = 0.0, k = 0.0;
    precise float p = 0.0, p_2 = 0.0, p_3 = 0.0, p_4 = 0.0, p_5 = 0.0, p_6 = 0.0, p_7 = 0.0;
    for (int n = scale + 8; n >= scale; n--) {
        a = b;
        b = c;
        c = digits[n];
        k = first * a + second * b + third * c + carry;
        p = p_2;
        p_2 = p_3;
        p_3 = p_4;
        p_4 = p_5;
        p_5 = p_6;
        p_6 = p_7;
        carry = k * 0.00024414062 + 1.2582912e+07 - 1.2582912e+07;
        p_7 = k - carry * 4096.0;
        carry = n > scale + 6 ? 0.0 : carry;
    }
    precise float pair = (p_6 * 4096.0 + p_5) * 5.9604645e-08;
    precise float pair_2 = (p_4 * 4096.0 + p_3) * 3.5527137e-15;
    precise float pair_3 = (p_2 * 4096.0 + p) * 2.1175824e-22;
    precise float sum = pair + pair_2;
    precise float low = pair_2 - (sum - pair) + pair_3;
    precise vec2 product = sh_two_product(sum, 1.5707964);
    precise float tail = product.y + (sum * -4.371139e-08 + low * 1.5707964);
    precise float high = product.x + tail;
    precise vec3 result = vec3(high, tail - (high - product.x), k);
    return result;
}
