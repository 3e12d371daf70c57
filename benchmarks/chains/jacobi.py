"""Jacobi's iteration for the Laplace equation: 500 times the mean of four neighbours on a grid.

Every version takes temperatures (size, size), float32, and gives them after `STEPS` steps; a neighbour beyond the
border is the nearest element, so no heat flows out. The neighbours are added in one order, that of `relax`, which a
compiler may change.
"""

import numpy as np

import shpy as sh
from benchmarks.chaining import relax
from benchmarks.chains.opencl import run_by_hand
from benchmarks.work import Work

STEPS = 500


def temperatures(size):
    return (np.random.default_rng(1).random((size, size), np.float32),)


WORK = Work(
    "jacobi",
    "Jacobi's iteration, 500 steps at {size} x {size}",
    inputs=temperatures,
    size=1024,
    quick=32,
    within=1e-5,
    note="One chain of ours, sh.repeat; all start with an array in the host's memory and end with one.",
    group="chains",
)


@WORK.ours
def ours(compiled, start):
    chain = sh.repeat(compiled(relax), STEPS)
    return lambda: chain.run(u=start).streams["u"].numpy()


@WORK.version("masks")
def masks(start):
    """Slices of an array with a border, in place."""
    n = len(start)
    field, around = np.empty((n + 2, n + 2), np.float32), np.empty((n, n), np.float32)
    inside = field[1:-1, 1:-1]

    def run():
        inside[:] = start
        for _ in range(STEPS):
            field[0], field[-1] = field[1], field[-2]
            field[:, 0], field[:, -1] = field[:, 1], field[:, -2]
            np.add(field[1:-1, 2:], field[1:-1, :-2], out=around)
            np.add(around, field[2:, 1:-1], out=around)
            np.add(around, field[:-2, 1:-1], out=around)
            np.multiply(around, np.float32(0.25), out=inside)
        return inside.copy()

    return run


@WORK.version("taichi")
def taichi(start):
    import taichi as ti

    n = len(start)
    a, b = (ti.field(ti.f32, shape=(n, n)) for _ in range(2))

    @ti.kernel
    def step(old: ti.template(), new: ti.template()):
        for i, j in old:
            around = old[i, ti.min(j + 1, n - 1)] + old[i, ti.max(j - 1, 0)]
            new[i, j] = 0.25 * (around + old[ti.min(i + 1, n - 1), j] + old[ti.max(i - 1, 0), j])

    def run():
        a.from_numpy(start)
        for _ in range(STEPS // 2):
            step(a, b)
            step(b, a)
        return a.to_numpy()

    return run


@WORK.version("warp")
def warp(start):
    import warp as wp

    @wp.kernel
    def step(old: wp.array2d(dtype=float), out: wp.array2d(dtype=float)):
        i, j = wp.tid()
        last = old.shape[0] - 1
        around = old[i, wp.min(j + 1, last)] + old[i, wp.max(j - 1, 0)]
        out[i, j] = 0.25 * (around + old[wp.min(i + 1, last), j] + old[wp.max(i - 1, 0), j])

    def run():
        a = wp.array(start, dtype=float, device="cpu")  # a copy
        b = wp.empty(start.shape, dtype=float, device="cpu")
        for _ in range(STEPS):
            wp.launch(step, start.shape, [a], [b], device="cpu")
            a, b = b, a
        return a.numpy()

    return run


@WORK.version("numba")
def numba(start):
    """Rows with a border on both sides, so that the loop over a row has no branch."""
    from numba import njit, prange

    @njit(parallel=True, fastmath=True)
    def step(old, new):
        n = len(old)
        for i in prange(n):
            left, right, out = old[i, :-2], old[i, 2:], new[i, 1:-1]
            above, below = old[max(i - 1, 0), 1:-1], old[min(i + 1, n - 1), 1:-1]
            for j in range(n):
                out[j] = np.float32(0.25) * (right[j] + left[j] + below[j] + above[j])
            new[i, 0], new[i, n + 1] = new[i, 1], new[i, n]

    def run():
        a = np.pad(start, ((0, 0), (1, 1)), mode="edge")
        b = np.empty_like(a)
        for _ in range(STEPS):
            step(a, b)
            a, b = b, a
        return a[:, 1:-1].copy()

    return run


@WORK.version("jax")
def jax(start):
    import jax as j
    import jax.numpy as jnp

    def bordered(field):
        return jnp.pad(field, 1, mode="edge")

    @j.jit
    def all_steps(field):
        def step(_, edge):
            return bordered(0.25 * (edge[1:-1, 2:] + edge[1:-1, :-2] + edge[2:, 1:-1] + edge[:-2, 1:-1]))

        return j.lax.fori_loop(0, STEPS, step, bordered(field))[1:-1, 1:-1]

    return lambda: np.asarray(all_steps(start))


BY_HAND = """\
// Eight columns of a row, of which each has a border on both sides; the last eight of a row may overlap those before.
__kernel void relax(__global const float *restrict old, __global float *restrict new) {
    int j = min(8 * (int)get_global_id(0), N - 8), i = get_global_id(1);
    __global const float *row = old + i * (N + 2) + j;
    __global const float *above = old + max(i - 1, 0) * (N + 2) + j, *below = old + min(i + 1, N - 1) * (N + 2) + j;
    __global float *out = new + i * (N + 2);
    float8 around = vload8(0, row + 2) + vload8(0, row) + vload8(0, below + 1) + vload8(0, above + 1);
    vstore8(0.25f * around, 0, out + j + 1);
    if (j == 0)
        out[0] = out[1];
    if (j == N - 8)
        out[N + 1] = out[N];
}
"""


@WORK.version("pyopencl")
def pyopencl(start):
    """Two buffers that stay on the device, and one enqueued kernel for each step."""
    return run_by_hand(BY_HAND, "relax", start, "edge", STEPS)
