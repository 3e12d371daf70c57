"""Queries of rays: the nearest hit, whether there is any, how many there are, and the next ones after a hit.

Stage: kernel. Rays arrive as the user gives them. The kernel moves and scales them exactly where it can: a subtraction,
and products with powers of two. It also marks invalid rays, so that the host need not check them.

Directions keep their direction to the bit: they are not brought to length 1 but divided by a power of two, so that
their largest component is in [1/4, 1/2). So they are shorter than 1, as bounds of rounding errors need it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import shpy as sh
from raytracer.accel.bounds import far, higher, highest
from raytracer.kernels.triangle import REACH, Walk
from shpy import SH_IF

SHORTEST, LONGEST = 2.0**-60, 2.0**60
"""Largest components of directions with which no number of a kernel leaves the range of f32."""
UNIT = 2.0**-20
"""The largest distance from 1 of the square of the length of a direction that counts as of unit length."""
FEW, MANY = 4, 16
"""Hits that a ray finds in its first walk, and in each of the others."""
_KINDS = sh.Attrib4f, sh.Attrib4i, sh.Attrib4f, sh.Attrib4f
_EXPONENT = 0x7F800000
_QUARTER = 252 << 23


class NearestHit(NamedTuple):
    """A ray's nearest hit, and whether the input is not a ray."""

    t: sh.Attrib1f
    triangle: sh.Attrib1i
    uv: sh.TexCoord2f
    wrong: sh.Attrib1b


class AnyHit(NamedTuple):
    """The result of `occluded`: `met`, and whether the ray was none."""

    met: sh.Attrib1b
    wrong: sh.Attrib1b


class HitNumber(NamedTuple):
    """The result of `count`: the triangles that a ray meets, and whether it was none."""

    number: sh.Attrib1i
    wrong: sh.Attrib1b


class Four(NamedTuple):
    """Four hits of a ray, triangle -1 where there are no more."""

    t: sh.Attrib4f
    triangle: sh.Attrib4i
    u: sh.Attrib4f
    v: sh.Attrib4f


class QueryRay:
    """A ray in a kernel's coordinates, made of a user's: `(eye - origin) * scale`, and distances in `pace` of theirs.

    `wrong` holds for NaN and infinity, and for directions that are too long or too short for f32, 0 included. Such rays
    meet nothing. With `exact` the ray is in the kernel's coordinates already, and is not wrong. With `keeps_unit` the
    factor `shrink` of directions is 1 for those of unit length, so that they are those of the integrators' rays.
    """

    def __init__(
        self,
        eye: Any,
        ray: Any,
        near: Any,
        limit: Any,
        origin: Any,
        scale: Any,
        exact: bool,
        *,
        keeps_unit: bool = False,
    ) -> None:
        if exact:
            self.eye, self.ray, self.near, self.limit = eye, ray, near, limit
            self.wrong, self.pace = sh.Attrib1b(False), None
            return
        along = abs(ray.x) + abs(ray.y) + abs(ray.z)
        size = highest(abs(ray.x), abs(ray.y), abs(ray.z))
        right = (along <= 3 * LONGEST) & (size >= SHORTEST) & (size <= LONGEST)
        right = right & (abs(eye.x) + abs(eye.y) + abs(eye.z) <= far()) & ~sh.isnan(near) & ~sh.isnan(limit)
        self.wrong = ~right
        held = sh.bits_from_float(sh.cond(right, size, 1.0)) & sh.Attrib1u(_EXPONENT)
        shrink = sh.float_from_bits(sh.Attrib1u(_QUARTER) - held)
        if keeps_unit:
            shrink = sh.cond(abs(sh.dot(ray, ray) - 1) <= UNIT, 1.0, shrink)
        self.shrink = shrink
        self.eye = (eye - origin) * scale
        self.ray = ray * shrink
        self.pace = scale / shrink
        self.near = self.inside(near)
        self.limit = sh.cond(right, self.inside(limit), -far())

    def inside(self, t: Any) -> Any:
        """Convert a distance of the user's to the kernel's coordinates."""
        return t if self.pace is None else sh.clamp(t * self.pace, -far(), far())

    def outside(self, t: Any, number: Any) -> Any:
        """Convert a distance of the kernel's to the user's coordinates; infinite where the triangle's number is -1."""
        return sh.cond(number >= 0, t if self.pace is None else t / self.pace, sh.Attrib1f(float("inf")))


class HitCount:
    """The number of triangles met before `limit`, each of which is offered once."""

    def __init__(self, limit: Any) -> None:
        l = sh.Attrib1f(limit)  # noqa: E741 - as in RayHit
        count = sh.Attrib1i(0)
        self.l, self.id, self.count = l, -1, count

    def offer(self, met: Any, t: Any, number: Any, weights: Sequence[Any]) -> None:
        """Count a triangle that is `met` before the limit."""
        with SH_IF(met & (t < self.l)):
            self.count += 1


