"""A polynomial by Horner's rule: no branches, as much arithmetic as memory can feed.

Every version takes x (n,) in [-1, 1] and gives a polynomial of degree 31 there, (n,).
"""

import numpy as np

import shpy as sh
from benchmarks.opencl import Device
from benchmarks.peers import filled, launched
from benchmarks.work import Work

COEFFICIENTS = np.random.default_rng(1).normal(size=32).astype(np.float32)
"""The coefficients, that of the highest power first."""


def numbers(size):
    return (np.linspace(-1, 1, size * size, dtype=np.float32),)


WORK = Work(
    "polynomial",
    "A polynomial of degree 31 at {size} x {size} numbers",
    inputs=numbers,
    size=2048,
    quick=64,
    within=2e-5,
)


@sh.program
def polynomial(x: sh.Attrib1f) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    for c in COEFFICIENTS:
        total[:] = sh.mad(total, x, c)
    return total


@WORK.ours
def ours(compiled, x):
    kernel = compiled(polynomial)
    return lambda: kernel(x)


@WORK.version("masks")
def masks(x):
    def run():
        total = np.full_like(x, COEFFICIENTS[0])
        for c in COEFFICIENTS[1:]:
            total *= x
            total += c
        return total

    return run


@WORK.version("hand")
def by_hand(x):
    """Four vectors a work item, whose operations do not wait for each other; x (n,) for n a multiple of 1,024."""
    four = range(4)
    lines = [f"float16 x{k} = *(__global const numbers *)(x + {16 * k}), t{k} = {COEFFICIENTS[0]:.9e}f;" for k in four]
    lines += [f"t{k} = t{k} * x{k} + {c:.9e}f;" for c in COEFFICIENTS[1:] for k in four]
    lines += [f"*(__global numbers *)(out + {16 * k}) = t{k};" for k in four]
    device = Device.opened()
    text = (
        "#pragma OPENCL FP_CONTRACT OFF\n"
        "typedef float16 numbers __attribute__((aligned(4)));\n"
        "__kernel void polynomial(__global const float *x, __global float *out) {\n"
        "x += 64 * get_global_id(0), out += 64 * get_global_id(0);\n" + "\n".join(lines) + "\n}"
    )
    kernel = device.kernel(text, "polynomial", len(x) // 64, 16)

    def run():
        out = np.empty_like(x)
        arrays = device.shared(x), device.shared(out)
        kernel(*arrays)
        device.finish(arrays[1])
        return out

    return run


@WORK.version("drjit")
def drjit(x):
    import drjit as dr
    from drjit.llvm import Float

    def run():
        argument, total = Float(x), Float(0)
        for c in COEFFICIENTS:
            total = dr.fma(total, argument, float(c))
        return np.asarray(total)

    return run


@WORK.version("taichi")
def taichi(x):
    import taichi as ti

    @ti.kernel
    def kernel(x: ti.types.ndarray(dtype=ti.f32, ndim=1), out: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in out:
            total = 0.0
            for k in ti.static(range(len(COEFFICIENTS))):
                total = total * x[i] + float(COEFFICIENTS[k])
            out[i] = total

    return filled(kernel, x.shape, x)


@WORK.version("warp")
def warp(x):
    import warp as wp

    coefficients = wp.array(COEFFICIENTS, dtype=float)

    @wp.kernel
    def kernel(x: wp.array(dtype=float), c: wp.array(dtype=float), out: wp.array(dtype=float)):
        i = wp.tid()
        total = wp.float32(0.0)
        for k in range(32):
            total = total * x[i] + c[k]
        out[i] = total

    return launched(kernel, len(x), lambda: [wp.array(x, dtype=float, copy=False), coefficients])


@WORK.version("numba")
def numba(x):
    from numba import njit, prange

    @njit(parallel=True, fastmath=True)
    def kernel(x):
        out = np.empty_like(x)
        for i in prange(len(x)):
            total = np.float32(0)
            for c in COEFFICIENTS:
                total = total * x[i] + c
            out[i] = total
        return out

    return lambda: kernel(x)


@WORK.version("jax")
def jax(x):
    import jax
    import jax.numpy as jnp

    kernel = jax.jit(lambda x: jnp.polyval(jnp.asarray(COEFFICIENTS), x, unroll=len(COEFFICIENTS)))
    return lambda: np.asarray(kernel(x))
