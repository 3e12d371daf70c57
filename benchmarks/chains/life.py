"""Conway's game of life: 200 generations on a board that wraps around.

Every version takes cells (size, size) of zeros and ones, int32, and gives them after `GENERATIONS` generations. All
hold a cell in an int32, which is the smallest whole number that ours has.
"""

import numpy as np

import shpy as sh
from benchmarks.chains.opencl import run_by_hand
from benchmarks.work import Work

GENERATIONS = 200


def soup(size):
    return (np.random.default_rng(1).integers(0, 2, (size, size), np.int32),)


WORK = Work(
    "life",
    "Conway's game of life, 200 generations at {size} x {size}",
    inputs=soup,
    size=1024,
    quick=32,
    within=0,
    note=(
        "One chain of ours, sh.repeat; all start with an array in the host's memory and end with one, "
        "and all hold a cell in an int32."
    ),
    group="chains",
)


@sh.program
def generation(cells: sh.Table[sh.Attrib1i, 2]) -> sh.Attrib1i:
    here = sh.grid_index(2)
    around = sh.Attrib1i(0)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if down or right:
                around += cells[(here + (down, right)) % sh.grid_shape(2)]
    return sh.cond((around == 3) | ((around == 2) & (cells[here] == 1)), 1, 0)


@WORK.ours
def ours(compiled, start):
    chain = sh.repeat(compiled(generation), GENERATIONS)
    return lambda: chain.run(cells=start).streams["cells"].numpy()


@WORK.version("masks")
def masks(start):
    """Step the board by slices of an array with a border, in place: sums of columns, then sums of rows of these."""
    n = len(start)
    field, down = np.empty((n + 2, n + 2), np.int32), np.empty((n, n + 2), np.int32)
    around, three, four = np.empty((n, n), np.int32), np.empty((n, n), bool), np.empty((n, n), bool)
    cells = field[1:-1, 1:-1]

    def run():
        cells[:] = start
        for _ in range(GENERATIONS):
            field[0], field[-1] = field[-2], field[1]
            field[:, 0], field[:, -1] = field[:, -2], field[:, 1]
            np.add(field[:-2], field[1:-1], out=down)
            np.add(down, field[2:], out=down)
            np.add(down[:, :-2], down[:, 1:-1], out=around)
            np.add(around, down[:, 2:], out=around)
            # The sum has the cell itself: three are a birth or a living cell with two neighbours, four need the cell.
            np.equal(around, 3, out=three)
            np.equal(around, 4, out=four)
            np.multiply(cells, four, out=cells)
            np.bitwise_or(cells, three, out=cells)
        return cells.copy()

    return run


@WORK.version("taichi")
def taichi(start):
    import taichi as ti

    n = len(start)
    a, b = (ti.field(ti.i32, shape=(n, n)) for _ in range(2))

    @ti.kernel
    def step(old: ti.template(), new: ti.template()):
        for i, j in old:
            up, down = ti.select(i > 0, i, n) - 1, ti.select(i < n - 1, i + 1, 0)
            left, right = ti.select(j > 0, j, n) - 1, ti.select(j < n - 1, j + 1, 0)
            around = old[up, left] + old[up, j] + old[up, right] + old[i, left] + old[i, right]
            around += old[down, left] + old[down, j] + old[down, right]
            new[i, j] = ti.select((around == 3) | ((around == 2) & (old[i, j] == 1)), 1, 0)

    def run():
        a.from_numpy(start)
        for _ in range(GENERATIONS // 2):
            step(a, b)
            step(b, a)
        return a.to_numpy()

    return run


@WORK.version("warp")
def warp(start):
    import warp as wp

    @wp.kernel
    def step(old: wp.array2d(dtype=int), out: wp.array2d(dtype=int)):
        i, j = wp.tid()
        n = old.shape[0]
        up = wp.where(i > 0, i, n) - 1
        down = wp.where(i < n - 1, i + 1, 0)
        left = wp.where(j > 0, j, n) - 1
        right = wp.where(j < n - 1, j + 1, 0)
        around = old[up, left] + old[up, j] + old[up, right] + old[i, left] + old[i, right]
        around += old[down, left] + old[down, j] + old[down, right]
        out[i, j] = wp.where(around == 3 or (around == 2 and old[i, j] == 1), 1, 0)

    def run():
        a = wp.array(start, dtype=int, device="cpu")  # a copy
        b = wp.empty(start.shape, dtype=int, device="cpu")
        for _ in range(GENERATIONS):
            wp.launch(step, start.shape, [a], [b], device="cpu")
            a, b = b, a
        return a.numpy()

    return run


@WORK.version("numba")
def numba(start):
    """Step the board row by row, with a border on both sides, so that the loop over a row has no branch."""
    from numba import njit, prange

    @njit(parallel=True)
    def step(old, new):
        n = len(old)
        for i in prange(n):
            above, row, below, out = old[(i + n - 1) % n], old[i], old[(i + 1) % n], new[i]
            for j in range(1, n + 1):
                beside = above[j - 1] + above[j + 1] + row[j - 1] + row[j + 1] + below[j - 1] + below[j + 1]
                around = beside + above[j] + below[j]
                out[j] = (around == 3) | ((around == 2) & (row[j] == 1))
            # numba 0.68 reads `out[1]` as it was before the loop; what is read from `new` is right.
            new[i, 0], new[i, n + 1] = new[i, n], new[i, 1]

    def run():
        a = np.pad(start, ((0, 0), (1, 1)), mode="wrap")
        b = np.empty_like(a)
        for _ in range(GENERATIONS):
            step(a, b)
            a, b = b, a
        return a[:, 1:-1].copy()

    return run


@WORK.version("jax")
def jax(start):
    import jax as j
    import jax.numpy as jnp

    def bordered(cells):
        return jnp.pad(cells, 1, mode="wrap")

    @j.jit
    def all_generations(cells):
        def step(_, wide):
            down = wide[:-2] + wide[1:-1] + wide[2:]
            around = down[:, :-2] + down[:, 1:-1] + down[:, 2:]  # with the cell itself
            return bordered(jnp.where((around == 3) | ((around == 4) & (wide[1:-1, 1:-1] == 1)), 1, 0))

        return j.lax.fori_loop(0, GENERATIONS, step, bordered(cells))[1:-1, 1:-1]

    return lambda: np.asarray(all_generations(start))


BY_HAND = """\
// Eight columns of a row, of which each has a border on both sides; the last eight of a row may overlap those before.
__kernel void generation(__global const int *restrict old, __global int *restrict new) {
    int j = min(8 * (int)get_global_id(0), N - 8), i = get_global_id(1);
    __global const int *row = old + i * (N + 2) + j;
    __global const int *above = old + (i + N - 1) % N * (N + 2) + j, *below = old + (i + 1) % N * (N + 2) + j;
    __global int *out = new + i * (N + 2);
    int8 around = vload8(0, above) + vload8(0, above + 1) + vload8(0, above + 2) + vload8(0, row) + vload8(0, row + 2);
    around += vload8(0, below) + vload8(0, below + 1) + vload8(0, below + 2);
    vstore8(-((around == 3) | ((around == 2) & (vload8(0, row + 1) == 1))), 0, out + j + 1);
    if (j == 0)
        out[N + 1] = out[1];
    if (j == N - 8)
        out[0] = out[N];
}
"""


@WORK.version("pyopencl")
def pyopencl(start):
    """Step the board with two buffers that stay on the device, and enqueue one kernel per generation."""
    return run_by_hand(BY_HAND, "generation", start, "wrap", GENERATIONS)
