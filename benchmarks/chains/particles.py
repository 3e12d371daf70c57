"""Particles that leave crowded cells: 50 steps, each of which sorts them into cells and counts those of each cell.

Every version takes positions and velocities (n, 2), int32, and gives the positions after `STEPS` steps, in the order of
the last sort. A step takes the cell of each particle, 64 x 64 of them on a board that wraps around, and

1. brings the particles into the order of their cells, those of a cell in the order that they had;
2. counts the particles of each cell;
3. changes each velocity by how many more there are in the cell to the left than in that to the right, at most by 8, and
   likewise up and down; then moves the particle.

All arithmetic is of ints, so every version gives the same numbers in the same order.
"""

import numpy as np

import shpy as sh
from benchmarks.chains.opencl import new_queue
from benchmarks.work import Work

STEPS = 50
SIDE, SHIFT = 64, 14
"""Cells along each axis; a cell is 1 << SHIFT wide."""
CELLS, BOARD = SIDE * SIDE, SIDE << SHIFT
MOST = 8
"""The largest change of a velocity in a step along each axis."""
CHUNKS = 8
"""Parts of the particles that threads count and move at the same time, where the sort is written by hand."""


def swarm(size):
    rng = np.random.default_rng(1)
    return rng.integers(0, BOARD, (size, 2), np.int32), rng.integers(-1000, 1001, (size, 2), np.int32)


WORK = Work(
    "particles",
    "{size} particles, sorted into cells and counted in each of 50 steps",
    inputs=swarm,
    size=1 << 16,
    quick=1 << 10,
    within=0,
    note=(
        "Ours takes sh.argsort, sh.gather and sh.histogram; numpy and JAX their stable argsort and bincount; Warp its "
        "radix sort. Taichi, numba and pyopencl sort by counting, which is written by hand. "
        "All start with arrays in the host's memory and end with one."
    ),
    group="chains",
)


@sh.struct
class Particle:
    """A particle: a sort moves its position and its velocity together."""

    at: sh.Attrib2i
    speed: sh.Attrib2i


@sh.program
def cell(p: Particle) -> sh.Attrib1i:
    square = p.at >> SHIFT
    return square.y * SIDE + square.x


@sh.program
def move(p: Particle, counts: sh.Table[sh.Attrib1i]) -> Particle:
    x, y = p.at.x >> SHIFT, p.at.y >> SHIFT

    def push(before, after):
        return sh.clamp(counts[before] - counts[after], -MOST, MOST)

    p.speed += sh.Attrib2i(
        push(y * SIDE + ((x - 1) & (SIDE - 1)), y * SIDE + ((x + 1) & (SIDE - 1))),
        push(((y - 1) & (SIDE - 1)) * SIDE + x, ((y + 1) & (SIDE - 1)) * SIDE + x),
    )
    p.at = (p.at + p.speed) & (BOARD - 1)
    return p


@WORK.ours_on("opencl", "glsl", "numpy")
def ours(compiled, positions, velocities):
    """Start each step and read nothing; the cells are computed once a step, for the sort and the counts."""
    locate, advance = compiled(cell), compiled(move)

    def run():
        particles = sh.Stream({"at": positions, "speed": velocities}, Particle, advance.backend)
        for _ in range(STEPS):
            cells = locate(particles)
            counts = sh.histogram(cells, CELLS)
            particles = advance(sh.gather(particles, sh.argsort(cells, below=CELLS)), sh.Table(counts))
        return particles.numpy().at

    return run


@WORK.version("masks")
def masks(positions, velocities):
    def run():
        at, speed = positions, velocities
        for _ in range(STEPS):
            cells = ((at[:, 1] >> SHIFT) * SIDE + (at[:, 0] >> SHIFT)).astype(np.uint16)
            order = np.argsort(cells, kind="stable")  # a radix sort, for ints of 16 bits
            at, speed, cells = at[order], speed[order], cells[order]
            counts = np.bincount(cells, minlength=CELLS).reshape(SIDE, SIDE)
            right = np.clip(np.roll(counts, 1, 1) - np.roll(counts, -1, 1), -MOST, MOST)
            down = np.clip(np.roll(counts, 1, 0) - np.roll(counts, -1, 0), -MOST, MOST)
            speed += np.stack([right, down], axis=-1).astype(np.int32).reshape(CELLS, 2)[cells]
            at += speed
            at &= BOARD - 1
        return at

    return run


