"""Layered depth cubes beside the BVH and the grid: what they take to build, and incoherent rays through them.

    print(STUDIES["layered"](mesh, quick=False).markdown())

The rays are those of `rays.secondary_rays`. Ours go through an `Intersector`, from arrays of the host to results; only
the hit test "triangle" finds the exact hits. Mitsuba has the rays as arrays of its own already. The number of wrong
hits is part of the table, since a cube trades them for time. `raytracer study layered` measures more of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks import peers, rays
from benchmarks.studies import Table, backend, in_turns, rate
from raytracer import Intersector, LayeredCube, Mesh
from raytracer.accel.choice import build
from raytracer.meshes.shapes import knot

HEAD = (
    *("accelerator", "triangles", "build s", "build CPU by BVH's"),
    *("MiB", "million rays/s", "wrong hits", "other triangles"),
)
BUILDS = 5
WRONG = 1e-3
"""The largest error of a correct distance, as a part of the mesh's largest side."""


def layered(mesh: Mesh, quick: bool) -> Table:
    """Cubes of 1024 x 1024 texels for the mesh, and for a knot of 300,000 triangles."""
    resolution, size = (16, 16) if quick else (1024, 512)
    meshes = [mesh] if quick else [mesh, knot(segments=1500, sides=100)]
    with_mitsuba = not quick and not peers.available(["mitsuba"])[1]
    rows = []
    for one in meshes:
        rows += _rows(one, resolution, size, with_mitsuba)
        rays.forget()
    note = (
        f"The fastest build in seconds; its CPU work of all threads in times of the BVH's, median (quartiles) of "
        f"{BUILDS} builds in turns; million rays a second, closest hit, for rays from the pixels "
        f"of {size} x {size} that leave surfaces in random directions; hits that are wrong, and those with another "
        f"triangle's number. Cubes have {resolution} x {resolution} texels "
        f"in each of three images. On {backend()}; the BVH and the grid are built in numpy."
    )
    return Table("layered", note, HEAD, rows)


def _work(makers: Sequence[Callable[[], Any]]) -> list[str]:
    """Return the CPU seconds of each build, in times of the first one's in the same round: median and quartiles."""
    rounds = []
    for _ in range(BUILDS):
        busy = [time.process_time()]
        for make in makers:
            make()
            busy.append(time.process_time())
        rounds.append(np.diff(busy) / (busy[1] - busy[0]))
    low, middle, high = np.quantile(rounds, [0.25, 0.5, 0.75], axis=0)
    return [f"{m:.2f} ({a:.2f} to {b:.2f})" for a, m, b in zip(low, middle, high, strict=True)]


def _rows(mesh: Mesh, resolution: int, size: int, with_mitsuba: bool) -> list[list[str]]:
    given = rays.secondary_rays(mesh, size)
    cube = partial(LayeredCube.of, mesh, resolution, backend=backend())
    makers = {name: partial(build, name, mesh.corners) for name in ("bvh", "grid")}
    makers |= {f'cube, "{hit}"': partial(cube, hit=hit) for hit in ("plane", "triangle")}
    made = {name: make() for name, make in makers.items()}  # kernels are compiled
    seconds = in_turns(list(makers.values()), 2)
    shoot = {name: Intersector(mesh, s if isinstance(s, LayeredCube) else name, backend()) for name, s in made.items()}
    runs = [partial(one.intersect, *given) for one in shoot.values()]
    work = _work(list(makers.values()))
    first = runs[0]()
    exact = first.t
    found = [run() for run in runs]
    wrong = [_wrong(one.t, exact, mesh) for one in found]
    others = [_others(one.triangle, first.triangle) for one in found]
    if with_mitsuba:
        peers.start("mitsuba")
        runs.append(rays.mitsuba(*given, mesh=mesh, any_hit=False))
    rates = [rate(len(exact), s) for s in in_turns(runs)]
    sizes = [s.nbytes if isinstance(s, LayeredCube) else s.bytes for s in made.values()]
    count = f"{len(mesh):,}"
    rows = [
        [name, count, f"{s:.2f}", c, f"{n / 2**20:.1f}", r, f"{w:.2%}", f"{o:.2%}"]
        for name, s, c, n, r, w, o in zip(made, seconds, work, sizes, rates, wrong, others, strict=False)
    ]
    return rows + [["Mitsuba", count, "", "", "", r, "", ""] for r in rates[len(made) :]]


def _others(found: np.ndarray, exact: np.ndarray) -> float:
    """Return the share of the hits of both whose triangles differ."""
    both = (found >= 0) & (exact >= 0)
    return float(np.mean(found[both] != exact[both]))


def _wrong(found: np.ndarray, exact: np.ndarray, mesh: Mesh) -> float:
    """Return the share of distances that differ from the exact ones."""
    side = float(np.ptp(mesh.corners.reshape(-1, 3), axis=0).max())
    with np.errstate(invalid="ignore"):
        return float(np.mean((found != exact) & ~(np.abs(found - exact) <= WRONG * side)))


STUDIES: dict[str, Callable[[Mesh, bool], Table]] = {"layered": layered}
