"""Path tracing of a large mesh against Mitsuba, to equal error.

    print(equal_error(Setup(peers=["mitsuba"])).markdown())

The error of a picture after n samples falls with n, so what a picture of a given error costs is its time times the
variance of its pixels. The variance is measured: pictures of other seeds, of which two that follow each other differ by
twice the variance.

Ours and Mitsuba run in a process each, one at a time. Nothing is downloaded: the mesh is a knot with ridges.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.frames import settled
from benchmarks.rays import mitsuba_scene, mitsuba_sensor
from benchmarks.report import spread
from benchmarks.rounds import Apart
from benchmarks.studies import backend
from benchmarks.tables import Setup, Table
from raytracer import Camera, EnvironmentLight, Material, Mesh, MetallicRoughness, Renderer, Scene, Texture
from raytracer.meshes.shapes import floor, knot

SIZE, SAMPLES, BOUNCES = 192, 16, 8
"""Pixels along each side, samples of a pixel, and scatterings of a path."""
CLAY = Material((0.72, 0.63, 0.52), diffuse=1.0, specular=0.0)
STONE = Material((0.45, 0.47, 0.50), diffuse=1.0, specular=0.0)
GOLD, PLASTIC = MetallicRoughness((1.0, 0.77, 0.34), 1, 0.3), MetallicRoughness((0.15, 0.3, 0.6), roughness=0.2)
LAMP = Material((0, 0, 0), diffuse=0.0, specular=0.0, emission=(9.0, 8.6, 8.0))


def ridged(segments: int = 1250, sides: int = 40) -> Mesh:
    """Return a knot of 2 * segments * sides triangles, flat ones, with ridges along and around the tube."""
    smooth = knot(segments=segments, sides=sides)
    along, around = np.divmod(np.arange(len(smooth.vertices)), sides)
    wave = np.sin(2 * np.pi * 7 * around / sides) * np.sin(2 * np.pi * 90 * along / segments)
    height = 0.03 * wave + 0.01 * np.sin(2 * np.pi * 311 * along / segments)
    normals = np.zeros_like(smooth.vertices)
    normals[smooth.faces] = smooth.normals
    return Mesh(smooth.vertices + height[:, None] * normals, smooth.faces, material=CLAY, name="ridged knot")


def mesh_scene(quick: bool = False) -> Scene:
    """Return a ridged knot of 100,000 triangles on a floor before a wall, under a lamp."""
    body = ridged(60, 12) if quick else ridged()
    # All lies below the lamp, whose upper side shines in one of the two and not in the other.
    ground = floor(10.0, STONE)
    meshes = [
        body.moved((0, 1.0, 0)),
        ground.moved((0, float(body.vertices[:, 1].min()) + 1.0, 0)),
        ground.moved((0, 0, -4.0), tilt=90),
        floor(3.0, LAMP).moved((-1.5, 5.5, 1.0), tilt=180),
    ]
    return Scene(meshes, (), Camera((2.2, 2.6, 5.6), (0, 0.7, 0), fov=42), background=(0, 0, 0), ambient=0.0)


def sky(height: int = 256) -> Texture:
    """Return a picture of a blue sky over a brown ground, with a sun that takes some degrees."""
    down, turn = np.pi * (np.arange(height) + 0.5) / height, np.pi * (np.arange(2 * height) + 0.5) / height
    up, sun = np.cos(down)[:, None], np.array([0.5, 0.7, 0.51])
    toward = np.stack(
        np.broadcast_arrays(np.sin(down)[:, None] * -np.sin(turn), up, np.sin(down)[:, None] * np.cos(turn))
    )
    light = np.exp((np.tensordot(sun / np.linalg.norm(sun), toward, 1) - 1) / 0.005)
    above = 1 / (1 + np.exp(-8 * up))
    colors = above[..., None] * (0.35, 0.55, 0.9) + (1 - above)[..., None] * (0.25, 0.2, 0.15)
    return Texture(np.float32(colors + 60 * light[..., None] * (1.0, 0.9, 0.75)))


def layered_scene(quick: bool = False) -> Scene:
    """Return the knot of rough gold on a floor of rough plastic, before a wall of it, under a sky with a sun."""
    knot_, ground, wall, _ = mesh_scene(quick).meshes
    meshes = [knot_.with_material(GOLD), *(mesh.with_material(PLASTIC) for mesh in (ground, wall))]
    return Scene(meshes, [EnvironmentLight(sky())], Camera((2.2, 2.6, 5.6), (0, 0.7, 0), fov=42))


def equal_error(setup: Setup) -> Table:
    """Time, variance, and the time to equal error, round by round."""
    scenes: dict[str, Callable[[], Scene]] = {
        "ridged knot": partial(mesh_scene, setup.quick),
        "cornell": partial(Scene.builtin, "cornell"),
        "gold and plastic": partial(layered_scene, setup.quick),
    }
    size, samples, rounds = (32, 4, 4) if setup.quick else (SIZE, SAMPLES, 12)
    contenders: dict[str, Any] = {peers.PEERS[name].label: _mitsuba for name in setup.installed("mitsuba")}
    contenders[f"shpy, {backend()}"] = _ours
    rows, seconds = [], {}
    for title, scene in scenes.items():
        makers = [partial(maker, scene, size, samples) for maker in contenders.values()]
        measured = in_processes(makers, rounds)
        base = measured[0]
        for name, one in zip(contenders, measured, strict=True):
            seconds[f"{title}, {name}"] = one.time.tolist()
            error = one.time / base.time * (one.variance / base.variance)
            rows.append(
                [
                    f"{title}, {name}",
                    f"{1e3 * np.median(one.time):.0f}",
                    f"{1e3 * np.median(one.cpu):.0f}",
                    *map(_ratio, (one.time / base.time, one.cpu / base.cpu, one.variance / base.variance, error)),
                    f"{one.mean:.4f}",
                    "" if one is base else f"{one.distance(base):.3f}",
                ]
            )
    note = (
        f"{size} x {size} pixels, {samples} samples, {BOUNCES} scatterings; the knot has "
        f"{len(scenes['ridged knot']().meshes[0]):,} triangles. Medians of {rounds} rounds; ratios to the first row, "
        "round by round, with the first and the third quartile. To equal error: the ratio of times, times that of "
        "variances. The mean z² of pixels is about 1.1 where both have the same expected picture. "
        "Each contender has a process of its own."
    )
    head = ["scene", "ms", "CPU ms", "of times", "of CPU", "of variances", "to equal error", "mean", "mean z²"]
    return Table("equal-error", note, head, rows, seconds)


def _ratio(values: Any) -> str:
    return "{:.2f} ({:.2f} to {:.2f})".format(*spread(values))


class Rounds:
    """The results of the rounds of one contender: seconds, CPU seconds and variances of a pixel, an array of each."""

    def __init__(self, measurements: Sequence[tuple[float, float, np.ndarray]]) -> None:
        seconds, cpu, pictures = zip(*measurements, strict=True)
        self.time, self.cpu = np.array(seconds), np.array(cpu)
        after = [*pictures[1:], pictures[0]]
        self.variance = np.array([np.mean((a - b) ** 2) / 2 for a, b in zip(pictures, after, strict=True)])
        self.mean = float(np.mean(pictures))
        self.pictures = np.array(pictures, np.float64)

    def distance(self, other: Rounds) -> float:
        """Return the mean z² of pixels: squared differences of means over the variance of that difference."""
        (a, va), (b, vb) = ((p.mean(axis=0), p.var(axis=0, ddof=1) / len(p)) for p in (self.pictures, other.pictures))
        seen = va + vb > 0
        return float(np.mean((a - b)[seen] ** 2 / (va + vb)[seen]))


def in_processes(makers: Sequence[Callable[[], Any]], rounds: int) -> list[Rounds]:
    """Time contenders in turns, each in a process of its own; a maker gives a function from a seed to a picture."""
    with ExitStack() as ending:
        ways = [ending.enter_context(Apart(partial(_Timed, maker))) for maker in makers]
        measurements: list[list[Any]] = [[] for _ in ways]
        for seed in range(rounds + 1):
            for way, results in zip(ways, measurements, strict=True):
                results.append(way(seed))
    return [Rounds(results[1:]) for results in measurements]  # the first one compiles


class _Timed:
    """A function from a seed to the seconds and CPU seconds of a picture, and the picture."""

    def __init__(self, maker: Callable[[], Any]) -> None:
        self.run = maker()

    def __call__(self, seed: int) -> tuple[float, float, np.ndarray]:
        self.run(0)  # it wakes the threads
        busy, started = time.process_time(), time.perf_counter()
        picture = self.run(seed)
        return time.perf_counter() - started, time.process_time() - busy, picture


def _ours(scene: Callable[[], Scene], size: int, samples: int) -> Any:
    renderer = Renderer(scene(), backend=backend(), integrator="path", bounces=BOUNCES)
    settled(renderer, size, samples)

    def run(seed: int) -> np.ndarray:
        renderer.integrator = replace(renderer.integrator, seed=seed)
        return np.asarray(renderer.render((size, size), samples=samples).pixels)

    return run


def _mitsuba(scene: Callable[[], Scene], size: int, samples: int) -> Any:
    peers.start("mitsuba")
    import mitsuba as mi

    ours = scene()
    theirs, sensor = mitsuba_scene(ours), mitsuba_sensor(ours.camera, size)
    integrator = mi.load_dict({"type": "path", "max_depth": BOUNCES + 1, "rr_depth": BOUNCES})

    def run(seed: int) -> np.ndarray:
        picture = mi.render(theirs, sensor=sensor, integrator=integrator, spp=samples, seed=seed)
        return np.asarray(picture)[..., :3]

    return run
