"""Chains of kernels over data that stays on the device: Jacobi's iteration, and particles that are sorted in each step.

Every version starts with arrays in the host's memory and gives one after `STEPS` or `SORTS` steps.

- Jacobi's iteration for the Laplace equation: the mean of four neighbours on a grid, where a neighbour beyond the
  border is the nearest element. They are added in one order, that of `relax`, which a compiler may change.
- Particles that leave crowded cells: each step brings positions and velocities (n, 2), int32, into the order of their
  cells, those of a cell in the order that they had; counts the particles of each cell; and changes each velocity by
  how many more there are in the cell to the left than in that to the right, at most by 8, and likewise up and down.
  All arithmetic is of ints, so every version gives the same numbers in the same order.
"""

import numpy as np

import shpy as sh
from benchmarks.opencl import Device
from benchmarks.work import Work

STEPS, SORTS = 500, 50
SIDE, SHIFT = 64, 14
"""Cells along each axis; a cell is 1 << SHIFT wide."""
CELLS, BOARD = SIDE * SIDE, SIDE << SHIFT
MOST = 8
"""The largest change of a velocity in a step along each axis."""
CHUNKS = 8
"""Parts of the particles that threads count and move at the same time, where the sort is written by hand."""


def temperatures(size):
    return (np.random.default_rng(1).random((size, size), np.float32),)


def swarm(size):
    rng = np.random.default_rng(1)
    return rng.integers(0, BOARD, (size, 2), np.int32), rng.integers(-1000, 1001, (size, 2), np.int32)


JACOBI = Work(
    "jacobi",
    "Jacobi's iteration, 500 steps at {size} x {size}",
    inputs=temperatures,
    size=1024,
    quick=32,
    within=1e-5,
    note="One chain of ours, sh.repeat; all start with an array in the host's memory and end with one.",
)
PARTICLES = Work(
    "particles",
    "{size} particles, sorted into cells and counted in each of 50 steps",
    inputs=swarm,
    size=1 << 16,
    quick=1 << 10,
    within=0,
    note=(
        "Ours takes sh.argsort, sh.gather and sh.histogram; numpy and JAX their stable argsort and bincount; numba and "
        "OpenCL C sort by counting, which is written by hand. All start with arrays in the host's memory and end with "
        "one."
    ),
)
WORKS = (JACOBI, PARTICLES)


@sh.program
def relax(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    i = sh.grid_index(2)
    return 0.25 * (u[i + (0, 1)] + u[i - (0, 1)] + u[i + (1, 0)] + u[i - (1, 0)])


@JACOBI.ours
def jacobi(compiled, start):
    chain = sh.repeat(compiled(relax), STEPS)
    return lambda: chain.run(u=start).streams["u"].numpy()


@JACOBI.version("masks")
def jacobi_by_numpy(start):
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


@JACOBI.version("numba")
def jacobi_by_numba(start):
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


@JACOBI.version("jax")
def jacobi_by_jax(start):
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


@PARTICLES.ours_on("opencl", "plain", "glsl", "numpy")
def particles(compiled, positions, velocities):
    """Start each step and read nothing; the cells are computed once a step, for the sort and the counts."""
    locate, advance = compiled(cell), compiled(move)

    def run():
        bodies = sh.Stream({"at": positions, "speed": velocities}, Particle, getattr(advance, "backend", None))
        for _ in range(SORTS):
            cells = locate(bodies)
            counts = sh.histogram(cells, CELLS)
            bodies = advance(sh.gather(bodies, sh.argsort(cells, below=CELLS)), sh.Table(counts))
        return bodies.numpy().at

    return run


@PARTICLES.version("masks")
def particles_by_numpy(positions, velocities):
    def run():
        at, speed = positions, velocities
        for _ in range(SORTS):
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


@PARTICLES.version("numba")
def particles_by_numba(positions, velocities):
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
        for _ in range(SORTS):
            step(*a, *b, own, counts)
            a, b = b, a
        return a[0]

    return run


COUNTING = """
#define COUNT {count}
#define PARTS {parts}
#define CELLS {cells}
#define SIDE {side}
#define SHIFT {shift}
#define MOST {most}
#define PUSH(before, after) clamp(counts[before] - counts[after], -MOST, MOST)

__kernel void tally(__global const int2 *at, __global int *own) {{
    int part = get_global_id(0), first = part * (COUNT / PARTS);
    own += part * CELLS;
    for (int k = 0; k < CELLS; ++k) own[k] = 0;
    for (int i = first; i < first + COUNT / PARTS; ++i) ++own[(at[i].y >> SHIFT) * SIDE + (at[i].x >> SHIFT)];
}}

__kernel void sums(__global int *own, __global int *counts) {{
    int start = 0;
    for (int k = 0; k < CELLS; ++k) {{
        int first = start;
        for (int part = 0; part < PARTS; ++part) {{
            int here = own[part * CELLS + k];
            own[part * CELLS + k] = start;
            start += here;
        }}
        counts[k] = start - first;
    }}
}}

__kernel void move(__global const int2 *at, __global const int2 *speed, __global int *own, __global const int *counts,
                   __global int2 *new_at, __global int2 *new_speed) {{
    int part = get_global_id(0), first = part * (COUNT / PARTS);
    own += part * CELLS;
    for (int i = first; i < first + COUNT / PARTS; ++i) {{
        int x = at[i].x >> SHIFT, y = at[i].y >> SHIFT, to = own[y * SIDE + x]++;
        int across = PUSH(y * SIDE + ((x - 1) & (SIDE - 1)), y * SIDE + ((x + 1) & (SIDE - 1)));
        int down = PUSH(((y - 1) & (SIDE - 1)) * SIDE + x, ((y + 1) & (SIDE - 1)) * SIDE + x);
        new_speed[to] = speed[i] + (int2)(across, down);
        new_at[to] = (at[i] + new_speed[to]) & ((SIDE << SHIFT) - 1);
    }}
}}
"""


@PARTICLES.version("hand")
def particles_by_hand(positions, velocities):
    """Three launches a step; a work item counts and moves a quarter of the particles."""
    device, parts = Device.opened(), 4
    text = COUNTING.format(count=len(positions), parts=parts, cells=CELLS, side=SIDE, shift=SHIFT, most=MOST)
    own, counts = device.empty(4 * parts * CELLS), device.empty(4 * CELLS)
    old, new = ([device.empty(array.nbytes) for array in (positions, velocities)] for _ in range(2))
    sums = device.kernel(text, "sums", 1, 1, own, counts)
    turns = [
        (device.kernel(text, "tally", parts, 1, a[0], own), device.kernel(text, "move", parts, 1, *a, own, counts, *b))
        for a, b in ((old, new), (new, old))
    ]

    def run():
        for buffer, array in zip(old, (positions, velocities), strict=True):
            device.copy(buffer, array)
        for step in range(SORTS):
            tally, move = turns[step % 2]
            tally()
            sums()
            move()
        out = np.empty_like(positions)
        device.copy(out, old[0])
        return out

    return run


@PARTICLES.version("jax")
def particles_by_jax(positions, velocities):
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

        return j.lax.fori_loop(0, SORTS, step, (at, speed))[0]

    return lambda: np.asarray(all_steps(positions, velocities))
