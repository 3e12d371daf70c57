"""Measure how time grows with triangles, pixels, bounces and lights.

    print(STUDIES["lights"](mesh, quick=False))

Each study gives a `Table`. Times are those of the best of five rounds; CPU times are those of all threads. Ours run on
OpenCL where there is a device, otherwise on numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import shpy as sh
from benchmarks import frames, peers, rays
from benchmarks.rounds import in_turns
from benchmarks.tables import Table
from raytracer import Mesh, Scene
from raytracer.integrators.renderer import Renderer
from raytracer.meshes.shapes import knot

ROUNDS = 5


def backend() -> str:
    """Return "opencl" where there is a device, otherwise "numpy"."""
    return "opencl" if any(b.available for b in sh.backends() if b.name == "opencl") else "numpy"


def rate(count: int, seconds: float) -> str:
    """Return millions of items per second, as text."""
    return f"{count / seconds / 1e6:.1f}"


def triangles(mesh: Mesh, quick: bool) -> Table:
    """Measure rays per second over knots of 1,000 to 1,000,000 triangles."""
    size = 32 if quick else 512
    compiled = partial(sh.Program.compile, backend=backend())
    with_mitsuba = not quick and not peers.available(["mitsuba"])[1]
    rows, rounds = [], {}
    names = ["primary", "secondary", "Mitsuba, primary", "Mitsuba, secondary"]
    for segments, sides in [(50, 10)] if quick else [(50, 10), (160, 32), (500, 100), (1600, 320)]:
        knotted = knot(segments=segments, sides=sides)
        ray_arrays = rays.secondary_rays(knotted, size)
        runs = [
            rays.ours_primary(compiled, size, knotted, False),
            rays.ours_given(compiled, *ray_arrays, knotted, False),
        ]
        if with_mitsuba:
            peers.start("mitsuba")
            runs += [
                rays.mitsuba(size, mesh=knotted, any_hit=False),
                rays.mitsuba(*ray_arrays, mesh=knotted, any_hit=False),
            ]
        counts = [size * size, len(ray_arrays[0])] * 2
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
        (times,) = in_turns({name: partial(renderer.render, (size, size))}, ROUNDS).values()
        shot, cpu = int(renderer.render((size, size)).stats.rays), min(times.cpu)
        rows.append([str(case), f"{1e3 * min(times.seconds):.1f}", f"{1e3 * cpu:.1f}", f"{shot:,}", rate(shot, cpu)])
        rounds[str(case)] = times.seconds
    head = [what, "ms", "CPU ms", "rays", "million rays a CPU second"]
    return Table(name, f"{note} On {backend()}.", head, rows, rounds)


def pixels(mesh: Mesh, quick: bool) -> Table:
    """Measure frames of 64 x 64 to 2048 x 2048 pixels."""
    scene = frames.scene_of(mesh)
    sizes = [16, 32] if quick else [64, 128, 256, 512, 1024, 2048]
    cases = [(n, scene, n, 1) for n in sizes]
    return _frames("pixels", f"{mesh.name} on a mirror, one light, one bounce.", "pixels along a side", cases)


def bounces(mesh: Mesh, quick: bool) -> Table:
    """Measure up to 16 bounces between mirrors."""
    size = 32 if quick else 512
    scene = Scene.builtin("mirror-box")
    cases = [(n, scene, size, n) for n in ((0, 1) if quick else (0, 1, 2, 4, 8, 16))]
    return _frames("bounces", f"The scene mirror-box, {size} x {size} pixels.", "bounces", cases)


def lights(mesh: Mesh, quick: bool) -> Table:
    """Measure 1 to 8 lights."""
    size = 32 if quick else 512
    cases = [(n, frames.scene_of(mesh, n), size, 1) for n in ((1, 2) if quick else (1, 2, 4, 8))]
    return _frames("lights", f"{mesh.name} on a mirror, {size} x {size} pixels, one bounce.", "lights", cases)


STUDIES: dict[str, Callable[[Mesh, bool], Table]] = {
    "triangles": triangles,
    "pixels": pixels,
    "bounces": bounces,
    "lights": lights,
}
