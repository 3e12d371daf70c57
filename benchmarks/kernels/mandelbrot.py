"""Mandelbrot: a loop of another length in every element, a handful of operations in it.

Every version takes points (n, n, 2) and gives the iterations that each takes to leave, as floats (n, n).
"""

import numpy as np

import shpy as sh
from benchmarks.peers import filled, launched
from benchmarks.work import Work
from shpy import SH_DO, SH_UNTIL

ITERATIONS = 256


def points(size):
    x, y = np.meshgrid(np.linspace(-2.2, 0.6, size), np.linspace(-1.2, 1.2, size))
    return (np.stack([x, y], axis=-1).astype(np.float32),)


WORK = Work(
    "mandelbrot",
    f"Mandelbrot set, {{size}} x {{size}}, at most {ITERATIONS} iterations",
    inputs=points,
    size=1024,
    quick=64,
    within=0.0,
    share=0.01,
    note="Points on the border leave some iterations earlier or later where products and sums are fused.",
)


@sh.program
def mandelbrot(c: sh.Point2f) -> sh.Attrib1f:
    z = sh.Attrib2f(0, 0)
    n = sh.Attrib1f(0)
    with SH_DO():
        z[:] = sh.Attrib2f(z.x * z.x - z.y * z.y, 2 * z.x * z.y) + c
        n += 1
        SH_UNTIL((sh.dot(z, z) > 4) | (n >= ITERATIONS))
    return n


@WORK.ours
def ours(compiled, c):
    kernel = compiled(mandelbrot)
    return lambda: kernel(c)


@WORK.version("masks")
def masks(c):
    def run():
        cx, cy = np.ascontiguousarray(c[..., 0]), np.ascontiguousarray(c[..., 1])
        zx, zy, n = np.zeros_like(cx), np.zeros_like(cx), np.zeros_like(cx)
        live = np.ones(cx.shape, bool)
        with np.errstate(all="ignore"):  # who has left goes on to infinity
            for _ in range(ITERATIONS):
                zx, zy = zx * zx - zy * zy + cx, 2 * zx * zy + cy
                n += live
                live &= zx * zx + zy * zy <= 4
                if not live.any():
                    break
        return n

    return run


@WORK.version("drjit")
def drjit(c):
    import drjit as dr
    from drjit.llvm import Array2f, Float

    def iterate(zx, zy, n, c):
        return dr.fma(zx, zx, dr.fma(-zy, zy, c.x)), dr.fma(2 * zx, zy, c.y), n + 1, c

    def goes_on(zx, zy, n, c):
        return (zx * zx + zy * zy <= 4) & (n < ITERATIONS)

    def run():
        x, y = np.moveaxis(c.reshape(-1, 2), 1, 0)
        start = Float(0), Float(0), Float(0), Array2f(Float(x), Float(y))
        return np.asarray(dr.while_loop(start, goes_on, iterate)[2]).reshape(c.shape[:-1])

    return run


@WORK.version("taichi")
def taichi(c):
    import taichi as ti

    @ti.kernel
    def kernel(c: ti.types.ndarray(dtype=ti.math.vec2, ndim=2), out: ti.types.ndarray(dtype=ti.f32, ndim=2)):
        for i, j in out:
            z = ti.Vector([0.0, 0.0])
            n = 0.0
            while z.dot(z) <= 4 and n < ITERATIONS:
                z = ti.Vector([z[0] * z[0] - z[1] * z[1], 2 * z[0] * z[1]]) + c[i, j]
                n += 1
            out[i, j] = n

    return filled(kernel, c.shape[:-1], c)


@WORK.version("warp")
def warp(c):
    import warp as wp

    @wp.kernel
    def kernel(c: wp.array2d(dtype=wp.vec2), out: wp.array2d(dtype=float)):
        i, j = wp.tid()
        z = wp.vec2(0.0, 0.0)
        n = wp.float32(0.0)
        while wp.dot(z, z) <= 4.0 and n < 256.0:
            z = wp.vec2(z[0] * z[0] - z[1] * z[1], 2.0 * z[0] * z[1]) + c[i, j]
            n += 1.0
        out[i, j] = n

    return launched(kernel, c.shape[:-1], lambda: [wp.array(c, dtype=wp.vec2, copy=False)])


@WORK.version("numba")
def numba(c):
    from numba import njit, prange

    @njit(parallel=True, fastmath=True)
    def kernel(c):
        height, width, _ = c.shape
        out = np.empty((height, width), np.float32)
        for i in prange(height):
            for j in range(width):
                cx, cy = c[i, j, 0], c[i, j, 1]
                zx = zy = np.float32(0)
                n = 0
                while zx * zx + zy * zy <= np.float32(4) and n < ITERATIONS:
                    zx, zy = zx * zx - zy * zy + cx, np.float32(2) * zx * zy + cy
                    n += 1
                out[i, j] = n
        return out

    return lambda: kernel(c)


@WORK.version("jax")
def jax(c):
    import jax
    import jax.numpy as jnp

    def escape(c):
        def iterate(state):
            x, y, n = state
            return x * x - y * y + c[0], 2 * x * y + c[1], n + 1

        zero = jnp.float32(0)
        goes_on = lambda s: (s[0] * s[0] + s[1] * s[1] <= 4) & (s[2] < ITERATIONS)  # noqa: E731
        return jax.lax.while_loop(goes_on, iterate, (zero, zero, zero))[2]

    kernel = jax.jit(jax.vmap(jax.vmap(escape)))
    return lambda: np.asarray(kernel(c))