@WORK.version("taichi")
def taichi(positions, velocities):
    """Each chunk of particles counts its own, so that the order within a cell stays; the cells are summed in turn."""
    import taichi as ti

    n = len(positions)
    own, counts, starts = ti.field(ti.i32, (CHUNKS, CELLS)), ti.field(ti.i32, CELLS), ti.field(ti.i32, CELLS)
    a, b = ([ti.Vector.field(2, ti.i32, n) for _ in range(2)] for _ in range(2))

    @ti.func
    def cell_of(at):
        return (at.y >> SHIFT) * SIDE + (at.x >> SHIFT)

    @ti.func
    def push(before, after):
        return ti.math.clamp(counts[before] - counts[after], -MOST, MOST)

    @ti.kernel
    def step(at: ti.template(), speed: ti.template(), new_at: ti.template(), new_speed: ti.template()):
        for chunk in range(CHUNKS):
            for k in range(CELLS):
                own[chunk, k] = 0
            for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
                own[chunk, cell_of(at[i])] += 1
        for k in range(CELLS):
            total = 0
            for chunk in range(CHUNKS):
                count = own[chunk, k]
                own[chunk, k] = total
                total += count
            counts[k] = total
        for _ in range(1):
            total = 0
            for k in range(CELLS):
                starts[k] = total
                total += counts[k]
        for chunk in range(CHUNKS):
            for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
                here = at[i]
                k, x, y = cell_of(here), here.x >> SHIFT, here.y >> SHIFT
                to = starts[k] + own[chunk, k]
                own[chunk, k] += 1
                across = push(y * SIDE + ((x - 1) & (SIDE - 1)), y * SIDE + ((x + 1) & (SIDE - 1)))
                down = push(((y - 1) & (SIDE - 1)) * SIDE + x, ((y + 1) & (SIDE - 1)) * SIDE + x)
                turned = speed[i] + ti.Vector([across, down])
                new_speed[to] = turned
                new_at[to] = (here + turned) & (BOARD - 1)

    def run():
        a[0].from_numpy(positions)
        a[1].from_numpy(velocities)
        for _ in range(STEPS // 2):
            step(*a, *b)
            step(*b, *a)
        return a[0].to_numpy()

    return run


@WORK.version("warp")
def warp(positions, velocities):
    import warp as wp

    n = len(positions)
    vec = wp.types.vector(2, wp.int32)
    side, shift, most, board = (wp.constant(k) for k in (SIDE, SHIFT, MOST, BOARD))

    @wp.kernel
    def locate(
        at: wp.array(dtype=vec), cells: wp.array(dtype=int), order: wp.array(dtype=int), counts: wp.array(dtype=int)
    ):
        i = wp.tid()
        cell = (at[i][1] >> shift) * side + (at[i][0] >> shift)
        cells[i] = cell
        order[i] = i
        wp.atomic_add(counts, cell, 1)

    @wp.kernel
    def move(
        at: wp.array(dtype=vec),
        speed: wp.array(dtype=vec),
        order: wp.array(dtype=int),
        counts: wp.array(dtype=int),
        new_at: wp.array(dtype=vec),
        new_speed: wp.array(dtype=vec),
    ):
        i = wp.tid()
        here = at[order[i]]
        x, y = here[0] >> shift, here[1] >> shift
        left, right = y * side + ((x - 1) & (side - 1)), y * side + ((x + 1) & (side - 1))
        up, down = ((y - 1) & (side - 1)) * side + x, ((y + 1) & (side - 1)) * side + x
        push = vec(
            wp.clamp(counts[left] - counts[right], -most, most), wp.clamp(counts[up] - counts[down], -most, most)
        )
        turned = speed[order[i]] + push
        new_speed[i] = turned
        new_at[i] = vec((here[0] + turned[0]) & (board - 1), (here[1] + turned[1]) & (board - 1))

    # The sort wants twice as much room as there are keys.
    cells, order = (wp.empty(2 * n, dtype=int, device="cpu") for _ in range(2))
    counts = wp.empty(CELLS, dtype=int, device="cpu")

    def run():
        a = [wp.array(array, dtype=vec, device="cpu") for array in (positions, velocities)]  # copies
        b = [wp.empty(n, dtype=vec, device="cpu") for _ in range(2)]
        for _ in range(STEPS):
            counts.zero_()
            wp.launch(locate, n, [a[0]], [cells, order, counts], device="cpu")
            wp.utils.radix_sort_pairs(cells, order, n)
            wp.launch(move, n, [*a, order, counts], b, device="cpu")
            a, b = b, a
        return a[0].numpy()

    return run


@WORK.version("numba")
def numba(positions, velocities):
    """Each chunk of particles counts its own, so that the order within a cell stays; the cells are summed in turn."""
    from numba import njit, prange

    @njit
    def push(counts, before, after):
        return min(max(counts[before] - counts[after], -MOST), MOST)

    @njit(parallel=True)
    def step(at, speed, new_at, new_speed, own, counts):
        n = len(at)
        for chunk in prange(CHUNKS):
            own[chunk] = 0
            for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
                own[chunk, (at[i, 1] >> SHIFT) * SIDE + (at[i, 0] >> SHIFT)] += 1
        start = 0
        for k in range(CELLS):
            first = start
            for chunk in range(CHUNKS):
                count = own[chunk, k]
                own[chunk, k] = start
                start += count
            counts[k] = start - first
        for chunk in prange(CHUNKS):
            for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
                x, y = at[i, 0] >> SHIFT, at[i, 1] >> SHIFT
                to = own[chunk, y * SIDE + x]
                own[chunk, y * SIDE + x] = to + 1
                across = push(counts, y * SIDE + ((x - 1) & (SIDE - 1)), y * SIDE + ((x + 1) & (SIDE - 1)))
                down = push(counts, ((y - 1) & (SIDE - 1)) * SIDE + x, ((y + 1) & (SIDE - 1)) * SIDE + x)
                new_speed[to, 0], new_speed[to, 1] = speed[i, 0] + across, speed[i, 1] + down
                new_at[to, 0] = (at[i, 0] + new_speed[to, 0]) & (BOARD - 1)
                new_at[to, 1] = (at[i, 1] + new_speed[to, 1]) & (BOARD - 1)

    own, counts = np.empty((CHUNKS, CELLS), np.int32), np.empty(CELLS, np.int32)

    def run():
        a, b = (positions.copy(), velocities.copy()), (np.empty_like(positions), np.empty_like(velocities))
        for _ in range(STEPS):
            step(*a, *b, own, counts)
            a, b = b, a
        return a[0]

    return run


@WORK.version("jax")
def jax(positions, velocities):
    import jax as j
    import jax.numpy as jnp

    @j.jit
    def all_steps(at, speed):
        def step(_, state):
            at, speed = state
            cells = (at[:, 1] >> SHIFT) * SIDE + (at[:, 0] >> SHIFT)
            order = jnp.argsort(cells, stable=True)
            at, speed, cells = at[order], speed[order], cells[order]
            counts = jnp.bincount(cells, length=CELLS).reshape(SIDE, SIDE)
            right = jnp.clip(jnp.roll(counts, 1, 1) - jnp.roll(counts, -1, 1), -MOST, MOST)
            down = jnp.clip(jnp.roll(counts, 1, 0) - jnp.roll(counts, -1, 0), -MOST, MOST)
            speed += jnp.stack([right, down], axis=-1).reshape(CELLS, 2)[cells]
            return (at + speed) & (BOARD - 1), speed

        return j.lax.fori_loop(0, STEPS, step, (at, speed))[0]

    return lambda: np.asarray(all_steps(positions, velocities))


BY_HAND = """\
int cell(int2 at) {
    return (at.y >> SHIFT) * SIDE + (at.x >> SHIFT);
}

// Each chunk counts its own particles, so that the order within a cell stays.
__kernel void tally(__global const int2 *at, int n, __global int *own) {
    long chunk = get_global_id(0);
    own += chunk * CELLS;
    for (int k = 0; k < CELLS; ++k)
        own[k] = 0;
    for (int i = chunk * n / CHUNKS; i < (chunk + 1) * n / CHUNKS; ++i)
        ++own[cell(at[i])];
}

// Where the particles of each chunk begin within a cell, and how many a cell has.
__kernel void add_chunks(__global int *own, __global int *counts) {
    int k = get_global_id(0), total = 0;
    for (int chunk = 0; chunk < CHUNKS; ++chunk) {
        int count = own[chunk * CELLS + k];
        own[chunk * CELLS + k] = total;
        total += count;
    }
    counts[k] = total;
}

__kernel void add_cells(__global const int *counts, __global int *starts) {
    int total = 0;
    for (int k = 0; k < CELLS; ++k) {
        starts[k] = total;
        total += counts[k];
    }
}

int push(__global const int *counts, int before, int after) {
    return clamp(counts[before] - counts[after], -MOST, MOST);
}

__kernel void move(__global const int2 *at, __global const int2 *speed, int n, __global int *own,
                   __global const int *counts, __global const int *starts, __global int2 *new_at,
                   __global int2 *new_speed) {
    long chunk = get_global_id(0);
    own += chunk * CELLS;
    for (int i = chunk * n / CHUNKS; i < (chunk + 1) * n / CHUNKS; ++i) {
        int2 here = at[i], square = here >> SHIFT;
        int2 before = (square - 1) & (SIDE - 1), after = (square + 1) & (SIDE - 1);
        int k = cell(here), to = starts[k] + own[k]++;
        int across = push(counts, square.y * SIDE + before.x, square.y * SIDE + after.x);
        int down = push(counts, before.y * SIDE + square.x, after.y * SIDE + square.x);
        int2 turned = speed[i] + (int2)(across, down);
        new_speed[to] = turned;
        new_at[to] = (here + turned) & (SIDE * (1 << SHIFT) - 1);
    }
}
"""


@WORK.version("pyopencl")
def pyopencl(positions, velocities):
    """Buffers stay on the device; four kernels a step."""
    import pyopencl as cl

    queue, n = new_queue(), np.int32(len(positions))
    named = {"SIDE": SIDE, "SHIFT": SHIFT, "CELLS": CELLS, "CHUNKS": CHUNKS, "MOST": MOST}
    program = cl.Program(queue.context, BY_HAND).build([f"-D{name}={value}" for name, value in named.items()])
    tally, add_chunks, add_cells, move = program.tally, program.add_chunks, program.add_cells, program.move
    sizes = (4 * CHUNKS * CELLS, 4 * CELLS, 4 * CELLS, *[positions.nbytes] * 4)
    own, counts, starts, *rest = (cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, size) for size in sizes)

    def run():
        a, b, answer = rest[:2], rest[2:], np.empty_like(positions)
        for buffer, array in zip(a, (positions, velocities), strict=True):
            cl.enqueue_copy(queue, buffer, array)
        for _ in range(STEPS):
            tally(queue, (CHUNKS,), (1,), a[0], n, own)
            add_chunks(queue, (CELLS,), None, own, counts)
            add_cells(queue, (1,), (1,), counts, starts)
            move(queue, (CHUNKS,), (1,), *a, n, own, counts, starts, *b)
            a, b = b, a
        cl.enqueue_copy(queue, answer, a[0])
        return answer

    return run
