"""A Gaussian blur along both axes: reads of neighbours, little arithmetic.

Every version takes a picture (n, n) and gives it blurred, (n, n); what lies outside is what lies on the border.
"""

import numpy as np

import shpy as sh
from benchmarks.work import Work

RADIUS = 8
WEIGHTS = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / (RADIUS / 2)) ** 2)
WEIGHTS = (WEIGHTS / WEIGHTS.sum()).astype(np.float32)


def picture(size):
    return (np.random.default_rng(1).random((size, size)).astype(np.float32),)


WORK = Work(
    "blur",
    f"A Gaussian blur of {{size}} x {{size}} pixels, {2 * RADIUS + 1} taps along each axis",
    inputs=picture,
    size=1024,
    quick=40,
    within=1e-5,
)


@WORK.ours
def ours(compiled, picture):
    def along(down, across):
        @sh.program
        def blur(texels: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
            row, column = sh.grid_index(2)
            total = sh.Attrib1f(0)
            for k, weight in enumerate(WEIGHTS, -RADIUS):
                total += weight * texels[row + k * down, column + k * across]
            return total

        return compiled(blur)

    first, second = along(0, 1), along(1, 0)
    source, between = sh.Table(picture, sh.Attrib1f), sh.Table(picture, sh.Attrib1f)

    def run():
        source.update(picture)
        between.update(first(source, shape=picture.shape))
        return second(between, shape=picture.shape)

    return run


@WORK.version("masks")
def masks(picture):
    def along(picture):
        wide = np.pad(picture, ((0, 0), (RADIUS, RADIUS)), mode="edge")
        total = wide[:, : picture.shape[1]] * WEIGHTS[0]
        for k, weight in enumerate(WEIGHTS[1:], 1):
            total += wide[:, k : k + picture.shape[1]] * weight
        return total

    return lambda: along(along(picture).T).T


@WORK.version("drjit")
def drjit(picture):
    import drjit as dr
    from drjit.llvm import Float, Int32

    size = len(picture)
    row, column = (Int32(a.ravel().astype(np.int32)) for a in np.mgrid[:size, :size])

    def along(texels, down, across):
        total = Float(0)
        for k, weight in enumerate(WEIGHTS, -RADIUS):
            y, x = dr.clip(row + k * down, 0, size - 1), dr.clip(column + k * across, 0, size - 1)
            total = dr.fma(dr.gather(Float, texels, y * size + x), float(weight), total)
        return total

    def run():
        between = along(Float(picture.ravel()), 0, 1)
        dr.eval(between)
        return np.asarray(along(between, 1, 0)).reshape(size, size)

    return run


@WORK.version("taichi")
def taichi(picture):
    import taichi as ti

    image = ti.types.ndarray(dtype=ti.f32, ndim=2)
    size = len(picture)

    @ti.kernel
    def kernel(texels: image, between: image, out: image):
        for i, j in between:
            total = 0.0
            for k in ti.static(range(2 * RADIUS + 1)):
                total += texels[i, ti.math.clamp(j + k - RADIUS, 0, size - 1)] * float(WEIGHTS[k])
            between[i, j] = total
        for i, j in out:
            total = 0.0
            for k in ti.static(range(2 * RADIUS + 1)):
                total += between[ti.math.clamp(i + k - RADIUS, 0, size - 1), j] * float(WEIGHTS[k])
            out[i, j] = total

    def run():
        between, out = np.empty_like(picture), np.empty_like(picture)
        kernel(picture, between, out)
        return out

    return run


@WORK.version("warp")
def warp(picture):
    import warp as wp

    weights = wp.array(WEIGHTS, dtype=float)
    size = len(picture)

    @wp.kernel
    def kernel(
        texels: wp.array2d(dtype=float),
        weights: wp.array(dtype=float),
        down: int,
        across: int,
        out: wp.array2d(dtype=float),
    ):
        i, j = wp.tid()
        total = wp.float32(0.0)
        for k in range(17):
            row = wp.clamp(i + (k - 8) * down, 0, texels.shape[0] - 1)
            column = wp.clamp(j + (k - 8) * across, 0, texels.shape[1] - 1)
            total += weights[k] * texels[row, column]
        out[i, j] = total

    def run():
        texels = wp.array(picture, dtype=float, copy=False)
        between, out = (wp.empty((size, size), dtype=float) for _ in range(2))
        wp.launch(kernel, (size, size), [texels, weights, 0, 1], [between])
        wp.launch(kernel, (size, size), [between, weights, 1, 0], [out])
        return out.numpy()

    return run


@WORK.version("numba")
def numba(picture):
    from numba import njit, prange

    @njit(parallel=True, fastmath=True)
    def along(texels, down, across):
        height, width = texels.shape
        out = np.empty((height, width), np.float32)
        for i in prange(height):
            for j in range(width):
                total = np.float32(0)
                for k in range(2 * RADIUS + 1):
                    y = min(max(i + (k - RADIUS) * down, 0), height - 1)
                    x = min(max(j + (k - RADIUS) * across, 0), width - 1)
                    total += texels[y, x] * WEIGHTS[k]
                out[i, j] = total
        return out

    return lambda: along(along(picture, 0, 1), 1, 0)


@WORK.version("jax")
def jax(picture):
    import jax
    import jax.numpy as jnp

    def along(picture):
        wide = jnp.pad(picture, ((0, 0), (RADIUS, RADIUS)), mode="edge")
        return sum(weight * wide[:, k : k + picture.shape[1]] for k, weight in enumerate(WEIGHTS))

    kernel = jax.jit(lambda picture: along(along(picture).T).T)
    return lambda: np.asarray(kernel(picture))
