"""The very rays of a plain picture and of one with glass, walked by ours, by Mitsuba and by Embree.

    print(glass_rays(mesh, quick=False).markdown())

Each picture's rays are made once, with numpy: those from the eye, those to the light, and those through glass, in the
order of the pixels, level after level. The time of a ray by each contender tells whether the rays make a picture
slow, or the walk.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import shpy as sh
from benchmarks import features, peers, rays
from benchmarks.studies import Table, rounds_of, spread
from benchmarks.work import TARGETS
from raytracer import Intersector, Mesh, PointLight, Scene

IOR, BOUNCES = 1.5, 4
Rays = tuple[np.ndarray, np.ndarray]


def glass_rays(body: Mesh, quick: bool) -> Table:
    """Return the nanoseconds of a core that each contender takes for a ray of each kind, and for both pictures."""
    scene = features.plain(body)
    sets = rays_of(scene, len(body), 32 if quick else 256)
    whole = joined(scene)
    peer_names, _ = peers.available(["mitsuba", "embreex"])
    for name in peer_names:
        peers.start(name)
    makers: dict[str, Callable[..., Any]] = {"shpy, OpenCL": _ours}
    makers |= {"Mitsuba": _mitsuba} if "mitsuba" in peer_names else {}
    makers |= {"Embree, one ray at a time": _embree} if "embreex" in peer_names else {}
    runs = [maker(whole, *ray_arrays, coherent) for ray_arrays, coherent in sets.values() for maker in makers.values()]
    turns = 2 if quick else 15
    # Of all threads, as the contenders differ in how many they start.
    seconds = np.array(rounds_of(runs, turns, time.process_time)).reshape(len(sets), len(makers), turns)
    counts = [len(eye) for (eye, _), _ in sets.values()]
    rows = [
        [name, f"{count:,}", *(spread(1e9 * times / count, 0) for times in of_set)]
        for name, count, of_set in zip(sets, counts, seconds, strict=True)
    ]
    eye, light, glass = seconds
    more = (counts[0] + counts[2]) / (counts[0] + counts[1])
    rows.append(["picture with glass / plain", f"{more:.2f}", *(spread(r, 1) for r in (eye + glass) / (eye + light))])
    note = (
        f"{body.name}, {len(body):,} triangles, on a floor: the rays of the pictures of `glass`, the closest hit, "
        f"nanoseconds of a core for a ray (CPU time): medians of {turns} rounds, with the first and the third quartile."
    )
    return Table("glass-rays", note, ["rays", "number", *makers], rows)


def joined(scene: Scene) -> Mesh:
    """Return all triangles of a scene as one mesh."""
    corners = np.concatenate([mesh.corners for mesh in scene.meshes])
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), name=scene.name)


def rays_of(scene: Scene, clear: int, size: int) -> dict[str, tuple[Rays, bool]]:
    """Return origins and directions of each kind of ray, and whether they are coherent; `clear` triangles are glass."""
    mesh, camera, (light,) = joined(scene), scene.camera, scene.lights
    assert camera is not None
    assert isinstance(light, PointLight)
    ask = Intersector(mesh, backend="opencl")
    off = 1e-4 * float(np.linalg.norm(np.ptp(scene.meshes[0].corners, axis=(0, 1))))
    eye, corner, across, down = camera.view(size, size)
    row, column = np.mgrid[:size, :size].reshape(2, -1, 1) + 0.5
    first = _unit(corner + column * across + row * down)
    start = np.broadcast_to(eye, first.shape)

    def shadows(at: np.ndarray, normal: np.ndarray, where: np.ndarray) -> Rays:
        leave = (at + off * normal)[where]
        return leave, _unit(np.asarray(light.position) - leave)

    def met(start: np.ndarray, ray: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return places, normals against the rays, triangles, directions, and which are inside, of rays that hit."""
        hits = ask.intersect(start, ray)
        hit = hits.triangle >= 0
        ray, triangle = ray[hit], hits.triangle[hit]
        normal = mesh.face_normals[triangle]
        normal = normal * np.where(np.sum(normal * ray, axis=1) > 0, -1, 1)[:, None]
        return start[hit] + hits.t[hit, None] * ray, normal, triangle, ray, inside[hit]

    at, normal, triangle, ray, inside = met(start, first, np.zeros(len(first), bool))
    plain = shadows(at, normal, np.ones(len(at), bool))
    further: list[Rays] = [shadows(at, normal, triangle >= clear)]
    for _ in range(BOUNCES):
        glass = triangle < clear
        at, normal, ray, inside = at[glass], normal[glass], ray[glass], inside[glass]
        cosine = -np.sum(normal * ray, axis=1)
        ratio = np.where(inside, IOR, 1 / IOR)
        passes = 1 - ratio**2 * (1 - cosine**2)
        bent = ratio[:, None] * ray + (ratio * cosine - np.sqrt(np.maximum(passes, 0)))[:, None] * normal
        through = passes > 0
        starts = np.concatenate([at + off * normal, (at - off * normal)[through]])
        leaving = np.concatenate([ray + 2 * cosine[:, None] * normal, _unit(bent[through])])
        inside = np.concatenate([inside, ~inside[through]])
        further.append((starts, leaving))
        at, normal, triangle, ray, inside = met(starts, leaving, inside)
        further.append(shadows(at, normal, triangle >= clear))
    scattered = tuple(np.concatenate(parts) for parts in zip(*further, strict=True))
    sets = {"from the eye": ((start, first), True), "to the light, plain": (plain, True)}
    sets["of glass, but those from the eye"] = ((scattered[0], scattered[1]), False)
    return {k: ((eye.astype(np.float32), ray.astype(np.float32)), alike) for k, ((eye, ray), alike) in sets.items()}


def _unit(v: np.ndarray) -> np.ndarray:
    units: np.ndarray = v / np.linalg.norm(v, axis=1, keepdims=True)
    return units


def _ours(mesh: Mesh, eye: np.ndarray, ray: np.ndarray, coherent: bool) -> Any:
    del coherent  # which ours finds out
    compiled = partial(sh.Program.compile, **TARGETS["opencl"])
    return rays.ours_given(compiled, eye, ray, mesh, any_hit=False)


def _mitsuba(mesh: Mesh, eye: np.ndarray, ray: np.ndarray, coherent: bool) -> Any:
    return rays.mitsuba(eye, ray, mesh=mesh, any_hit=False, coherent=coherent)


def _embree(mesh: Mesh, eye: np.ndarray, ray: np.ndarray, coherent: bool) -> Any:
    del coherent
    return rays.embreex(eye, ray, mesh=mesh, any_hit=False)
