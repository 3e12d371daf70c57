"""Layered depth cubes beside the BVH and the grid: what they take to build, and incoherent rays through them.

    print(STUDIES["layered"](mesh, quick=False).markdown())
    print(STUDIES["deferred"](mesh, quick=False).markdown())       # pictures shaded from samples, or from triangles

The rays are those of `rays.secondary_rays`. Ours go through an `Intersector`, from arrays of the host to results; only
the hit test "triangle" finds the exact hits. Mitsuba has the rays as arrays of its own already. The number of wrong
hits is part of the table, since a cube trades them for time. `raytracer study layered` measures more of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks import peers, rays
from benchmarks.studies import Table, backend, in_turns, rate, rounds_of, spread
from raytracer import Camera, Image, Intersector, LayeredCube, Material, Mesh, PointLight, Renderer, Scene, Texture
from raytracer.accel.choice import build
from raytracer.layered.cube import SHADINGS
from raytracer.meshes.shapes import box, floor, knot

HEAD = (
    *("accelerator", "triangles", "build s", "build CPU by BVH's"),
    *("MiB", "million rays/s", "wrong hits", "other triangles"),
)
DEFERRED = (
    *("mesh, hits", "texels", "exact", "deferred", "between"),
    *("ms", "deferred / exact", "MiB", "MiB, deferred"),
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
    ray_arrays = rays.secondary_rays(mesh, size)
    cube = partial(LayeredCube.of, mesh, resolution, backend=backend())
    makers = {name: partial(build, name, mesh.corners) for name in ("bvh", "grid")}
    makers |= {f'cube, "{hit}"': partial(cube, hit=hit) for hit in ("plane", "triangle")}
    structures = {name: make() for name, make in makers.items()}  # kernels are compiled
    seconds = in_turns(list(makers.values()), 2)
    shoot = {
        name: Intersector(mesh, s if isinstance(s, LayeredCube) else name, backend()) for name, s in structures.items()
    }
    runs = [partial(one.intersect, *ray_arrays) for one in shoot.values()]
    work = _work(list(makers.values()))
    first = runs[0]()
    exact = first.t
    hits = [run() for run in runs]
    wrong = [_wrong(one.t, exact, mesh) for one in hits]
    others = [_others(one.triangle, first.triangle) for one in hits]
    if with_mitsuba:
        peers.start("mitsuba")
        runs.append(rays.mitsuba(*ray_arrays, mesh=mesh, any_hit=False))
    rates = [rate(len(exact), s) for s in in_turns(runs)]
    sizes = [s.nbytes if isinstance(s, LayeredCube) else s.bytes for s in structures.values()]
    count = f"{len(mesh):,}"
    rows = [
        [name, count, f"{s:.2f}", c, f"{n / 2**20:.1f}", r, f"{w:.2%}", f"{o:.2%}"]
        for name, s, c, n, r, w, o in zip(structures, seconds, work, sizes, rates, wrong, others, strict=False)
    ]
    return rows + [["Mitsuba", count, "", "", "", r, "", ""] for r in rates[len(structures) :]]


def _others(triangles: np.ndarray, exact: np.ndarray) -> float:
    """Return the share of the hits of both whose triangles differ."""
    both = (triangles >= 0) & (exact >= 0)
    return float(np.mean(triangles[both] != exact[both]))


def _wrong(distances: np.ndarray, exact: np.ndarray, mesh: Mesh) -> float:
    """Return the share of distances that differ from the exact ones."""
    side = float(np.ptp(mesh.corners.reshape(-1, 3), axis=0).max())
    with np.errstate(invalid="ignore"):
        return float(np.mean((distances != exact) & ~(np.abs(distances - exact) <= WRONG * side)))


def deferred(mesh: Mesh, quick: bool) -> Table:
    """Pictures shaded from the samples of cubes beside pictures shaded from triangles, and both beside the BVH's."""
    resolutions, size, rounds = ((16,), (32, 32), 2) if quick else ((256, 1024), (320, 256), 7)
    rows = []
    for name, scene in {"plain": _mirrored(mesh, plain=True), "smooth, textured": _mirrored(mesh, plain=False)}.items():
        exact = Renderer(scene, backend=backend(), bounces=1).render(size)
        for hit, resolution in [(hit, n) for hit in ("plane", "triangle") for n in resolutions]:
            cubes = [LayeredCube.of(scene, resolution, backend=backend(), hit=hit, shading=s) for s in SHADINGS]
            renderers = [Renderer(scene, backend=backend(), bounces=1, secondary=cube) for cube in cubes]
            pictures = [renderer.render(size) for renderer in renderers]
            times = np.array(rounds_of([partial(one.render, size) for one in renderers], rounds, time.process_time))
            off = [f"{_difference(picture, exact):.2f}" for picture in pictures]
            seconds = [f"{1e3 * float(np.median(times[0])):.0f}", spread(times[1] / times[0], 2)]
            sizes = [f"{cube.nbytes / 2**20:.1f}" for cube in cubes]
            between = f"{_difference(*pictures):.2f}"
            rows.append([f'{name}, "{hit}"', str(resolution), *off, between, *seconds, *sizes])
    note = (
        f"{mesh.name} of {len(mesh):,} triangles on a mirror and before one, {size[0]} x {size[1]} pixels, one bounce, "
        f"on {backend()}. RMSE in steps of 8 bits beside the picture of the BVH, and of deferred beside exact shading. "
        f"CPU time of all threads with exact shading, and its ratio: median (quartiles) of {rounds} rounds in turns."
    )
    return Table("deferred", note, DEFERRED, rows)


def _mirrored(mesh: Mesh, plain: bool) -> Scene:
    """Return the mesh over a floor and before a wall that mirror, with one light."""
    low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
    middle, side = (low + high) / 2, float((high - low).max())
    uv = mesh.vertices[:, :2] / side
    squares = Texture(np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((4, 4)))[..., None] * np.ones(3) * 0.7 + 0.2)
    material = Material((0.8, 0.5, 0.3)) if plain else Material(squares, specular=0.3)
    body = replace(mesh, normals=None, colors=None, uv=uv, material=material)
    mirror = Material((0.2, 0.2, 0.2), reflectivity=0.8)
    ground = floor(3 * side, mirror).moved((middle[0], low[1], middle[2]))
    wall = box((3 * side, 3 * side, 0.01 * side), mirror).moved((middle[0], middle[1], low[2] - 0.2 * side))
    light = PointLight(tuple((middle + side * np.array([1, 3, 2])).tolist()), (0.9, 0.9, 0.9))
    return Scene((body if plain else body.smoothed(), ground, wall), (light,), Camera.framing(low, high))


def _difference(one: Image, other: Image) -> float:
    """Return the root of the mean squared difference of two pictures in steps of 8 bits."""
    return 255 * float(np.sqrt(np.mean((one.pixels - other.pixels) ** 2)))


STUDIES: dict[str, Callable[[Mesh, bool], Table]] = {"layered": layered, "deferred": deferred}
