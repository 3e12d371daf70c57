"""Compare our hits with Embree's and our pictures with Mitsuba's, and judge who is right where they differ.

    print(hits(mesh, quick=False).markdown())
    print(whitted(mesh, quick=False).markdown())

Embree and ours compute in binary32: a ray that passes an edge as near as the rounding of coordinates may be given to
either side. So rays whose answers differ are traced again in binary64, against every triangle, and an answer's error is
the length by which the ray, or the surface that it meets, would have to be moved for the answer to be right.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks import frames, peers
from benchmarks.rays import primary_rays, secondary_rays
from benchmarks.studies import Table, backend
from raytracer import Intersector, Mesh, Scene
from raytracer.integrators.renderer import Renderer
from raytracer.meshes.mesh import joined
from raytracer.meshes.teapot import teapot

_AT_ONCE = 1 << 20
"""Pairs of a ray and a triangle that are held at once."""


def hits(mesh: Mesh, quick: bool) -> Table:
    """Return the share of rays that meet the same triangle as Embree's, and the errors of both on the others."""
    head = ["mesh", "rays", "number", "equal", "ours is exact", "Embree's is exact", "our error", "Embree's error"]
    if peers.available(["embreex"])[1]:
        return Table("hits", "no Embree", head, [])
    size = 64 if quick else 1024
    meshes = [mesh, teapot(divisions=4 if quick else 31), joined(Scene.builtin("mixed").meshes[:-1], "mixed")]
    rows = []
    for one in meshes[: 2 if quick else None]:
        shoot = Intersector(one, backend=backend())
        for kind, rays in (("coherent", primary_rays(one, size)), ("incoherent", secondary_rays(one, size))):
            ours, theirs = shoot.intersect(*rays).triangle, embree(one, *rays)
            rows.append([one.name, kind, f"{len(ours):,}", *compared(one, *rays, ours, theirs)])
    note = (
        "Rays that meet the same triangle, or nothing, in both; of the others, how many answers are those of binary64, "
        "and the largest error of an answer, in lengths of the mesh's diagonal (a rounding of binary32 is 6e-8)."
    )
    return Table("hits", note, head, rows)


def embree(mesh: Mesh, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return the triangle that each ray meets first, -1 for none."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    geometry = TriangleMesh(scene, np.float32(mesh.corners))
    triangles = scene.run(origins, directions, query="INTERSECT")
    assert geometry is not None  # the scene does not hold it itself
    return np.asarray(triangles)


def compared(
    mesh: Mesh, origins: np.ndarray, directions: np.ndarray, ours: np.ndarray, theirs: np.ndarray
) -> list[str]:
    """Return the last columns of a row of `hits`."""
    differ = np.flatnonzero(ours != theirs)
    corners = mesh.corners
    size = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
    texts: list[Any] = [f"{1 - len(differ) / len(ours):.5%}"]
    rays = [(origins[k].astype(np.float64), directions[k].astype(np.float64)) for k in differ]
    exact = [nearest(corners, *ray) for ray in rays]
    errors = []
    for answers in (ours, theirs):
        texts.append(f"{sum(e == answers[k] for e, k in zip(exact, differ, strict=True)):,}")
        of_each = map(partial(error, corners), rays, exact, answers[differ].tolist())
        errors.append(f"{max(of_each, default=0.0) / size:.0e}")
    return [*texts, *errors]


def nearest(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> int:
    """Return the triangle that a ray meets first, in binary64, -1 for none."""
    least, number = np.inf, -1
    for start in range(0, len(corners), _AT_ONCE):
        inside, _, t = passed(corners[start : start + _AT_ONCE], origin, direction)
        t = np.where(inside & (t >= 0), t, np.inf)
        if t.min() < least:
            least, number = float(t.min()), start + int(t.argmin())
    return number


def error(corners: np.ndarray, ray: tuple[np.ndarray, np.ndarray], exact: int, answer: int) -> float:
    """By what length the ray would have to be moved, or a surface along it, for `answer` to be the nearest triangle."""
    if answer == exact:
        return 0.0
    inside, edge, t = (x.tolist() for x in passed(corners[[answer, exact]], *ray))
    if answer < 0:
        return float(edge[1])
    if not inside[0]:
        return float(edge[0])
    return float(abs(t[0] - t[1]) if exact >= 0 else abs(t[0]))


def passed(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return whether a ray's line meets each triangle, how far it passes from the edges, and its distance there."""
    direction = direction / np.linalg.norm(direction)
    away = corners - origin
    seen = away - (away @ direction)[..., None] * direction  # as the eye sees it: the ray is the origin
    side = np.roll(seen, -1, axis=1) - seen
    turn = np.cross(seen, side) @ direction
    length = np.sum(side**2, axis=2)
    place = np.clip(-np.sum(seen * side, axis=2) / np.where(length > 0, length, 1), 0, 1)
    edge = np.linalg.norm(seen + place[..., None] * side, axis=2).min(axis=1)
    normal = np.cross(away[:, 1] - away[:, 0], away[:, 2] - away[:, 0])
    steep = normal @ direction
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.sum(away[:, 0] * normal, axis=1) / steep
    inside = ((turn >= 0).all(axis=1) | (turn <= 0).all(axis=1)) & (steep != 0)
    return inside, edge, t


def whitted(mesh: Mesh, quick: bool) -> Table:
    """Our pictures and those of a tracer that does the same in Mitsuba, pixel by pixel."""
    head = ["mesh", "pixels", "within 1/255", "within 1e-5", "beyond 1/255", "of these at an edge"]
    if peers.available(["whitted"])[1]:
        return Table("whitted", "no Mitsuba", head, [])
    peers.start("whitted")
    size, rows = 64 if quick else 1024, []
    for one in (mesh, teapot(divisions=4 if quick else 31)):
        ours = Renderer(frames.scene_of(one), backend=backend(), bounces=1).render((size, size)).pixels
        off = np.abs(ours - frames.mitsuba_whitted(size, one)()).max(axis=2)
        far = off > 1 / 255
        shares = [f"{np.mean(off <= bound):.4%}" for bound in (1 / 255, 1e-5)]
        rows.append([one.name, f"{off.size:,}", *shares, f"{far.sum():,}", f"{np.sum(edges(ours) & far):,}"])
    note = (
        "A matt mesh on a mirror under a point light with sharp shadows, one bounce, one ray through the middle of "
        "each pixel, linear colours. A pixel at an edge differs from one of its neighbours by more than 1/255."
    )
    return Table("whitted", note, head, rows)


def edges(pixels: np.ndarray) -> np.ndarray:
    """Return whether each pixel of (H, W, 3) differs from one of its eight neighbours by more than 1/255."""
    padded = np.pad(pixels, ((1, 1), (1, 1), (0, 0)), mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(0, 1))
    return np.asarray((np.abs(around - pixels[..., None, None]) > 1 / 255).any(axis=(2, 3, 4)))
