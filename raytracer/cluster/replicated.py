"""Pictures of scenes that every worker holds: the rows of a picture are cut into tiles, and each is a task.

Stage: cluster. The scene is sent to each worker once and compiled there once; finished tiles go to files
(`layers.canvas`).

    with connected("local:4") as client:
        image = render_tiles(client, Job(scene, Path(samples=64), "opencl"), (7680, 4320))
"""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from raytracer.appearance.programs import examine_shade, examine_sky, examine_surface
from raytracer.cluster.job import Job, JobRenderer, check_alike
from raytracer.cluster.tasks import finished, kept, key_of, scattered
from raytracer.image import Image, Stats
from raytracer.integrators.integrator import check_scene
from raytracer.integrators.layers import Progress, canvas, whole_size
from raytracer.integrators.progressive import Layers, check_resume, resumed
from raytracer.integrators.renderer import Resume
from raytracer.scene.scene import Scene

TILE = 1 << 16
"""Pixels of a tile, at most."""
TILES = 4
"""Tiles for each thread of the cluster, at least: then all finish at about the same time."""
_PREPARING = ("build_seconds", "record_seconds", "compile_seconds")
"""Times of `Stats` before the first picture of a Renderer."""
_Begun = tuple[Layers, int]
"""The layers of a picture that is continued, and the number of its samples."""


@dataclass
class Tile:
    """The layers of some rows, what they cost, and the fingerprint and origin of the Renderer that made them."""

    layers: Layers
    stats: Stats
    fingerprint: str
    origin: str


def render_tiles(
    client: Any,
    job: Job,
    size: tuple[int, int],
    *,
    tile_rows: int | None = None,
    resume: Resume = None,
    progress: Progress | None = None,
) -> Image:
    """Render a picture by the workers of a client, with the bits that one process gives it.

    `tile_rows` is how many rows a task renders, None for a number that suits the cluster. The other arguments are those
    of `render`, and the layers of the result lie in files. Raises ClusterError where workers compute different bits,
    which only relaxed modes allow.
    """
    started = time.perf_counter()
    width, height = whole_size(size)
    check_scene(job.scene)
    _check_programs(job.scene)
    check_resume(job.integrator, resume)
    layers, tile, done = canvas(width, height), None, 0
    key = key_of(job)
    with scattered(client, job) as sent:
        begun = None if resume is None else _begun(client, job, sent, key, (width, height), resume)
        rows = tile_rows or _suiting_rows(client, width, height)
        pieces = [_piece(top, min(rows, height - top), begun) for top in range(0, height, rows)]
        for (top, count, _), band in finished(client, _tile, pieces, sent, key, (width, height)):
            check_alike(tile.fingerprint if tile else None, band.fingerprint, job.integrator, job.backend)
            for name, layer in band.layers.items():
                layers[name][top : top + count] = layer
            tile, done = _joined(tile, band), done + count
            if progress is not None:
                progress(done, height)
    assert tile is not None  # a picture has at least one row
    stats = dataclasses.replace(tile.stats, seconds=time.perf_counter() - started)
    return Image(**layers, stats=stats, samples=job.integrator.samples, origin=tile.origin)


def _check_programs(scene: Scene) -> None:
    """Record the programs of materials and the background by themselves: here mistakes are shown with their lines."""
    materials = {mesh.material for mesh in scene.meshes}
    for surface in {material.surface for material in materials} - {None}:
        examine_surface(surface)
    for shade in {material.shade for material in materials} - {None}:
        examine_shade(shade)
    if callable(scene.background):
        examine_sky(scene.background, "a background")


def _tile(job: Job, key: str, size: tuple[int, int], piece: tuple[int, int, _Begun | None]) -> Tile:
    """Render rows in a worker."""
    top, count, begun = piece
    with kept(key, lambda: JobRenderer(job)) as here:
        started = time.perf_counter()
        layers = here.renderer.rows(size, top, count, start=begun)
        return Tile(layers, here.renderer.stats(layers, started), here.fingerprint, here.origin)


def _origin(job: Job, key: str, _: Any) -> str:
    with kept(key, lambda: JobRenderer(job)) as here:
        return here.origin


def _begun(client: Any, job: Job, sent: Any, key: str, size: tuple[int, int], resume: Resume) -> _Begun:
    """Return the layers of the picture that `resume` names, and how many samples per pixel it has."""
    assert resume is not None
    ((_, origin),) = finished(client, _origin, [None], sent, key)
    return resumed(resume, size, origin, job.integrator.samples)


def _piece(top: int, count: int, begun: _Begun | None) -> tuple[int, int, _Begun | None]:
    if begun is None:
        return top, count, None
    layers, samples = begun
    return top, count, ({name: layer[top : top + count] for name, layer in layers.items()}, samples)


def _suiting_rows(client: Any, width: int, height: int) -> int:
    threads: int = sum(client.nthreads().values())
    return max(1, min(TILE // width, height // (TILES * max(1, threads))))


def _joined(before: Tile | None, tile: Tile) -> Tile:
    """Return what two tiles say together, without their layers; preparation took as long as the slowest worker's."""
    if before is None:
        return dataclasses.replace(tile, layers={})
    a, b = before.stats, tile.stats
    joined: dict[str, Any] = {name: max(getattr(a, name), getattr(b, name)) for name in _PREPARING}
    joined["calls"] = dict(Counter(a.calls) + Counter(b.calls))
    joined["alive"] = tuple(map(sum, zip_longest(a.alive, b.alive, fillvalue=0)))
    return dataclasses.replace(before, stats=dataclasses.replace(a, rays=a.rays + b.rays, **joined))
