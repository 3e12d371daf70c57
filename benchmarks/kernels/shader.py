"""A procedural shader: veins of marble, five octaves of gradient noise over a hash of integers.

Every version makes a picture (n, n) from its size alone. The noise is that of `sh.noise`, written out for the peers:
PCG as a hash (O'Neill 2014, Jarzynski and Olano 2020), gradients from its bits, Perlin's fade curve (2002).
"""

from types import SimpleNamespace

import numpy as np

import shpy as sh
from benchmarks.peers import filled, launched
from benchmarks.work import Work
from shpy import SH_IF

OCTAVES = 5
EXTENT = 8.0

WORK = Work(
    "shader",
    f"A marble of {{size}} x {{size}} pixels, {OCTAVES} octaves of noise",
    inputs=lambda size: (size,),
    size=1024,
    quick=48,
    within=1e-3,
    share=1e-3,
    note="Pixels on the border of a vein may fall to the other side.",
)


@sh.program
def marble() -> sh.Attrib1f:
    row, column = sh.grid_index(2)
    height, width = sh.grid_shape(2)
    p = EXTENT * (sh.vec2(column, row) + 0.5) / sh.vec2(width, height)
    rough = sh.Attrib1f(0)
    for k in range(OCTAVES):
        rough += sh.noise(p * 2.0**k) / 2**k
    tone = sh.Attrib1f(0.5 + 0.5 * sh.sin(4 * p.x + 6 * rough))
    with SH_IF(rough > 0.3):
        tone[:] = 0.8 * sh.sqrt(tone)
    return tone


@WORK.ours
def ours(compiled, size):
    kernel = compiled(marble)
    return lambda: kernel(shape=(size, size))


def marble_of(m, x, y):
    """Return the picture at places; `m` has the functions of numpy, JAX or Dr.Jit."""
    u = m.uint

    def pcg(x):
        state = x * u(747796405) + u(2891336453)
        word = ((state >> ((state >> u(28)) + u(4))) ^ state) * u(277803737)
        return (word >> u(22)) ^ word

    def slope(h, x, y):
        return (m.real(h & u(0xFFFF)) * 2.0**-15 - 1) * x + (m.real(h >> u(16)) * 2.0**-15 - 1) * y

    def noise(x, y):
        cx, cy = m.floor(x), m.floor(y)
        i, j = m.cell(cx), m.cell(cy)
        x, y = x - cx, y - cy
        fx, fy = (t * t * t * (t * (t * 6 - 15) + 10) for t in (x, y))
        low, high = pcg(j), pcg(j + u(1))
        a, b = slope(pcg(i + low), x, y), slope(pcg(i + u(1) + low), x - 1, y)
        c, d = slope(pcg(i + high), x, y - 1), slope(pcg(i + u(1) + high), x - 1, y - 1)
        return m.lerp(m.lerp(a, b, fx), m.lerp(c, d, fx), fy)

    rough = sum(noise(x * 2.0**k, y * 2.0**k) / 2**k for k in range(OCTAVES))
    tone = 0.5 + 0.5 * m.sin(4 * x + 6 * rough)
    return m.where(rough > 0.3, 0.8 * m.sqrt(tone), tone)


def in_arrays(xp, size):
    """Return the picture with numpy or JAX as `xp`."""
    functions = {name: getattr(xp, name) for name in ("floor", "sin", "sqrt", "where")}
    casts = {"uint": xp.uint32, "cell": lambda a: a.astype(xp.uint32), "real": lambda a: a.astype(xp.float32)}
    m = SimpleNamespace(**functions, **casts, lerp=lambda a, b, t: a + (b - a) * t)
    at = (xp.arange(size, dtype=xp.float32) + 0.5) * xp.float32(EXTENT / size)
    return marble_of(m, at[None, :], at[:, None])


@WORK.version("masks")
def masks(size):
    return lambda: in_arrays(np, size)


@WORK.version("jax")
def jax(size):
    import jax
    import jax.numpy as jnp

    kernel = jax.jit(lambda: in_arrays(jnp, size))
    return lambda: np.asarray(kernel())


