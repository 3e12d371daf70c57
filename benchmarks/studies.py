"""Measure how time grows with triangles, pixels, bounces, lights and instances.

    print(lights(Setup(mesh)).markdown())

Times are those of the best of five rounds; CPU times are those of all threads. Ours run on OpenCL where there is a
device, otherwise on numpy.
"""

from __future__ import annotations

import itertools
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np

import shpy as sh
from benchmarks import frames, rays
from benchmarks.rounds import Apart, in_turns, peer_run
from benchmarks.tables import Setup, Table
from benchmarks.work import Run
from raytracer import Instance, Mesh, PointLight, Scene
from raytracer.integrators.renderer import Renderer
from raytracer.meshes.shapes import knot
from raytracer.scene.layout import Layout

ROUNDS = 5


def backend() -> str:
    """Return "opencl" where there is a device, otherwise "numpy"."""
    return "opencl" if any(b.available for b in sh.backends() if b.name == "opencl") else "numpy"


def rate(count: int, seconds: float) -> str:
    """Return millions of items per second, as text."""
    return f"{count / seconds / 1e6:.1f}"


def triangles(setup: Setup) -> Table:
    """Measure rays per second over knots of 1,000 to 1,000,000 triangles."""
    size = 32 if setup.quick else 512
    compiled = partial(sh.Program.compile, backend=backend())
    rows, rounds = [], {}
    names = ["primary", "secondary", "Mitsuba, primary", "Mitsuba, secondary"]
    for segments, sides in [(50, 10)] if setup.quick else [(50, 10), (160, 32), (500, 100), (1600, 320)]:
        knotted = knot(segments=segments, sides=sides)
        ray_arrays = rays.secondary_rays(knotted, size)
        runs: list[Run | Apart] = [
            rays.ours_primary(compiled, size, knotted, False),
            rays.ours_given(compiled, *ray_arrays, knotted, False),
        ]
        counts = [size * size, len(ray_arrays[0])] * 2
        with ExitStack() as ending:
            for peer in setup.installed("mitsuba"):
                maker = partial(rays.mitsuba, mesh=knotted, any_hit=False)
                runs += [ending.enter_context(peer_run(peer, maker, *start)) for start in ((size,), ray_arrays)]
            times = in_turns(dict(zip(names, runs, strict=False)), ROUNDS)
        rates = [rate(n, min(t.seconds)) for n, t in zip(counts, times.values(), strict=False)]
        rows.append([f"{len(knotted):,}", *rates])
        rounds |= {f"{len(knotted):,}, {name}": t.seconds for name, t in times.items()}
    note = f"Million rays a second, closest hit, {size} x {size} pixels, on {backend()}."
    return Table("triangles", note, ["triangles", *names][: len(rows[0])], rows, rounds)


def _frames(name: str, note: str, what: str, cases: Sequence[tuple[Any, Scene, int, int]]) -> Table:
    rows, rounds = [], {}
    for case, scene, size, bounces in cases:
        renderer = Renderer(scene, backend=backend(), bounces=bounces)
        (times,) = in_turns({name: frames.settled(renderer, size)}, ROUNDS).values()
        shot, cpu = int(renderer.render((size, size)).stats.rays), min(times.cpu)
        rows.append([str(case), f"{1e3 * min(times.seconds):.1f}", f"{1e3 * cpu:.1f}", f"{shot:,}", rate(shot, cpu)])
        rounds[str(case)] = times.seconds
    head = [what, "ms", "CPU ms", "rays", "million rays a CPU second"]
    return Table(name, f"{note} On {backend()}.", head, rows, rounds)


def pixels(setup: Setup) -> Table:
    """Measure frames of 64 x 64 to 2048 x 2048 pixels."""
    scene = frames.scene_of(setup.mesh)
    sizes = [16, 32] if setup.quick else [64, 128, 256, 512, 1024, 2048]
    cases = [(n, scene, n, 1) for n in sizes]
    return _frames("pixels", f"{setup.mesh.name} on a mirror, one light, one bounce.", "pixels along a side", cases)


def bounces(setup: Setup) -> Table:
    """Measure up to 16 bounces between mirrors."""
    size = 32 if setup.quick else 512
    scene = Scene.builtin("mirror-box")
    cases = [(n, scene, size, n) for n in ((0, 1) if setup.quick else (0, 1, 2, 4, 8, 16))]
    return _frames("bounces", f"The scene mirror-box, {size} x {size} pixels.", "bounces", cases)


