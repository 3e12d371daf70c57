"""Rays through refitted hierarchies of deformed objects, in times of those through hierarchies that were built anew.

    print(refits(quick=False).markdown())

`accel.forest.DEGRADED` is chosen by it: the growth of a hierarchy's expected cost at which it is built anew.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from benchmarks.studies import Table, backend, rounds_of, spread
from raytracer import Camera, Mesh, PointLight, Renderer, Scene
from raytracer.accel.forest import Forest
from raytracer.meshes.shapes import floor, torus

HEAD = ("deformation", "expected cost, times", "picture, times", "picture ms", "rebuilding ms")
Vertices = np.ndarray


def refits(quick: bool) -> Table:
    """Return, of each deformation, the growth of the expected cost and of a picture's time, and a rebuild's time."""
    segments, size, turns = (12, (32, 32), 2) if quick else (264, (512, 512), 9)
    ring = torus(1.0, 0.4, segments=segments, sides=segments // 2)
    # Each triangle has vertices of its own, so that it can fly away from the others.
    ring = Mesh(ring.corners.reshape(-1, 3), np.arange(3 * len(ring)).reshape(-1, 3), name="ring")
    lights, camera = [PointLight((3, 6, 4), (0.8, 0.7, 0.6))], Camera((0, 3, 6), (0, -0.3, 0), fov=45)
    scene = Scene([ring, floor(10).moved((0, -1, 0))], lights, camera)
    refitted, rebuilt = (Renderer(scene, backend=backend()) for _ in range(2))
    for renderer in (refitted, rebuilt):
        renderer.move(0, np.eye(4))  # which gives the ring a hierarchy of its own
        renderer.render(size)
    rows = [
        _row(name, deformed(ring.vertices), refitted, rebuilt, size, turns) for name, deformed in DEFORMATIONS.items()
    ]
    note = (
        f"{len(ring):,} triangles on a floor, {size[0]} x {size[1]} pixels on {backend()}: medians of {turns} rounds "
        f"of CPU time, with the first and the third quartile. Pictures are compared with one through a hierarchy "
        f"that was built anew for the same triangles, the expected cost (surface area heuristic) with the first."
    )
    return Table("refits", note, HEAD, rows)


def _twisted(turns: float) -> Callable[[Vertices], Vertices]:
    """Return the function that turns vertices about the x axis, one end against the other by 2 pi `turns`."""

    def twisted(at: Vertices) -> Vertices:
        angle = np.pi * turns * at[:, 0] / 1.4
        y, z = np.cos(angle) * at[:, 1] - np.sin(angle) * at[:, 2], np.sin(angle) * at[:, 1] + np.cos(angle) * at[:, 2]
        return np.stack([at[:, 0], y, z], axis=1)

    return twisted


def _waved(height: float) -> Callable[[Vertices], Vertices]:
    return lambda at: at + height * np.sin(6 * at[:, [1, 2, 0]])


def _exploded(distance: float) -> Callable[[Vertices], Vertices]:
    """Return the function that moves each triangle by itself, up to a distance along each axis."""

    def exploded(at: Vertices) -> Vertices:
        offsets = np.random.default_rng(7).uniform(-distance, distance, (len(at) // 3, 3))
        return at + np.repeat(offsets, 3, axis=0)

    return exploded


DEFORMATIONS: dict[str, Callable[[Vertices], Vertices]] = {
    **{f"twist of {turns:g} turns": _twisted(turns) for turns in (0.25, 1, 3)},
    **{f"waves of {height:g}": _waved(height) for height in (0.05, 0.2, 0.5)},
    **{f"explosion by {distance:g}": _exploded(distance) for distance in (0.01, 0.02, 0.05, 0.1, 0.3)},
}


def _row(
    name: str, vertices: Vertices, refitted: Renderer, rebuilt: Renderer, size: tuple[int, int], turns: int
) -> list[str]:
    growth, _ = _deform(refitted, vertices, float("inf"))
    _, seconds = _deform(rebuilt, vertices, 0.0)
    times = np.array(rounds_of([lambda: refitted.render(size), lambda: rebuilt.render(size)], turns, time.process_time))
    return [name, f"{growth:.2f}", spread(times[0] / times[1], 2), spread(1e3 * times[1], 1), f"{1e3 * seconds:.0f}"]


def _deform(renderer: Renderer, vertices: Vertices, limit: float) -> tuple[float, float]:
    """Deform the ring; return the growth of its hierarchy's cost, and the CPU seconds that it took.

    The hierarchy is built anew if it costs more than `limit` times as much as an infinitely small one.
    """
    forest = _forest(renderer)
    hierarchy = forest.objects[0]
    built, hierarchy.built_cost = hierarchy.built_cost, limit
    renderer.deform(0, vertices)
    started = time.process_time()
    renderer._follow_motion()
    seconds = time.process_time() - started
    if limit > 0:
        hierarchy.built_cost = built
    return hierarchy.cost() / built, seconds


def _forest(renderer: Renderer) -> Forest:
    assert renderer.layout is not None
    assert renderer.layout.forest is not None
    return renderer.layout.forest
