"""The point of a mesh that is closest to a given one: eight boxes at a time, and eight triangles at a time.

Stage: kernel. The walk is `wide_walk`'s for the nearest hit; in place of distances along a ray it compares squares of
distances from the point.

The closest point of a triangle lies on an edge, or where its plane is closest if that lies inside (Ericson 2005,
sections 5.1.2 and 5.1.5). All four are computed, and the closest is taken: so triangles without area, which have no
plane, are segments or points.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import shpy as sh
from raytracer.accel.bounds import FAR, highest
from raytracer.accel.wide import BLOCK, NORMALS, NUMBERS, TAGS
from raytracer.kernels.triangle import product
from raytracer.kernels.wide_walk import WideIntersector, both_rows, floats, keys_of
from shpy import SH_IF

Axes = list[Any]
"""Coordinates along x, y and z, each of eight triangles or boxes."""


class ClosestWay(NamedTuple):
    """The way from a point to the closest one, and its triangle."""

    way: sh.Vector3f
    triangle: sh.Attrib1i


class ClosestPoint:
    """The closest point so far: the square of its distance `l`, the way there, and triangle `id`."""

    def __init__(self) -> None:
        l = sh.Attrib1f(FAR)  # noqa: E741 - as in Hit
        way = sh.Vector3f(0, 0, 0)
        id = sh.Attrib1i(-1)
        self.l, self.way, self.id = l, way, id


class BoxDistances:
    """The squares of the distances of a point from eight boxes at a time."""

    def __init__(self, point: Any) -> None:
        self.point = point

    def keys(self, records: Any, row: Any, reach: Any) -> Any:
        """Return the keys of a node's boxes; see `keys_of`."""
        sides = []
        for axis in range(3):
            low, high = (floats(records, row + side) for side in (2 * axis, 2 * axis + 6))
            sides.append(highest(low - self.point[axis], self.point[axis] - high, sh.Attrib8f(0)))
        begin = product(sides, sides)
        return keys_of(begin, begin <= reach, both_rows(records, row + TAGS))


class TriangleDistances:
    """The points of eight triangles at a time that are closest to a point."""

    def __init__(self, point: Any) -> None:
        self.point = point

    def __call__(self, records: Any, row: Any, best: ClosestPoint) -> None:
        """Store the closest of a block's triangles in `best` if it is closer, or as close and of a lower number."""
        corners = [[floats(records, row + 2 * (3 * k + axis)) for axis in range(3)] for k in range(3)]
        normal = [floats(records, row + 2 * (NORMALS + k)) for k in range(3)]
        starts = [[corner[axis] - self.point[axis] for axis in range(3)] for corner in corners]
        sides = [[corners[k - 2][axis] - corners[k][axis] for axis in range(3)] for k in range(3)]
        first, *others = (on_segment(start, side) for start, side in zip(starts, sides, strict=True))
        least, way = product(first, first), first
        for there, other in ((True, others[0]), (True, others[1]), on_plane(starts, sides, normal)):
            square = product(other, other)
            closer = there & (square < least)
            least = sh.cond(closer, square, least)
            way = [sh.cond(closer, new, old) for new, old in zip(other, way, strict=True)]
        numbers = sh.Attrib8i(both_rows(records, row + 2 * NUMBERS))
        for k in range(BLOCK):
            nearer = (least[k] < best.l) | ((least[k] == best.l) & (numbers[k] < best.id))
            with SH_IF((numbers[k] >= 0) & nearer):
                best.l[:] = least[k]
                best.way[:] = sh.Vector3f(way[0][k], way[1][k], way[2][k])
                best.id[:] = numbers[k]


def on_segment(start: Axes, side: Axes) -> Axes:
    """Return the point closest to 0 of a segment from `start` along `side`: `start` if the side has no length."""
    square = product(side, side)
    part = sh.clamp(-product(start, side) / sh.cond(square > 0, square, 1.0), 0.0, 1.0)
    return [p + part * along for p, along in zip(start, side, strict=True)]


def on_plane(starts: list[Axes], sides: list[Axes], normal: Axes) -> tuple[Any, Axes]:
    """Return the point of a triangle's plane that is closest to 0, after True if it is inside the triangle.

    A side is not the difference of corners relative to 0, which may be far away: its rounding errors are those of its
    own length. So a point that is taken for inside is outside by no more than a rounding of its distance.
    """
    left = [product(normal, cross(start, side)) >= 0 for start, side in zip(starts, sides, strict=True)]
    height = product(normal, starts[0])
    return left[0] & left[1] & left[2] & (product(normal, normal) > 0), [height * n for n in normal]


def cross(a: Axes, b: Axes) -> Axes:
    """Return the vector product."""
    return [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]


def closest_point(walk: WideIntersector) -> Any:
    """Record the program that finds the way to the closest point of a mesh, in the kernel's coordinates."""

    @sh.program
    def closest_point(point: sh.Point3f) -> ClosestWay:
        best = ClosestPoint()
        walk.find_nearest(BoxDistances(point), TriangleDistances(point), best)
        return ClosestWay(best.way, best.id)

    return closest_point
