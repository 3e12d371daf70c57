"""The kernels that tell the faults of an OpenCL device and its abilities in binary64: results are compared bit for bit.

Stage: run. The compiler knows none of the inputs: NaN and the hard inputs are data. Strict mode's elementary functions
are formulas in binary64 where a device computes exactly in it.

    abilities_in_binary64(machine.probe, lanes=16, flushed=False)          # {"exact", "fused"}
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from shpy.backend.device.probe import COUNT, hard_inputs, is_exact_in_binary64

# Seven results of binary32 for each element, and four ints that are 0 where the device is right, but for the first.
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

ABILITIES: Final = frozenset({"exact", "fused"})
"""Abilities of a device: every operation is rounded correctly, and fma is quick besides."""

# Drivers of processors do not define FP_FAST_FMA, but the macros of their compiler tell.
BINARY64: Final = """\
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#pragma OPENCL FP_CONTRACT OFF
__kernel void probe(__global floatWIDE *a, __global floatWIDE *b, __global floatWIDE *c,
                    __global doubleWIDE *r, __global floatWIDE *narrow, __global int *quick) {
    size_t i = get_global_id(0), all = get_global_size(0);
    doubleWIDE d = convert_doubleWIDE(a[i]);
    doubleWIDE x = d * convert_doubleWIDE(b[i]);
    doubleWIDE y = x * convert_doubleWIDE(c[i]);
    r[i] = y;
    r[all + i] = x + y;
    r[2 * all + i] = d - y;
    r[3 * all + i] = x / y;
    r[4 * all + i] = sqrt(x);
    r[5 * all + i] = floor(d * 0.3);
    r[6 * all + i] = fma(x, y, -x);
    narrow[i] = convert_floatWIDE(2 * i < all ? d * 1.5 : x);
#if defined(FP_FAST_FMA) || defined(__FMA__) || defined(__ARM_FEATURE_FMA)
    quick[0] = 1;
#else
    quick[0] = 0;
#endif
}
"""
_NAMES: Final = ("mul", "add", "sub", "div", "sqrt", "floor", "fma")


def abilities_in_binary64(probe: Callable[..., Any], *, lanes: int, flushed: bool) -> frozenset[str]:
    """Probe a device that has binary64: return the names of its abilities, from ABILITIES.

    `probe` runs a text on it (`Machine.probe`). `flushed`: it makes zeros of denormals of binary32.
    """
    results, narrow, quick = np.empty((7, COUNT)), np.empty(COUNT, np.float32), np.empty(1, np.int32)
    probe(BINARY64.replace("WIDE", str(lanes) if lanes > 1 else ""), hard_inputs(), (results, narrow, quick))
    answers = dict(zip(_NAMES, results, strict=True)) | {"narrow": narrow}
    fused = answers.pop("fma")
    if not is_exact_in_binary64(answers, flushed=flushed):
        return frozenset()
    quickly = bool(quick[0]) and is_exact_in_binary64({"fma": fused}, flushed=flushed)
    return ABILITIES if quickly else frozenset({"exact"})