@WORK.version("drjit")
def drjit(size):
    import drjit as dr
    from drjit.llvm import Float, UInt32

    functions = {name: getattr(dr, name) for name in ("floor", "sin", "sqrt", "lerp")}
    m = SimpleNamespace(**functions, uint=UInt32, cell=UInt32, real=Float, where=dr.select)

    def run():
        index = dr.arange(UInt32, size * size)
        x, y = ((Float(i) + 0.5) * (EXTENT / size) for i in (index % size, index // size))
        return np.asarray(marble_of(m, x, y)).reshape(size, size)

    return run


@WORK.version("taichi")
def taichi(size):
    import taichi as ti

    @ti.func
    def pcg(x):
        state = x * ti.u32(747796405) + ti.u32(2891336453)
        word = ((state >> ((state >> 28) + ti.u32(4))) ^ state) * ti.u32(277803737)
        return (word >> 22) ^ word

    @ti.func
    def slope(h, x, y):
        gx = ti.cast(h & ti.u32(0xFFFF), ti.f32) / 2**15 - 1
        gy = ti.cast(h >> 16, ti.f32) / 2**15 - 1
        return gx * x + gy * y

    @ti.func
    def noise(p):
        cell = ti.floor(p)
        i, j = ti.cast(cell.x, ti.u32), ti.cast(cell.y, ti.u32)
        x, y = p.x - cell.x, p.y - cell.y
        fx, fy = x * x * x * (x * (x * 6 - 15) + 10), y * y * y * (y * (y * 6 - 15) + 10)
        low, high = pcg(j), pcg(j + ti.u32(1))
        a, b = slope(pcg(i + low), x, y), slope(pcg(i + ti.u32(1) + low), x - 1, y)
        c, d = slope(pcg(i + high), x, y - 1), slope(pcg(i + ti.u32(1) + high), x - 1, y - 1)
        return ti.math.mix(ti.math.mix(a, b, fx), ti.math.mix(c, d, fx), fy)

    @ti.kernel
    def kernel(out: ti.types.ndarray(dtype=ti.f32, ndim=2)):
        for i, j in out:
            p = (ti.math.vec2(j, i) + 0.5) * (EXTENT / size)
            rough = 0.0
            for k in ti.static(range(OCTAVES)):
                rough += noise(p * 2.0**k) / 2**k
            tone = 0.5 + 0.5 * ti.sin(4 * p.x + 6 * rough)
            if rough > 0.3:
                tone = 0.8 * ti.sqrt(tone)
            out[i, j] = tone

    return filled(kernel, (size, size))


@WORK.version("warp")
def warp(size):
    import warp as wp

    u = wp.uint32

    @wp.func
    def pcg(x: wp.uint32):
        state = x * u(747796405) + u(2891336453)
        word = ((state >> ((state >> u(28)) + u(4))) ^ state) * u(277803737)
        return (word >> u(22)) ^ word

    @wp.func
    def slope(h: wp.uint32, x: float, y: float):
        gx = wp.float32(h & u(65535)) / 32768.0 - 1.0
        gy = wp.float32(h >> u(16)) / 32768.0 - 1.0
        return gx * x + gy * y

    @wp.func
    def noise(px: float, py: float):
        cx, cy = wp.floor(px), wp.floor(py)
        i, j = u(cx), u(cy)
        x, y = px - cx, py - cy
        fx, fy = x * x * x * (x * (x * 6.0 - 15.0) + 10.0), y * y * y * (y * (y * 6.0 - 15.0) + 10.0)
        low, high = pcg(j), pcg(j + u(1))
        a, b = slope(pcg(i + low), x, y), slope(pcg(i + u(1) + low), x - 1.0, y)
        c, d = slope(pcg(i + high), x, y - 1.0), slope(pcg(i + u(1) + high), x - 1.0, y - 1.0)
        return wp.lerp(wp.lerp(a, b, fx), wp.lerp(c, d, fx), fy)

    @wp.kernel
    def kernel(out: wp.array2d(dtype=float)):
        i, j = wp.tid()
        x = (wp.float32(j) + 0.5) * (8.0 / wp.float32(out.shape[1]))
        y = (wp.float32(i) + 0.5) * (8.0 / wp.float32(out.shape[0]))
        rough = wp.float32(0.0)
        scale = wp.float32(1.0)
        for _ in range(5):
            rough += noise(x * scale, y * scale) / scale
            scale *= 2.0
        tone = 0.5 + 0.5 * wp.sin(4.0 * x + 6.0 * rough)
        if rough > 0.3:
            tone = 0.8 * wp.sqrt(tone)
        out[i, j] = tone

    return launched(kernel, (size, size))


@WORK.version("numba")
def numba(size):
    from numba import njit, prange

    f, u = np.float32, np.uint32  # without them a constant is 64 bits wide, and so is all that it meets

    @njit(fastmath=True)
    def pcg(x):
        state = u(x * u(747796405) + u(2891336453))
        word = u(((state >> ((state >> u(28)) + u(4))) ^ state) * u(277803737))
        return u((word >> u(22)) ^ word)

    @njit(fastmath=True)
    def slope(h, x, y):
        return (f(h & u(0xFFFF)) * f(2.0**-15) - f(1)) * x + (f(h >> u(16)) * f(2.0**-15) - f(1)) * y

    @njit(fastmath=True)
    def fade(t):
        return t * t * t * (t * (t * f(6) - f(15)) + f(10))

    @njit(fastmath=True)
    def noise(x, y):
        cx, cy = np.floor(x), np.floor(y)
        i, j = u(cx), u(cy)
        x, y = x - cx, y - cy
        fx, fy = fade(x), fade(y)
        low, high = pcg(j), pcg(u(j + u(1)))
        a, b = slope(pcg(u(i + low)), x, y), slope(pcg(u(i + u(1) + low)), x - f(1), y)
        c, d = slope(pcg(u(i + high)), x, y - f(1)), slope(pcg(u(i + u(1) + high)), x - f(1), y - f(1))
        a, c = a + (b - a) * fx, c + (d - c) * fx
        return a + (c - a) * fy

    @njit(parallel=True, fastmath=True)
    def kernel():
        out = np.empty((size, size), np.float32)
        for i in prange(size):
            for j in range(size):
                x, y = (f(j) + f(0.5)) * f(EXTENT / size), (f(i) + f(0.5)) * f(EXTENT / size)
                rough, scale = f(0), f(1)
                for _ in range(OCTAVES):
                    rough += noise(x * scale, y * scale) / scale
                    scale *= f(2)
                tone = f(0.5) + f(0.5) * np.sin(f(4) * x + f(6) * rough)
                out[i, j] = f(0.8) * np.sqrt(tone) if rough > f(0.3) else tone
        return out

    return kernel
