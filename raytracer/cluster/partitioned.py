"""Render a scene whose triangles are divided into parts: each worker holds one, and rays travel between them.

Stage: cluster. In each round every part traces its rays as far as they go there; a band of the picture is finished when
no part has rays left. Dask moves batches of rays from worker to worker; this process receives only their number.

    with connected("local:2") as client:
        image = render_partitioned(client, Job(scene, Whitted(), "numpy"), (640, 480), 8)
"""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from itertools import pairwise
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.programs import examine_sky
from raytracer.arrays import is_whole
from raytracer.cluster.job import Job, check_alike
from raytracer.cluster.part import Part, PartData, Records, StepResult, joined
from raytracer.cluster.tasks import KEPT, await_worker, is_loss, kept, shown
from raytracer.errors import SceneError
from raytracer.image import Image, Stats
from raytracer.integrators.integrator import Whitted, check_scene
from raytracer.integrators.layers import Progress, canvas, rows_at_once, take_samples, unscale, whole_size
from raytracer.kernels.appearance import Appearance
from raytracer.kernels.kinds import is_black
from raytracer.kernels.pixel import Pixel
from raytracer.layered.cube import is_layered
from raytracer.scene.layout import Layout
from raytracer.scene.scene import Scene

MOST = 1024
"""Parts, at most."""
LOSSES = 3
"""Workers that may be lost over the same band, as Dask has it for a task."""


def render_partitioned(
    client: Any, job: Job, size: tuple[int, int], partitions: int, *, progress: Progress | None = None
) -> Image:
    """Render a picture of a scene that is cut into `partitions` parts, to the same bits as one process.

    The integrator is a `Whitted` with the accelerator "bvh". Raises SceneError for others, for scenes with glass, and
    for a number of parts that is not from 1 to 1024. Where a worker is lost, its parts are sent to others and the band
    is computed again; ClusterError where this happens repeatedly.
    """
    started = time.perf_counter()
    width, height = whole_size(size)
    check_scene(job.scene)
    check_partitions(job, partitions)
    fine = isqrt(job.integrator.samples)
    layers, layout = canvas(width, height), Layout.of(job.scene, "brute", job.integrator.precision)
    parts = _cut(job, layout, partitions, (width * fine, height * fine))
    cut = time.perf_counter() - started
    run = _Run(client, parts)
    rows = rows_at_once("parts", width * fine * fine)
    for top in range(0, height, rows):
        past = min(top + rows, height)
        pixels = run.traced(top * fine, (past - top) * fine, width * fine)
        band = Pixel(*(layer[top:past] for layer in layers.values()))
        take_samples(band, pixels, fine)
        unscale(band, layout.scale)
        if progress is not None:
            progress(past, height)
    rays = int(layers["rays"].sum(dtype=np.int64))
    stats = Stats(job.backend, time.perf_counter() - started, cut, 0.0, 0.0, rays, job.scene.triangles)
    stats = dataclasses.replace(stats, moved=dict(run.moved))
    return Image(**layers, stats=stats, samples=job.integrator.samples)


def check_partitions(job: Job, partitions: int) -> None:
    """Raise SceneError for a scene that partitions cannot render, as far as this shows before the scene is laid out."""
    chosen = job.integrator
    if not is_whole(partitions, 1, MOST):
        raise SceneError(f"a scene is cut into 1 to {MOST} partitions, not {partitions!r}")
    layered = isinstance(chosen, Whitted) and (chosen.secondary is not None or is_layered(chosen.accel or ""))
    if not isinstance(chosen, Whitted) or layered or chosen.structure != "bvh":
        raise SceneError('partitions are rendered by Whitted(accel="bvh"): choose it, or leave the partitions out')
    if not job.scene.triangles:
        raise SceneError("a scene without triangles has no partitions: leave them out")
    if chosen.precision == "f16":
        raise SceneError('partitions work at precision="f32" or "f64", not "f16"')


