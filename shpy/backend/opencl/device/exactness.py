"""The kernel that tells the faults of an OpenCL device: its results are compared with exact ones.

Stage: run. Seven results of binary32 for each element, and four ints that are 0 where the device is right, but for the
first. The compiler knows none of the inputs: NaN and the hard inputs are data.
"""

from typing import Final

EXACTNESS: Final = """\
#pragma OPENCL FP_CONTRACT OFF
#ifdef cl_khr_fp64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif
__kernel void probe(__global floatWIDE *a, __global floatWIDE *b, __global floatWIDE *c, __global floatWIDE *nan,
                    __global floatWIDE *r, __global intWIDE *n) {
    size_t i = get_global_id(0), all = get_global_size(0);
    floatWIDE x = a[i], y = b[i];
    r[i] = x + y;
    r[all + i] = x - y;
    r[2 * all + i] = x * y;
    r[3 * all + i] = x / y;
    r[4 * all + i] = sqrt(x);
    r[5 * all + i] = floor(x);
    r[6 * all + i] = fma(x, y, c[i]);
    n[i] = convert_intWIDE_sat(x);
    floatWIDE m = as_floatWIDE(as_uintWIDE(nan[i]) << 9);  // -0.0, of the bits 7FC00000
    floatWIDE zero = 0.0f, other = !(zero <= m) & (m == m) ? m : zero;
    n[2 * all + i] = (isnan(nan[i] * 0.0f) == 0) | as_intWIDE(m < zero ? m : zero) | as_intWIDE(other);
    int v = 0, left = 0;
    while (v < 4) {  // whose second exit never holds, as it follows `v += 1`
        v += 1;
        if (v < 1) {
            left = 1;
            break;
        }
    }
    n[3 * all + i] = left;
    n[all + i] = convert_intWIDE_sat(nan[i]) | as_intWIDE(convert_uintWIDE_sat(nan[i]));
#ifdef cl_khr_fp64
    doubleWIDE wide = convert_doubleWIDE(nan[i]);
    n[all + i] |= convert_intWIDE_sat(wide) | as_intWIDE(convert_uintWIDE_sat(wide));
#endif
}
"""