def lights(setup: Setup) -> Table:
    """Measure 1 to 8 lights."""
    size = 32 if setup.quick else 512
    cases = [(n, frames.scene_of(setup.mesh, n), size, 1) for n in ((1, 2) if setup.quick else (1, 2, 4, 8))]
    return _frames("lights", f"{setup.mesh.name} on a mirror, {size} x {size} pixels, one bounce.", "lights", cases)


def instances(setup: Setup) -> Table:
    """Measure the layout and frames of knots that share their triangles, beside knots with triangles of their own."""
    size, counts = (16, (2, 4)) if setup.quick else (256, (10, 100, 766))
    knotted = knot(segments=10, sides=4) if setup.quick else knot(segments=250, sides=20)
    rows, rounds = [], {}
    for count in counts:
        seconds, peak, tables, scene = _laid_out(knotted, count)
        numbers = [f"{seconds:.2f}", f"{peak / 1e6:.0f}", f"{tables / 1e6:.1f}"]
        runs = _frames_of_instances(scene, size, ("instances", "bvh") if count < 500 else ("instances",))
        for name, contenders in runs.items():
            times = in_turns(contenders, ROUNDS)
            numbers.append(" / ".join(f"{1e3 * min(t.cpu):.1f}" for t in times.values()))
            rounds |= {f"{count}, {name}, {accel}": t.cpu for accel, t in times.items()}
        rows.append([f"{count:,}", f"{scene.triangles:,}", *numbers])
    note = (
        f"Knots of {len(knotted):,} triangles, described and laid out; CPU ms of frames of {size} x {size} on "
        f"{backend()}, where instances share triangles / have triangles of their own."
    )
    head = ["instances", "triangles", "CPU s", "peak MB", "MB of tables", "frame", "path traced", "a move and a frame"]
    return Table("instances", note, head, rows, rounds)


def _frames_of_instances(scene: Scene, size: int, accels: Sequence[str]) -> dict[str, dict[str, Callable[[], Any]]]:
    """Return what draws a frame, a path traced one, and one after a move, for each accelerator."""
    runs: dict[str, dict[str, Callable[[], Any]]] = {"frame": {}, "path": {}, "move": {}}
    for accel in accels:
        moved, path = (
            Renderer(scene, backend=backend(), integrator=name, accel=accel, samples=1) for name in ("whitted", "path")
        )
        runs["frame"][accel] = partial(Renderer(scene, backend=backend(), accel=accel).render, (size, size))
        runs["path"][accel] = partial(path.render, (size, size))
        runs["move"][accel] = partial(_moved_frame, moved, size, itertools.count())
    return runs


def _moved_frame(renderer: Renderer, size: int, steps: Iterator[int]) -> None:
    """Draw a frame after a move of the first object."""
    place = np.eye(4)
    place[0, 3] = 0.01 * (next(steps) % 10)
    renderer.move(0, place)
    renderer.render((size, size))


def _laid_out(mesh: Mesh, count: int) -> tuple[float, int, int, Scene]:
    """Return the CPU time of a scene of instances and its layout, the largest memory, that of tables, and the scene."""

    def run() -> tuple[Scene, Layout]:
        scene = Scene(_scattered(mesh, count, np.random.default_rng(count)), [PointLight((0, 50, 0))])
        return scene, Layout.of(scene, "instances")

    started = time.process_time()
    run()
    seconds = time.process_time() - started
    tracemalloc.start()
    scene, layout = run()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    rows = [rows for rows in (layout.triangles, layout.normals, layout.uvs) if rows is not None]
    in_binary32 = sum(array.nbytes // 2 for array in rows)
    return seconds, peak, layout.structure.bytes + in_binary32, scene


def _scattered(mesh: Mesh, count: int, random: np.random.Generator) -> list[Instance]:
    """Return instances of a mesh, turned at random, in a square that grows with their number."""
    placed = []
    for _ in range(count):
        place = np.eye(4)
        place[:3, :3], _ = np.linalg.qr(random.normal(size=(3, 3)))
        place[:3, 3] = random.uniform(-1, 1, 3) * (2 * count**0.5, 0.5, 2 * count**0.5)
        placed.append(Instance(mesh, place))
    return placed
