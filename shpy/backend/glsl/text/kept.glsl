// The functions of edges.glsl that need `precise`, for devices that do not know it: sh_keep takes its place.

// The nearest binary16, half to even: by the bits, but for halves that are denormal, where 2^-24 is the last place.
float sh_half(precise float x) {
    uint bits = floatBitsToUint(x);
    uint size = bits & 0x7fffffffu;
    uint rounded = (size + 0xfffu + ((size >> 13) & 1u)) & 0xffffe000u;
    rounded = rounded >= 0x47800000u ? 0x7f800000u : rounded;
    float small = sh_keep(sh_keep(uintBitsToFloat(size) + 0.5) - 0.5);
    rounded = size > 0x7f800000u ? 0x7fc00000u : size < 0x38800000u ? floatBitsToUint(small) : rounded;
    return uintBitsToFloat(rounded | (bits & 0x80000000u));
}

// a * b as a sum of two floats (Dekker 1971), for products that neither overflow nor underflow.
vec2 sh_two_product(precise float a, precise float b) {
    float product = sh_keep(a * b);
    float a_wide = sh_keep(a * 4097.0);
    float b_wide = sh_keep(b * 4097.0);
    float a_high = sh_keep(a_wide - sh_keep(a_wide - a));
    float b_high = sh_keep(b_wide - sh_keep(b_wide - b));
    float a_low = sh_keep(a - a_high);
    float b_low = sh_keep(b - b_high);
    float first = sh_keep(sh_keep(a_high * b_high) - product);
    float cross = sh_keep(sh_keep(first + sh_keep(a_high * b_low)) + sh_keep(a_low * b_high));
    return vec2(product, sh_keep(cross + sh_keep(a_low * b_low)));
}

// a + b as a sum of two floats (Knuth 1969).
vec2 sh_two_sum(precise float a, precise float b) {
    float sum = sh_keep(a + b);
    float back = sh_keep(sum - a);
    return vec2(sum, sh_keep(sh_keep(a - sh_keep(sum - back)) + sh_keep(b - back)));
}

// 0.0 for zeros and NaN, by the bits: Mesa takes abs(x) > 0.0 for x != 0.0, which holds for NaN.
float sh_sign(precise float x) {
    uint bits = floatBitsToUint(x);
    uint size = bits & 0x7fffffffu;
    return size == 0u || size > 0x7f800000u ? 0.0 : bits == size ? 1.0 : -1.0;
}
