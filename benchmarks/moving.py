"""Frames of scenes in which an object moves or is deformed, in times of the frame in which nothing has changed.

    print(moving(mesh, quick=False).markdown())

Scenes: a ring with smooth normals and the mesh that is given, as flat triangles, each of which turns over a hilly field
of a million triangles; a ring that waves on a floor; and the built-in scene `boxes`, of which one box turns. A frame
with a change includes the new tables of the object.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.studies import PAUSE, backend, rounds_of, spread
from benchmarks.tables import Table
from raytracer import Camera, Mesh, PointLight, Renderer, Scene
from raytracer.accel.shape import Shape, plane_kernel, plane_program
from raytracer.meshes.shapes import floor, torus

HEAD = (
    "scene",
    "triangles",
    "moving",
    "unchanged ms",
    "changed ms",
    "of which tables ms",
    "ratio",
    "of CPU",
    "ratio, same walk",
)
PLANES = ("triangles", "numpy ms", "kernel ms", "kernel, times", "of CPU")
_SHAPES = 8
"""Shapes of the ring that waves, made before: whoever deforms an object computes its vertices."""
CLOCKS = (time.perf_counter, time.process_time)
Change = Callable[[Renderer, int], None]


def moving(mesh: Mesh, quick: bool) -> Table:
    """Return the milliseconds of frames with a change and without one, and their ratios, round by round."""
    size, turns = ((32, 32), 2) if quick else ((512, 512), 15)
    rows = [
        _row(name, scene, number, change, size, turns) for name, (scene, number, change) in cases(mesh, quick).items()
    ]
    note = (
        f"{size[0]} x {size[1]} pixels on {backend()}: medians of {turns} rounds, with the first and the third "
        f"quartile. Ratios are to the unchanged frame in the same round, of a renderer that nothing moves in, and "
        f"(same walk) of the one in which the object has moved before."
    )
    return Table("moving", note, HEAD, rows)


def planes(quick: bool) -> Table:
    """Return the milliseconds for the tables of objects that are deformed, by numpy and by a kernel, and their ratio.

    `accel.shape.MANY` is chosen by it: the number of triangles from which on a kernel computes them.
    """
    rows, turns = [], 2 if quick else 15
    for segments in (12, 24) if quick else (32, 64, 96, 128, 160, 192, 264):
        ring = torus(1.0, 0.4, segments=segments, sides=segments // 2)
        vertices = ring.vertices.astype(np.float32).astype(np.float64)
        table, shapes = np.empty((3 * len(ring), 4), np.float32), [Shape(len(ring), np.dtype(np.float32)) for _ in "12"]
        shapes[1].kernel = plane_kernel(backend()) or plane_program().compile("numpy", precision="f64")
        runs = [partial(shape.take, vertices, ring.faces, table) for shape in shapes]
        (numpy, kernel), busy = (np.array(rounds_of(runs, turns, clock)) for clock in CLOCKS)
        times = [spread(1e3 * numpy, 2), spread(1e3 * kernel, 2), spread(kernel / numpy, 2)]
        rows.append([f"{len(ring):,}", *times, spread(busy[1] / busy[0], 2)])
    note = (
        f"The planes and boxes of an object's triangles, by numpy and by a kernel on {backend()}: medians of {turns} "
        f"rounds, with the first and the third quartile."
    )
    return Table("planes", note, PLANES, rows)


def cases(mesh: Mesh, quick: bool) -> dict[str, tuple[Scene, int, Change]]:
    """Return the scenes, the number of the object that changes, and what changes it for a frame."""
    segments, across = (12, 20) if quick else (264, 707)
    ring = dataclasses.replace(torus(1.0, 0.4, segments=segments, sides=segments // 2), name="ring")
    lights, camera = [PointLight((3, 6, 4), (0.8, 0.7, 0.6))], Camera((0, 3, 6), (0, -0.3, 0), fov=45)
    at, normals = ring.vertices, ring.normals

    shapes = [at + 0.1 * np.sin(3 * at[:, [1, 2, 0]] + 0.3 * phase) for phase in range(_SHAPES)]

    def wave(renderer: Renderer, frame: int) -> None:
        renderer.deform(0, shapes[frame % _SHAPES], normals)

    def turn(renderer: Renderer, frame: int) -> None:
        renderer.move(0, turned(10 * frame))

    hills, body = field(across), flat(mesh)
    over, above = (Scene([turning, hills], lights, camera) for turning in (ring, body))
    on = Scene([ring, floor(10).moved((0, -1, 0))], lights, camera)
    return {
        "turning ring over a field": (over, 0, turn),
        f"turning {body.name} over a field": (above, 0, turn),
        "waving ring on a floor": (on, 0, wave),
        "turning box of three": (Scene.builtin("boxes"), 2, lambda renderer, k: renderer.move(2, turned(5 * k))),
    }


def flat(mesh: Mesh) -> Mesh:
    """Return a mesh without normals and colours about 0, as wide as the ring."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return Mesh((mesh.vertices - (low + high) / 2) * (2.8 / (high - low).max()), mesh.faces, name=mesh.name)


