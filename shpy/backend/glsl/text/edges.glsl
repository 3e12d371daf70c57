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
