"""Pictures by the workers of a Dask cluster on this machine: times, overheads, memory, and the records that parts send.

    print(cluster(quick=False).markdown())
    print(partitions(quick=False).markdown())

Workers have one thread each and compute with numpy, so that one process and one worker do the same work.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

from benchmarks.moving import field
from benchmarks.studies import Table
from raytracer import Camera, Image, PointLight, Renderer, Scene, Whitted, render
from raytracer.cluster.connection import connected
from raytracer.cluster.job import Job
from raytracer.cluster.tasks import scattered
from raytracer.meshes.shapes import knot

ROUNDS = 3
HEAD = (
    "triangles", "one process s", "1 worker s", "2 workers s", "sent MB", "sending ms", "worker MB", "prepared s",
    "a tile ms",
)  # fmt: skip
PARTS = ("parts", "records a ray", "bytes a pixel", "rounds", "traced a ray", "s")
_TILES = 64


def cluster(quick: bool) -> Table:
    """Return times of a picture by one process and by workers, and what it costs to send its scene."""
    size = (64, 48) if quick else (1024, 768)
    rows = [_row(across, size, 1 if quick else ROUNDS) for across in ((12, 40) if quick else (70, 223, 707))]
    note = (
        f"{size[0]} x {size[1]} pixels of a hilly field on numpy, medians of {1 if quick else ROUNDS} pictures of "
        "Renderers that are there already, the sending included. `sending` is to two workers, `worker MB` by how much "
        "a worker grows with its first picture, `prepared` how long that picture took beyond a later one; `a tile` is "
        f"the cost of one more task, from {_TILES} of one pixel each."
    )
    return Table("cluster", note, HEAD, rows)


def partitions(quick: bool) -> Table:
    """Return the records that travel for a picture of a knot on a mirroring floor, against the number of parts."""
    mesh = knot(segments=60, sides=12) if quick else knot(segments=880, sides=40)
    scene, size = Scene.framed(mesh), (32, 24) if quick else (160, 120)
    rows = []
    with connected("local:2") as client:
        for parts in (1, 2, 4, 8):
            options: dict[str, Any] = {"integrator": Whitted(), "backend": "numpy", "partitions": parts}
            image = render(scene, size, cluster=client, **options)
            moved, rays, pixels = image.stats.moved, image.stats.rays, size[0] * size[1]
            shares = moved["records"] / rays, moved["bytes"] / pixels, moved["rounds"], moved["traced"] / rays
            rows.append([f"{parts}", *(f"{share:.2f}" for share in shares), f"{image.stats.seconds:.1f}"])
    note = (
        f"{size[0]} x {size[1]} pixels of {scene.triangles:,} triangles, two workers, numpy; a record of a ray, with "
        "its path and its pixel, goes to the part that the ray enters next. The seconds are those of a first picture."
    )
    return Table("partitions", note, PARTS, rows)


def _row(across: int, size: tuple[int, int], rounds: int) -> list[str]:
    lights, camera = [PointLight((3, 6, 4), (0.8, 0.7, 0.6))], Camera((0, 3, 6), (0, -0.3, 0), fov=45)
    scene = Scene([field(across)], lights, camera)
    renderer = Renderer(scene, backend="numpy")
    alone = _median(lambda: renderer.render(size), rounds)
    with connected("local:1") as client:
        _by(client, scene, size)
        one = _median(lambda: _by(client, scene, size), rounds)
        tile = _tile_seconds(client, scene, rounds)
    with connected("local:2") as client:
        client.run(_imported)
        job, empty = Job(scene, Whitted(), "numpy"), client.run(_resident)
        sending = _median(lambda: _send(client, job), rounds)
        started = time.perf_counter()
        _by(client, scene, size)
        first, full = time.perf_counter() - started, client.run(_resident)
        two = _median(lambda: _by(client, scene, size), rounds)
    sent = sum(mesh.vertices.nbytes + mesh.faces.nbytes for mesh in scene.meshes) / 1e6
    grown = max(full[worker] - empty[worker] for worker in full) / 1e6
    cells = f"{scene.triangles:,}", f"{alone:.2f}", f"{one:.2f}", f"{two:.2f}", f"{sent:.1f}", f"{1e3 * sending:.0f}"
    return [*cells, f"{grown:.0f}", f"{first - two:.1f}", f"{1e3 * tile:.1f}"]


def _by(client: Any, scene: Scene, size: tuple[int, int], **options: Any) -> Image:
    return render(scene, size, backend="numpy", cluster=client, **options)


def _send(client: Any, job: Job) -> None:
    with scattered(client, job):
        pass


def _tile_seconds(client: Any, scene: Scene, rounds: int) -> float:
    """Return the seconds of one more tile, from pictures one pixel wide."""
    size = 1, _TILES
    many = _median(lambda: _by(client, scene, size, tile_rows=1), rounds)
    single = _median(lambda: _by(client, scene, size, tile_rows=_TILES), rounds)
    return (many - single) / (_TILES - 1)


def _imported() -> None:
    import raytracer  # noqa: F401


def _resident() -> int:
    import psutil  # which distributed needs

    return int(psutil.Process().memory_info().rss)


def _median(run: Callable[[], Any], rounds: int) -> float:
    seconds = []
    for _ in range(rounds):
        started = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - started)
    return statistics.median(seconds)
