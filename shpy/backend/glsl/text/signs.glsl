// The functions of edges.glsl that choose between floats, for devices that take choices for maxima: these lose the sign
// of a zero. The test for NaN is one of ints, for such a device takes `a < b || a != a` for `!(a >= b)`.

float sh_min(precise float a, precise float b) {
    precise bool second = b < a || (floatBitsToUint(a) & 0x7fffffffu) > 0x7f800000u;
    return second ? b : a;
}

float sh_max(precise float a, precise float b) {
    precise bool second = a < b || (floatBitsToUint(a) & 0x7fffffffu) > 0x7f800000u;
    return second ? b : a;
}