def field(across: int) -> Mesh:
    """Return hills of 2 * across**2 triangles."""
    x, z = np.meshgrid(*[np.linspace(-6, 6, across + 1)] * 2, indexing="ij")
    vertices = np.stack([x, 0.2 * np.sin(5 * x) * np.cos(4 * z) - 1.2, z], axis=-1).reshape(-1, 3)
    a = (np.arange(across)[:, None] * (across + 1) + np.arange(across)).ravel()
    b, c, d = a + 1, a + across + 1, a + across + 2
    return Mesh(vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)]), name="field")


def turned(degrees: float) -> np.ndarray:
    """Return the matrix (4, 4) that turns about the y axis."""
    angle, matrix = np.radians(degrees), np.eye(4)
    matrix[0, 0] = matrix[2, 2] = np.cos(angle)
    matrix[0, 2], matrix[2, 0] = np.sin(angle), -np.sin(angle)
    return matrix


def _row(name: str, scene: Scene, number: int, change: Change, size: tuple[int, int], turns: int) -> list[str]:
    still, changed = Renderer(scene, backend=backend()), Renderer(scene, backend=backend())
    still.render(size)
    for frame in range(2):  # the first change builds the hierarchy of the object
        change(changed, frame)
        changed.render(size)
    builds, measurements = changed.builds, []
    for frame in range(turns):
        time.sleep(PAUSE)
        still.render(size)  # it wakes the threads
        unchanged = _milliseconds(lambda: still.render(size))
        tables = _milliseconds(lambda frame=frame: _prepare(changed, change, frame + 2))
        drawn = _milliseconds(lambda: changed.render(size))
        again = _milliseconds(lambda: changed.render(size))
        measurements.append((unchanged, tables + drawn, tables, again))
    assert changed.builds == builds, "a change has built the whole scene anew"
    (unchanged, whole, tables, again), (unchanged_cpu, whole_cpu, *_) = np.transpose(measurements, (2, 1, 0))
    times = [spread(values, 1) for values in (unchanged, whole, tables)]
    ratios = [spread(whole / unchanged, 2), spread(whole_cpu / unchanged_cpu, 2), spread(whole / again, 2)]
    return [name, f"{scene.triangles:,}", f"{len(scene.meshes[number]):,}", *times, *ratios]


def _prepare(renderer: Renderer, change: Change, frame: int) -> None:
    """Change the object and bring the tables up to date, which a frame would do otherwise."""
    change(renderer, frame)
    renderer._follow_motion()


def _milliseconds(run: Callable[[], Any]) -> np.ndarray:
    """Return the milliseconds that a call takes, and those of CPU time of all threads."""
    started = [clock() for clock in CLOCKS]
    run()
    return 1e3 * np.array([clock() - start for clock, start in zip(CLOCKS, started, strict=True)])
