"""Where a ray meets a triangle.

Stage: kernel. Recorded into the walk of an accelerator. The triangle is seen along the ray: its corners, projected on
the plane across the ray's largest component, lie round the origin if the ray meets it (Woop, Benthin and Wald 2013).
A corner's projection depends on nothing but the corner and the ray, and swapping an edge's ends negates its edge
function to the bit: a ray cannot slip between triangles that share an edge or a corner.

The distance is that of a mean of the corners, as they lie along the ray's largest component: it cannot leave the
triangle there, however nearly edge-on the triangle is seen. Along the other components rounding may; so a distance
before the triangle's own box is taken to be where that box begins, less a part `REACH / 2`. A walk that looks into
every box up to the part `REACH` behind its nearest hit then finds the same hit in whatever order it goes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any

import shpy as sh
from shpy import SH_IF

FAR = 3.0e38
"""Farther than anything: as good as infinity, but `FAR * 0` is 0."""
REACH = 2.0**-10
"""How much farther than the nearest hit a box may be and be looked into, as a part of the distance."""


class Hit:
    """The nearest hit so far: distance `l`, barycentric `uv` of corners 1 and 2, and triangle `id`, -1 for none."""

    def __init__(self, limit: Any) -> None:
        l = sh.Attrib1f(limit)  # noqa: E741 - the paper's name
        uv = sh.TexCoord2f(0, 0)
        id = sh.Attrib1i(-1)
        self.l, self.uv, self.id = l, uv, id


class Sight:
    """The view along a ray, its axes turned so that z is the ray's largest component.

    `slope` is how far the ray goes along x and y for each step of z, `pace` how far it goes along z.
    """

    def __init__(self, ray: Any, eye: Any) -> None:
        size = abs(ray)
        self.by_x = (size.x >= size.y) & (size.x >= size.z)
        self.by_xy = self.by_x | (size.y >= size.z)
        self.eye = self.turned(eye)
        self.inverse = self.turned(inverse_of(ray))
        self.ray = self.turned(ray)
        x, y, self.pace = self.ray
        self.slope = (x / self.pace, y / self.pace)

    def turned(self, v: Any) -> tuple[Any, Any, Any]:
        """The components of a vector along x, y and z as they are turned."""
        x, y = sh.cond(self.by_x, v.y, v.x), sh.cond(self.by_xy, v.z, v.y)
        return x, y, sh.cond(self.by_x, v.x, sh.cond(self.by_xy, v.y, v.z))

    def edges(self, a: Any, b: Any, c: Any) -> tuple[Any, Any, Any]:
        """The edge functions of a triangle, opposite to each of its corners, which are relative to the ray's origin."""
        (ax, ay), (bx, by), (cx, cy) = map(self.project, (a, b, c))
        return bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx

    def project(self, p: Any) -> tuple[Any, Any]:
        """A point relative to the ray's origin, seen along the ray."""
        return p[0] - self.slope[0] * p[2], p[1] - self.slope[1] * p[2]

    def begin(self, a: Any, b: Any, c: Any) -> Any:
        """Where the box round a triangle begins, less a part of that distance."""
        begins = highest(*(lowest(*(corner[k] * self.inverse[k] for corner in (a, b, c))) for k in range(3)))
        return begins - (REACH / 2) * abs(begins)


class TriangleTest:
    """What a ray needs to be tried against many triangles.

    With `roundoff`, the largest relative error of one rounding, only triangles are met that lie ahead beyond doubt:
    a ray of unit length that starts from a triangle does not meet it again, however far its corners are.
    """

    def __init__(self, ray: Any, eye: Any, roundoff: float | None = None) -> None:
        self.sight, self.roundoff = Sight(ray, eye), roundoff

    def __call__(self, triangles: Any, k: Any, near: Any, hit: Hit, *, numbers: Any = None) -> None:
        """Store triangle `k` in `hit` if the ray meets it at a distance in [near, hit.l).

        Of triangles at the same distance that of the lowest number is stored, whichever is tried first. `triangles` is
        the table of `layout.triangle_rows`, `numbers` that of the numbers by which they are known, if not k itself.
        A triangle without area, or edge-on, is never met.
        """
        sight = self.sight
        rows = [triangles[3 * k + corner] for corner in range(3)]
        a, b, c = ([part - eye for part, eye in zip(sight.turned(row), sight.eye, strict=True)] for row in rows)
        wa, wb, wc = sight.edges(a, b, c)
        whole = wa + wb + wc
        with SH_IF(same_side(wa, wb, wc) & (whole != 0)):
            t = product((wa, wb, wc), (a[2], b[2], c[2])) / (whole * sight.pace)
            ahead = t >= near
            if self.roundoff is not None:
                ahead &= self.surely_ahead(sight.turned(sh.Normal3f(*(row.w for row in rows))), a)
            t = higher(t, sight.begin(a, b, c))
            number = k if numbers is None else numbers[k]
            with SH_IF(ahead & ((t < hit.l) | ((t == hit.l) & (number < hit.id)))):
                hit.l[:] = t
                hit.uv[:] = sh.TexCoord2f(wb, wc) / whole
                hit.id[:] = number

    def surely_ahead(self, normal: Any, corner: Any) -> Any:
        """Whether the plane through a corner across a unit normal lies ahead, whatever was rounded on the way.

        Both products have five roundings at most: of the corner's difference from the eye, of the normal, of the
        product and of two sums. Of the slope, where no factor is larger than 1, that is less than 6 roundings of 1.
        """
        assert self.roundoff is not None
        doubt = 6 * self.roundoff
        slope = product(normal, self.sight.ray)
        away = product(normal, corner)
        size = product([abs(n) for n in normal], [abs(p) for p in corner])
        return (sh.cond(slope < 0, -away, away) > doubt * size) & (abs(slope) > doubt)


def product(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """The scalar product of vectors that are given by components."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def same_side(a: Any, b: Any, c: Any) -> Any:
    """Whether no two of the numbers, which are never NaN, have opposite signs."""
    return (lowest(a, b, c) >= 0) | (highest(a, b, c) <= 0)


def is_ray(ray: Any, eye: Any) -> Any:
    """Whether these are a direction and a place: nothing NaN or infinite, and somewhere to go."""
    along = abs(ray.x) + abs(ray.y) + abs(ray.z)
    return (along > 0) & (along + (abs(eye.x) + abs(eye.y) + abs(eye.z)) <= FAR)


def inverse_of(ray: Any) -> Any:
    """1 / ray by component, and FAR where a component is too small for that: 0 times it is 0."""
    return sh.clamp(1 / ray, -FAR, FAR)


def farther(distance: Any) -> Any:
    """As far as boxes must be looked into when the nearest hit is at this distance."""
    return distance + REACH * abs(distance)


def lower(a: Any, b: Any) -> Any:
    """The lower of two numbers that are never NaN, which costs less than `min`."""
    return sh.cond(a < b, a, b)


def higher(a: Any, b: Any) -> Any:
    """The higher of two numbers that are never NaN."""
    return sh.cond(a < b, b, a)


def lowest(*numbers: Any) -> Any:
    """The lowest of numbers that are never NaN."""
    return reduce(lower, numbers)


def highest(*numbers: Any) -> Any:
    """The highest of numbers that are never NaN."""
    return reduce(higher, numbers)