def _check_layout(layout: Layout, scene: Scene) -> Appearance:
    """Return the materials of a scene; SceneError where some are clear, and for mistakes in programs."""
    appearance = Appearance(layout)
    if callable(scene.background):
        examine_sky(scene.background, "a background")
    if scene.environment is not None and scene.environment.program is not None:
        examine_sky(scene.environment.program, "an EnvironmentLight")
    if any(appearance.clears):
        raise SceneError("partitions follow mirrored rays alone, and this scene has glass: leave the partitions out")
    return appearance


def _cut(job: Job, layout: Layout, partitions: int, size: tuple[int, int]) -> list[PartData]:
    """Cut a scene into parts of about equally many triangles."""
    appearance = _check_layout(layout, job.scene)
    corners = layout.triangles[:, :3].reshape(-1, 3, 3)
    groups = [np.sort(group) for group in _groups(corners.mean(axis=1), np.arange(len(corners)), partitions)]
    groups = [group for group in groups if len(group)]
    low = np.array([corners[group].min(axis=(0, 1)) for group in groups])
    high = np.array([corners[group].max(axis=(0, 1)) for group in groups])
    camera = job.scene.camera
    assert camera is not None  # a Scene sets its own camera by default
    shared: dict[str, Any] = {
        "low": low,
        "high": high,
        "black": bool(appearance) or is_black(layout),
        "camera": camera,
        "background": job.scene.background,
        "ambient": job.scene.ambient,
        "environment": job.scene.environment,
        "uniforms": camera.uniforms(*size, layout.origin, layout.scale, layout.dtype),
        "integrator": job.integrator,
        "backend": job.backend,
    }
    return [
        PartData(number=number, layout=_part_of(layout, group), numbers=group.astype(np.int32), **shared)
        for number, group in enumerate(groups)
    ]


def _groups(centres: NDArray[Any], numbers: NDArray[Any], count: int) -> list[NDArray[Any]]:
    """Divide triangles into `count` groups, by planes across the longest side of the box round their centres."""
    if count == 1:
        return [numbers]
    own = centres[numbers]
    axis = int(np.argmax(own.max(axis=0) - own.min(axis=0))) if len(numbers) else 0
    order = numbers[np.argsort(own[:, axis], kind="stable")]
    left = count // 2
    middle = len(numbers) * left // count
    return _groups(centres, order[:middle], left) + _groups(centres, order[middle:], count - left)


def _part_of(layout: Layout, group: NDArray[Any]) -> Layout:
    """Return the layout of the triangles with these indices, without an accelerator."""
    rows = (3 * group[:, None] + np.arange(3)).reshape(-1)
    tables = {name: getattr(layout, name) for name in ("triangles", "normals", "colors", "uvs")}
    parts: dict[str, Any] = {name: table[rows] for name, table in tables.items() if table is not None}
    parts |= {"material_of": layout.material_of[group], "object_of": layout.object_of[group], "structure": None}
    return dataclasses.replace(layout, **parts)


