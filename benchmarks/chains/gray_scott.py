"""Reaction and diffusion by Gray and Scott: 500 steps of two concentrations on a grid.

Every version takes concentrations (size, size, 2), float32, and gives them after `STEPS` steps; a neighbour beyond the
border is the nearest one. Source: Pearson, "Complex patterns in a simple system", Science 261 (1993).
"""

from typing import NamedTuple

import numpy as np

import shpy as sh
from benchmarks.work import Work

STEPS = 500
DU, DV, FEED, KILL = (float(np.float32(x)) for x in (0.16, 0.08, 0.035, 0.065))


def concentrations(size):
    start = np.zeros((size, size, 2), np.float32)
    start[..., 0] = 1
    middle = slice(size // 2 - size // 10, size // 2 + size // 10)
    start[middle, middle] = (0.5, 0.25)
    start += 0.01 * np.random.default_rng(1).random(start.shape, np.float32)
    return (start,)


class Concentrations(NamedTuple):
    """Both, as a step leaves them."""

    u: sh.Attrib1f
    v: sh.Attrib1f


def _work(name, note):
    return Work(
        name,
        "Gray and Scott's reaction, 500 steps at {size} x {size}",
        inputs=concentrations,
        size=256,
        quick=32,
        within=1e-2,
        note=f"One chain of ours, sh.repeat, {note}; all start with an array in the host's memory and end with one.",
        group="chains",
    )


WORK = _work("gray-scott", "over two streams of numbers")
VECTORS = _work("gray-scott-vectors", "over one stream of vectors of two")
WORKS = (WORK, VECTORS)


@sh.program
def react(u: sh.Table[sh.Attrib1f, 2], v: sh.Table[sh.Attrib1f, 2]) -> Concentrations:
    at = sh.grid_index(2)

    def spread(field, rate):
        around = (field[at - (0, 1)] + field[at + (0, 1)]) + (field[at - (1, 0)] + field[at + (1, 0)])
        return rate * (around - 4 * field[at])

    eaten = u[at] * v[at] * v[at]
    return Concentrations(
        u[at] + (spread(u, DU) + (FEED * (1 - u[at]) - eaten)),
        v[at] + (spread(v, DV) + (eaten - (FEED + KILL) * v[at])),
    )


@WORK.ours
def ours(compiled, start):
    chain = sh.repeat(compiled(react), STEPS)
    u, v = np.ascontiguousarray(start[..., 0]), np.ascontiguousarray(start[..., 1])

    def run():
        streams = chain.run(u=u, v=v).streams
        return np.stack([streams["u"].numpy(), streams["v"].numpy()], axis=-1)

    return run


@sh.program
def react_both(w: sh.Table[sh.Attrib2f, 2]) -> sh.Attrib2f:
    """Step both concentrations by the same arithmetic as `react`, so that the bits are the same."""
    at = sh.grid_index(2)
    around = (w[at - (0, 1)] + w[at + (0, 1)]) + (w[at - (1, 0)] + w[at + (1, 0)])
    u, v = w[at]
    eaten = u * v * v
    change = sh.Attrib2f(FEED * (1 - u) - eaten, eaten - (FEED + KILL) * v)
    return w[at] + ((DU, DV) * (around - 4 * w[at]) + change)


@VECTORS.ours
def both(compiled, start):
    chain = sh.repeat(compiled(react_both), STEPS)
    return lambda: chain.run(w=start).streams["w"].numpy()


@WORK.version("masks")
def masks(start):
    """Slices of two arrays with a border, in place."""
    n = len(start)
    du, dv, feed, kill = map(np.float32, (DU, DV, FEED, KILL))
    four, one = np.float32(4), np.float32(1)
    fields = [np.empty((n + 2, n + 2), np.float32) for _ in range(2)]
    spread = [np.empty((n, n), np.float32) for _ in range(2)]
    scratch = [np.empty((n, n), np.float32) for _ in range(2)]

    def run():
        eaten, change = scratch
        for field, values in zip(fields, np.moveaxis(start, -1, 0), strict=True):
            field[1:-1, 1:-1] = values
        u, v = (field[1:-1, 1:-1] for field in fields)
        for _ in range(STEPS):
            for field, out, rate in zip(fields, spread, (du, dv), strict=True):
                field[0], field[-1] = field[1], field[-2]
                field[:, 0], field[:, -1] = field[:, 1], field[:, -2]
                np.add(field[1:-1, :-2], field[1:-1, 2:], out=out)
                out += field[:-2, 1:-1]
                out += field[2:, 1:-1]
                np.multiply(field[1:-1, 1:-1], four, out=change)
                out -= change
                out *= rate
            np.multiply(v, v, out=eaten)
            eaten *= u
            np.subtract(one, u, out=change)
            change *= feed
            change -= eaten
            spread[0] += change
            np.multiply(v, feed + kill, out=change)
            np.subtract(eaten, change, out=change)
            spread[1] += change
            u += spread[0]
            v += spread[1]
        return np.stack([u, v], axis=-1)

    return run


@WORK.version("taichi")
def taichi(start):
    import taichi as ti

    n = len(start)
    a, b = (ti.Vector.field(2, ti.f32, shape=(n, n)) for _ in range(2))

    @ti.kernel
    def step(old: ti.template(), new: ti.template()):
        for i, j in old:
            here = old[i, j]
            around = old[i, ti.max(j - 1, 0)] + old[i, ti.min(j + 1, n - 1)]
            around += old[ti.max(i - 1, 0), j] + old[ti.min(i + 1, n - 1), j]
            spread = ti.Vector([DU, DV]) * (around - 4 * here)
            eaten = here.x * here.y * here.y
            gained = FEED * (1 - here.x) - eaten
            lost = eaten - (FEED + KILL) * here.y
            new[i, j] = here + spread + ti.Vector([gained, lost])

    def run():
        a.from_numpy(start)
        for _ in range(STEPS // 2):
            step(a, b)
            step(b, a)
        return a.to_numpy()

    return run


@WORK.version("numba")
def numba(start):
    from numba import njit, prange

    @njit(parallel=True, fastmath=True)
    def step(old, new):
        n = len(old)
        for i in prange(n):
            up, down = max(i - 1, 0), min(i + 1, n - 1)
            for j in range(n):
                left, right = max(j - 1, 0), min(j + 1, n - 1)
                u, v = old[i, j, 0], old[i, j, 1]
                around_u = old[i, left, 0] + old[i, right, 0] + old[up, j, 0] + old[down, j, 0]
                around_v = old[i, left, 1] + old[i, right, 1] + old[up, j, 1] + old[down, j, 1]
                eaten = u * v * v
                new[i, j, 0] = u + np.float32(DU) * (around_u - 4 * u) + np.float32(FEED) * (1 - u) - eaten
                new[i, j, 1] = v + np.float32(DV) * (around_v - 4 * v) + eaten - np.float32(FEED + KILL) * v

    def run():
        a, b = start.copy(), np.empty_like(start)
        for _ in range(STEPS):
            step(a, b)
            a, b = b, a
        return a

    return run


@WORK.version("jax")
def jax(start):
    import jax as j
    import jax.numpy as jnp

    @j.jit
    def all_steps(grid):
        def step(_, grid):
            edge = jnp.pad(grid, ((1, 1), (1, 1), (0, 0)), mode="edge")
            around = edge[1:-1, :-2] + edge[1:-1, 2:] + edge[:-2, 1:-1] + edge[2:, 1:-1]
            spread = jnp.array([DU, DV], jnp.float32) * (around - 4 * grid)
            u, v = grid[..., 0], grid[..., 1]
            eaten = u * v * v
            return grid + spread + jnp.stack([FEED * (1 - u) - eaten, eaten - (FEED + KILL) * v], axis=-1)

        return j.lax.fori_loop(0, STEPS, step, grid)

    return lambda: np.asarray(all_steps(start))


VECTORS.versions |= {name: version for name, version in WORK.versions.items() if name not in VECTORS.versions}