class HitList:
    """The first hits of a ray before `limit`, in order of (distance, triangle), that come after a hit.

    `t`, `id`, `u` and `v` are variables for each of `size` hits; the id of a place that is free is -1. As soon as all
    places are taken, triangles are met no farther than the last of them.
    """

    def __init__(self, size: int, limit: Any, t: Any, number: Any) -> None:
        self.after = (t, number)
        self.t: list[Any] = []
        self.id_of: list[Any] = []
        self.u: list[Any] = []
        self.v: list[Any] = []
        for _ in range(size):
            distance = sh.Attrib1f(limit)
            taken = sh.Attrib1i(-1)
            u = sh.Attrib1f(0)
            v = sh.Attrib1f(0)
            for column, variable in zip(self.columns, (distance, taken, u, v), strict=True):
                column.append(variable)
        self.l, self.id = self.t[-1], -1

    @property
    def columns(self) -> tuple[list[Any], list[Any], list[Any], list[Any]]:
        """The variables of distance, triangle, u and v, each by place."""
        return self.t, self.id_of, self.u, self.v

    def offer(self, met: Any, t: Any, number: Any, weights: Sequence[Any]) -> None:
        """Insert a triangle that is `met`, if it comes after the given hit and before the last that is held."""
        follows = (t > self.after[0]) | ((t == self.after[0]) & (number > self.after[1]))
        with SH_IF(met & follows & self.is_before(t, number, -1)):
            wb, wc, whole = weights
            found = (t, number, wb / whole, wc / whole)
            for place in reversed(range(len(self.t))):
                here = self.is_before(t, number, place)
                # If the new hit also precedes the entry before, that entry moves up.
                ahead = self.is_before(t, number, place - 1) if place else False
                for column, new in zip(self.columns, found, strict=True):
                    moved = sh.cond(ahead, column[place - 1], new) if place else new
                    column[place][:] = sh.cond(here, moved, column[place])

    def is_before(self, t: Any, number: Any, place: int) -> Any:
        """Return whether a hit comes before the one at `place`; a free place is at the limit."""
        return (t < self.t[place]) | ((t == self.t[place]) & (number < self.id_of[place]))


def _recorded(name: str, answer: Callable[[QueryRay], Any], outputs: Any, exact: bool) -> Any:
    """Record a program of this name, which answers a query of a ray at distances in [near, limit)."""

    def query(
        eye: sh.Point3f, ray: sh.Vector3f, near: sh.Attrib1f, limit: sh.Attrib1f, origin: sh.Point3f, scale: sh.Attrib1f
    ) -> outputs:
        return answer(QueryRay(eye, ray, near, limit, origin, scale, exact))

    query.__name__ = name
    query.__annotations__["return"] = outputs
    return sh.program(query)


def intersect(walk: Walk, exact: bool) -> Any:
    """Record the program that finds the nearest hit of a ray."""

    def answer(query: QueryRay) -> NearestHit:
        hit = walk(query.ray, query.eye, query.near, query.limit, False)
        return NearestHit(query.outside(hit.l, hit.id), *hit.in_scene, query.wrong)

    return _recorded("intersect", answer, NearestHit, exact)


def occluded(walk: Walk, exact: bool) -> Any:
    """Record the program that tells whether a ray meets anything."""

    def answer(query: QueryRay) -> AnyHit:
        hit = walk(query.ray, query.eye, query.near, query.limit, True)
        return AnyHit(sh.Attrib1b(hit.id >= 0), query.wrong)

    return _recorded("occluded", answer, AnyHit, exact)


def count(walk: Walk, exact: bool) -> Any:
    """Record the program that counts the triangles that a ray meets."""

    def answer(query: QueryRay) -> HitNumber:
        hits = HitCount(query.limit)
        walk.collect(hits, query.ray, query.eye, query.near, query.near, False)
        return HitNumber(hits.count, query.wrong)

    return _recorded("count", answer, HitNumber, exact)


def list_hits(walk: Walk, exact: bool, size: int = FEW) -> Any:
    """Record the program that lists the next `size` hits of a ray in [near, limit) after the hit (`after`, `number`).

    `after` is in the kernel's coordinates; -infinity and -1 come before the first hit. The outputs are hits in fours,
    the last hit's distance in the kernel's coordinates, and whether the input is not a ray.
    """
    named_tuple: Any = NamedTuple  # the fields depend on the size
    fours = [(f"hits_{k}", Four) for k in range(0, size, 4)]
    outputs: Any = named_tuple("outputs", [*fours, ("last", sh.Attrib1f), ("wrong", sh.Attrib1b)])

    @sh.program
    def list_hits(
        eye: sh.Point3f,
        ray: sh.Vector3f,
        near: sh.Attrib1f,
        limit: sh.Attrib1f,
        origin: sh.Point3f,
        scale: sh.Attrib1f,
        after: sh.Attrib1f,
        number: sh.Attrib1i,
    ) -> outputs:
        query = QueryRay(eye, ray, near, limit, origin, scale, exact)
        hits = HitList(size, query.limit, after, number)
        begin = higher(query.near, after - REACH * abs(after))
        walk.collect(hits, query.ray, query.eye, query.near, begin, False)
        t = [query.outside(distance, triangle) for distance, triangle in zip(hits.t, hits.id_of, strict=True)]
        groups = []
        for k in range(0, size, 4):
            parts = (t, hits.id_of, hits.u, hits.v)
            groups.append(Four(*(kind(*part[k : k + 4]) for kind, part in zip(_KINDS, parts, strict=True))))
        return outputs(*groups, hits.l, query.wrong)

    return list_hits


def list_more(walk: Walk, exact: bool) -> Any:
    """Record the program that lists the next hits of rays that are known to have many; see `list_hits`."""
    return list_hits(walk, exact, MANY)