class _Run:
    """The parts of a scene at their workers, and the rounds that trace bands of its picture.

    `moved` counts the records that went from part to part, their bytes, the rounds, and the rays that parts traced.
    """

    def __init__(self, client: Any, parts: list[PartData]) -> None:
        self.client, self.parts, self.moved = client, parts, Counter(records=0, bytes=0, rounds=0, traced=0)
        self.fingerprint: str | None = None
        self.sent: dict[int, Any] = {}
        self.homes: dict[int, str] = {}

    def traced(self, top: int, count: int, width: int) -> Pixel:
        """Trace `count` rows of eye rays from `top` on; return their layers.

        If a worker is lost, its records are lost, too, and the rows are traced again.
        """
        before = self.moved.copy()
        for losses in range(LOSSES + 1):
            try:
                self._place()
                return self._traced(top, count, width)
            except Exception as error:
                if losses == LOSSES or not is_loss(error):
                    raise shown(error) from None
            self.moved = before.copy()
        raise AssertionError  # the last attempt returns or raises

    def _place(self) -> None:
        """Send each part that no worker holds to the worker that has the fewest."""
        await_worker(self.client)
        there = [sent for sent in self.sent.values() if not sent.cancelled()]
        holders = self.client.who_has(there) if there else {}
        self.homes = {number: home for number, sent in self.sent.items() for home in holders.get(sent.key, ())[:1]}
        counts = Counter(self.homes.values())
        load = {worker: counts[worker] for worker in sorted(self.client.nthreads())}
        for number, part in enumerate(self.parts):
            if number not in self.homes:
                home = min(load, key=lambda worker: load[worker])
                self.sent[number] = self._sent_to(home, part)
                self.homes[number] = home
                load[home] += 1

    def _sent_to(self, home: str, part: PartData) -> Any:
        """Send a part to a worker; raise the error of a lost worker if it died after its address was looked up."""
        from distributed import CancelledError

        try:
            return self.client.scatter(part, workers=[home], hash=False)
        except (KeyError, TimeoutError) as error:
            raise CancelledError(f"a part for the worker at {home}, which has died") from error

    def _traced(self, top: int, count: int, width: int) -> Pixel:
        ends = [count * number // len(self.parts) for number in range(len(self.parts) + 1)]
        steps = {
            number: self._submit(_begin, number, (top + first, past - first, width, first * width))
            for number, (first, past) in enumerate(pairwise(ends))
            if first < past
        }
        done: list[Records] = []
        while steps:
            steps = self._round(steps, done)
        records = joined(done)
        layers: dict[str, Any] = {}
        for name, column in records.columns.items():
            if name != "place":
                layers[name] = np.empty_like(column)
                layers[name][records.columns["place"]] = column
        return Pixel(*(layer.reshape(count, width, *layer.shape[1:]) for layer in layers.values()))

    def _round(self, steps: dict[int, Any], done: list[Records]) -> dict[int, Any]:
        """Wait for the steps of all parts, then start the steps of the next round with the records sent to them."""
        tellings = self.client.gather([self.client.submit(_tell, step, pure=False) for step in steps.values()])
        self.moved["rounds"] += 1
        incoming: dict[int, list[Any]] = {}
        data = self.parts[0]
        for step, (counts, finished, traced, digest) in zip(steps.values(), tellings, strict=True):
            self.fingerprint = check_alike(self.fingerprint, digest, data.integrator, data.backend)
            self.moved["traced"] += traced
            done.append(finished)
            for goal, (records, size) in counts.items():
                self.moved["records"] += records
                self.moved["bytes"] += size
                incoming.setdefault(goal, []).append(self.client.submit(_batch, step, goal, pure=False))
        return {goal: self._submit(_step, goal, batches) for goal, batches in incoming.items()}

    def _submit(self, function: Any, number: int, work: Any) -> Any:
        sent, home = self.sent[number], self.homes[number]
        return self.client.submit(function, sent, sent.key, len(self.parts), work, workers=[home], pure=False)


def _begin(data: PartData, key: str, count: int, work: tuple[int, int, int, int]) -> StepResult:
    with kept(key, lambda: Part(data), KEPT + count) as part:
        return part.first_step(*work)


def _step(data: PartData, key: str, count: int, batches: list[Records]) -> StepResult:
    with kept(key, lambda: Part(data), KEPT + count) as part:
        return part.step(joined(batches))


def _tell(stepped: StepResult) -> tuple[dict[int, tuple[int, int]], Records, int, str]:
    """Return how many records and bytes go to each part, the finished pixels, the rays traced, and the fingerprint."""
    counts = {goal: (len(records), records.nbytes) for goal, records in stepped.sent.items()}
    return counts, stepped.done, stepped.visits, stepped.fingerprint


def _batch(stepped: StepResult, goal: int) -> Records:
    return stepped.sent[goal]
