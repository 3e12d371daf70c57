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


class TriangleTest:
    """What a ray needs to be tried against many triangles.

    `across` and `along` are the rows of the projection: for a ray whose largest component is z they are (1, 0, -x/z)
    and (0, 1, -y/z), which takes the ray to the origin; `ahead` is then (0, 0, 1), and `pace` the component itself.

    With `roundoff`, the largest relative error of one rounding, only triangles are met that lie ahead beyond doubt:
    a ray of unit length that starts from a triangle does not meet it again, however far its corners are.
    """

    def __init__(self, ray: Any, eye: Any, roundoff: float | None = None) -> None:
        self.ray, self.roundoff = ray, roundoff
        size = abs(ray)
        by_x = (size.x >= size.y) & (size.x >= size.z)
        by_y = size.y >= size.z
        pace = sh.cond(by_x, ray.x, sh.cond(by_y, ray.y, ray.z))
        q = ray / pace
        across = sh.cond(by_x, sh.Vector3f(-q.y, 1, 0), sh.cond(by_y, sh.Vector3f(1, -q.x, 0), sh.Vector3f(1, 0, -q.x)))
        along = sh.cond(by_x, sh.Vector3f(-q.z, 0, 1), sh.cond(by_y, sh.Vector3f(0, -q.z, 1), sh.Vector3f(0, 1, -q.y)))
        ahead = sh.cond(by_x, sh.Vector3f(1, 0, 0), sh.cond(by_y, sh.Vector3f(0, 1, 0), sh.Vector3f(0, 0, 1)))
        self.eye, self.across, self.along, self.ahead, self.pace = eye, across, along, ahead, pace
        self.inverse = inverse_of(ray)

    def project(self, p: Any) -> Any:
        """A point relative to the ray's origin, seen along the ray."""
        return sh.Attrib2f(sh.dot(self.across, p), sh.dot(self.along, p))

    def __call__(self, triangles: Any, k: Any, near: Any, hit: Hit, *, numbers: Any = None) -> None:
        """Store triangle `k` in `hit` if the ray meets it at a distance in [near, hit.l).

        Of triangles at the same distance that of the lowest number is stored, whichever is tried first. `triangles` is
        the table of `layout.triangle_rows`, `numbers` that of the numbers by which they are known, if not k itself.
        A triangle without area, or edge-on, is never met.
        """
        rows = [triangles[3 * k + corner] for corner in range(3)]
        corners = [row.xyz - self.eye for row in rows]
        a, b, c = map(self.project, corners)
        wa = b.x * c.y - b.y * c.x
        wb = c.x * a.y - c.y * a.x
        wc = a.x * b.y - a.y * b.x
        left = (wa >= 0) & (wb >= 0) & (wc >= 0)
        right = (wa <= 0) & (wb <= 0) & (wc <= 0)
        whole = wa + wb + wc
        with SH_IF((left | right) & (whole != 0)):
            depth = [sh.dot(self.ahead, corner) for corner in corners]
            t = (wa * depth[0] + wb * depth[1] + wc * depth[2]) / (whole * self.pace)
            begin = lowest(*(corner * self.inverse for corner in corners))
            begins = highest(begin.x, begin.y, begin.z)
            ahead = t >= near
            if self.roundoff is not None:
                ahead &= self.surely_ahead(sh.Normal3f(*(row.w for row in rows)), corners[0])
            t = higher(t, begins - (REACH / 2) * abs(begins))
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
        slope = sh.dot(normal, self.ray)
        away = sh.dot(normal, corner)
        return (sh.cond(slope < 0, -away, away) > doubt * sh.dot(abs(normal), abs(corner))) & (abs(slope) > doubt)


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
