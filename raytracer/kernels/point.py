"""The point of a hit: means of the triangle's corners, and how far rounding may have moved the point off the surface.

Stage: kernel. Recorded by the tracers (`surfaces`) and by the walk that users' programs call (`component`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import shpy as sh
from raytracer.accel.bounds import highest
from raytracer.kernels.triangle import CandidateHit, RayHit, Triangles

ROUNDINGS = 7
"""The largest distance of a triangle's point from its plane, in roundings of its coordinates: 2 as the weights may not
sum to 1, 3 of their products and sums, and 2 of moving it off the plane (Pharr, Jakob and Humphreys 2023, 6.8.4)."""
PLANE_ROUNDINGS = 12
"""The same of a point of the ray at the distance of the plane, in roundings of the plane's level, of the eye and of the
way: 5 of the eye's height and 3 of the slope, 2 of the point, and 2 of moving it."""
INSTANCED = 6
"""Factor of `PlaneView.beside`, which counts sixths."""


class SeenHit(NamedTuple):
    """A point that a rasteriser has seen: its distance, some triangle of its mesh, and the uv coordinates there."""

    l: Any  # noqa: E741 - as in RayHit
    id: Any
    uv: Any
    texcoord: Any
    instance: Any = None


def place_of(
    triangles: Triangles, roundoff: float, hit: RayHit, places: Sequence[Any], face: Any, ray: Any, eye: Any
) -> tuple[Any, Any]:
    """Return the point that was hit, and how far it may be off the triangle's plane.

    It is the mean of the corners with the weights of `hit`, or the ray's intersection with the plane if that is far
    more exact. `roundoff` is the largest relative error of one rounding.
    """
    sizes = barylerp(hit, *(abs(place) for place in places))
    plane = triangles.plane_of(hit, face, ray, eye)
    far = plane.is_better(hit.l, highest(*sizes))
    t = plane.height / plane.slope
    point = sh.cond(far, eye + t * ray, barylerp(hit, *places))
    beside = PLANE_ROUNDINGS * roundoff * plane.error_at(t)
    if plane.beside is None:
        return point, sh.cond(far, beside, ROUNDINGS * roundoff * sh.dot(abs(face), sizes))
    return point, sh.cond(far, beside, roundoff * (ROUNDINGS * sh.dot(abs(face), sizes) + INSTANCED * plane.beside))


def curved_normal(hit: RayHit, normals: Sequence[Any], side: Any, facing: Any) -> Any:
    """Return the unit normal between those at the corners, on the side of `facing`."""
    normal = side * sh.normalize(barylerp(hit, *(n.xyz for n in normals)))
    return sh.cond(sh.dot(normal, facing) < 0, -normal, normal)


def curve_depth(hit: RayHit, normals: Sequence[Any], point: Any, places: Sequence[Any], side: Any) -> Any:
    """Return how far a point lies below the curved surface that the normals at the corners describe, as a vector."""
    return barylerp(hit, *(depth(point - p, side * n.xyz) for p, n in zip(places, normals, strict=True)))


def rows_of(table: Any, hit: RayHit | CandidateHit | SeenHit) -> tuple[Any, Any, Any]:
    """Return the rows of the three corners of the triangle that was hit."""
    first = 3 * hit.id
    return table[first], table[first + 1], table[first + 2]


def barylerp(hit: RayHit | CandidateHit | SeenHit, a: Any, b: Any, c: Any) -> Any:
    """Interpolate linearly between `a`, `b` and `c` at the corners of the triangle that was hit."""
    return (1 - hit.uv.x - hit.uv.y) * a + hit.uv.x * b + hit.uv.y * c


def depth(from_corner: Any, normal: Any) -> Any:
    """Return how far a point lies below the plane of a corner and its normal, as a vector along the normal.

    The mean of these vectors over the three corners moves the point onto the curved surface that the triangles
    approximate, so that the edge of its shadow does not show the triangles (Hanika 2021, Ray Tracing Gems II, chapter
    4).
    """
    return sh.min(sh.dot(from_corner, normal), 0.0) * normal
