"""The intersection of a ray with a triangle.

Stage: kernel. Recorded into the walk of an accelerator. The triangle is seen along the ray: its corners, projected on
the plane across the ray's largest component, lie round the origin if the ray meets it (Woop, Benthin and Wald 2013).
A corner's projection depends on nothing but the corner and the ray, and swapping an edge's ends negates its edge
function to the bit: a ray cannot slip between triangles that share an edge or a corner.

The ray must also meet the box round the triangle. Of a triangle far smaller than its distance from the eye the edge
functions are nothing but rounding, but the box is compared with relative errors of a few roundings. The margin is
smaller than that of the walks, so a walk never leaves out a triangle that is met.

The distance is that of a mean of the corners, as they lie along the ray's largest component: it cannot leave the
triangle there, however nearly edge-on the triangle is seen. Its error grows with the distance of the corners. The error
of the distance to the triangle's plane grows with the distances of the plane and the eye from 0 instead: where that
is far less, as beside a huge triangle, the plane is taken. Rounding may move the hit along the other components, and
along all of them on a plane that is seen nearly edge-on; so a distance outside the triangle's own box is taken to be
where that box begins or ends, but for a part `REACH / 2`. A walk that looks into every box up to the part `REACH`
behind its nearest hit then finds the same hit in whatever order it goes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from dataclasses import dataclass
from typing import Any, NamedTuple, Self, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

import shpy as sh
from raytracer.accel.bounds import far, higher, highest, lower, lowest, rounded
from raytracer.accel.planes import constant, levels_of, normals_of, parts
from shpy import SH_IF

REACH = 2.0**-10
"""The margin beyond the nearest hit within which a box is still visited, as a part of the distance."""
BESIDE = 10 * 2.0**-24
"""The margin around a triangle's box relative to the distance: 3 roundings of each side and more."""
GROWTH = 2.0**-68
"""By how much the box is grown, so that a ray along its side is inside. `accel.bvh` grows boxes by more.

It is 2**-100 of a scene that `accel.space.scale_of` has scaled: a part of a rounding of triangles 10**21 times smaller.
"""
PLANE = 64.0
"""Factor by which the error bound of the distance from the corners must exceed that of the distance from the plane."""
EDGE_ON = 2.0**24
"""1 / slope at which a triangle is seen so nearly edge-on that a mean of its corners may be anywhere between them."""


class CandidateHit(NamedTuple):
    """A point of a triangle that may become a hit, by the names of a `RayHit`."""

    id: Any
    uv: Any
    instance: Any = None


Accept = Callable[[CandidateHit], Any]
"""A filter of candidates: tells which of the points that a ray meets become hits."""


class RayHit:
    """The nearest hit so far: distance `l`, barycentric `uv` of corners 1 and 2, and triangle `id`, -1 for none.

    `kernels.queries` has other classes with this interface: a walk searches up to the distance `l`, reads `id`, and
    offers each triangle that the ray meets. With `accept` only points that pass this filter become hits. `sample` is
    the number of the shaded sample of a layered depth cube, -1 for no sample; None where no cube is shaded. `instance`
    is that of the triangle, and `inside` the one in which the walk is; None for triangles in the scene's coordinates.
    """

    sample: Any = None
    instance: Any = None
    inside: Any = None

    def __init__(self, limit: Any, accept: Accept | None = None) -> None:
        l = sh.Attrib1f(limit)  # noqa: E741 - the paper's name
        uv = sh.TexCoord2f(0, 0)
        id = sh.Attrib1i(-1)
        self.l, self.uv, self.id, self.accept = l, uv, id, accept

    @classmethod
    def held_in(cls, place: Any, accept: Accept | None = None) -> RayHit:
        """Return the hit whose variables are those of `place`."""
        hit = cls.__new__(cls)
        hit.l, hit.uv, hit.id, hit.accept = place.l, place.uv, place.id, accept
        return hit

    @property
    def parts(self) -> tuple[Any, ...]:
        """The variables that say what was hit, and where."""
        return self.l, self.id, self.uv

    @property
    def in_scene(self) -> tuple[Any, Any]:
        """The number of the triangle among those of all meshes, and the weights of its corners 1 and 2 there."""
        return self.id, self.uv

    def offer(self, met: Any, t: Any, number: Any, weights: Sequence[Any]) -> None:
        """Take the triangle `number` if it is `met` at a distance `t` less than `l`.

        Of triangles at the same distance the lowest number is taken, whichever is offered first. `weights` are those of
        corners 1 and 2, and the sum of all three.
        """
        with (
            SH_IF(met & ((t < self.l) | ((t == self.l) & (number < self.id)))),
            self.accepting(number, weights),
        ):
            wb, wc, whole = weights
            self.l[:] = t
            self.uv[:] = sh.TexCoord2f(wb, wc) / whole
            self.id[:] = number

    def accepting(self, number: Any, weights: Sequence[Any]) -> AbstractContextManager[Any]:
        """Open a branch for the points that pass the filter; open none without a filter."""
        if self.accept is None:
            return nullcontext()
        wb, wc, whole = weights
        return SH_IF(self.accept(CandidateHit(number, sh.TexCoord2f(wb, wc) / whole, self.inside)))


class Place:
    """An entry of a list of hits: distance, weights, triangle (-1 if empty), and its surface.

    `placed` are the instance of the triangle and its place in the order of all; without them that is its number.
    """

    def __init__(self, l: Any, uv: Any, id: Any, surface: Any, *placed: Any) -> None:  # noqa: E741 - as in RayHit
        self.parts = l, uv, id, surface, *placed
        self.l, self.uv, self.id, self.surface = l, uv, id, surface
        self.instance, self.order = placed or (None, id)

    def take(self, other: Place) -> None:
        """Become equal to another one."""
        for part, value in zip(self.parts, other.parts, strict=True):
            part[:] = value

    def copy(self) -> Place:
        """Return a copy, of variables without a name."""
        return Place(*(part.copy() for part in self.parts))


class TouchingHit(RayHit):
    """A `RayHit`, and the nearest hits of `count` other surfaces, in `others`, by their distance.

    Surfaces differ where `surface_of(number, ray)` does; `surface` is the nearest one's. A walk offers all that lies
    within the part `REACH` behind the nearest hit, so those within less than that are the same in whatever order it
    goes.
    """

    def __init__(
        self, limit: Any, accept: Accept | None, surface_of: Callable[[Any, Any], Any], ray: Any, count: int
    ) -> None:
        super().__init__(limit, accept)
        self.surface_of, self.ray = surface_of, ray
        surface = sh.Attrib1i(0)
        self.surface = surface
        self.others = [
            Place(sh.Attrib1f(limit), sh.TexCoord2f(0, 0), sh.Attrib1i(-1), sh.Attrib1i(0), *self.blank_place())
            for _ in range(count)
        ]

    @property
    def places(self) -> list[Place]:
        """The nearest hit and the others."""
        return [Place(self.l, self.uv, self.id, self.surface), *self.others]

    def anew(self, limit: Any, ray: Any) -> TouchingHit:
        """Return a hit of the same kind for a search at distances less than `limit`."""
        return TouchingHit(limit, self.accept, self.surface_of, ray, len(self.others))

    def blank_place(self) -> tuple[Any, ...]:
        """Return variables for what `placed` gives."""
        return ()

    def placed(self, number: Any) -> tuple[Any, ...]:
        """Return the instance of a triangle and its place in the order of all triangles, of a hit in two levels."""
        return ()

    def offer(self, met: Any, t: Any, number: Any, weights: Sequence[Any]) -> None:
        """Take the triangle `number` into the list, which has one hit of each surface, the nearest."""
        last, where = self.others[-1], self.placed(number)
        before_last = (t < last.l) | ((t == last.l) & ((where[1] if where else number) < last.order))
        with SH_IF(met & before_last & (t <= farther(self.l))), self.accepting(number, weights):
            wb, wc, whole = weights
            surface = sh.Attrib1i(self.surface_of(number, self.ray))
            carried = Place(sh.Attrib1f(t), sh.TexCoord2f(wb, wc) / whole, sh.Attrib1i(number), surface, *where).copy()
            moved, placed = sh.Attrib1b(False), sh.Attrib1b(False)
            for place in self.places:
                nearer = (carried.l < place.l) | ((carried.l == place.l) & (carried.order < place.order))
                same = ((place.surface == surface) & (place.id >= 0)).copy()
                with SH_IF(~placed & (moved | (place.id < 0) | nearer)):
                    moved[:] = True
                    displaced = place.copy()
                    place.take(carried)
                    carried.take(displaced)
                placed |= same


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
        self.growth = [GROWTH * abs(inverse) for inverse in self.inverse]
        self.ray = self.turned(ray)
        x, y, self.pace = self.ray
        self.slope = (x / self.pace, y / self.pace)

    def turned(self, v: Any) -> tuple[Any, Any, Any]:
        """Return the components of a vector along x, y and z as they are turned."""
        x, y = sh.cond(self.by_x, v[1], v[0]), sh.cond(self.by_xy, v[2], v[1])
        return x, y, sh.cond(self.by_x, v[0], sh.cond(self.by_xy, v[1], v[2]))

    def straight(self, v: Sequence[Any]) -> list[Any]:
        """Return the components along x, y and z of a vector that `turned` gave."""
        y = sh.cond(self.by_x, v[0], sh.cond(self.by_xy, v[2], v[1]))
        return [sh.cond(self.by_x, v[2], v[0]), y, sh.cond(self.by_xy, v[1], v[2])]

    def edges(self, a: Any, b: Any, c: Any) -> tuple[Any, Any, Any]:
        """Return the edge functions of a triangle opposite to its corners, which are relative to the ray's origin."""
        (ax, ay), (bx, by), (cx, cy) = map(self.project, (a, b, c))
        return bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx

    def project(self, p: Any) -> tuple[Any, Any]:
        """Project a point, relative to the ray's origin, along the ray."""
        return p[0] - self.slope[0] * p[2], p[1] - self.slope[1] * p[2]

    def distance(self, weights: Sequence[Any], whole: Any, depths: Sequence[Any], plane: PlaneView) -> Any:
        """Return the distance to a mean of corners with these depths along z; `whole` is the sum of their weights."""
        t = product(weights, depths) / (whole * self.pace)
        return plane.improve(t, highest(*(abs(depth) for depth in depths)))

    def span(self, a: Any, b: Any, c: Any) -> tuple[Any, Any]:
        """Return the distances at which a ray enters and leaves the box round a triangle; leave < enter for a miss."""
        sides = [[corner[k] * self.inverse[k] for corner in (a, b, c)] for k in range(3)]
        enter = highest(*(lowest(*side) - growth for side, growth in zip(sides, self.growth, strict=True)))
        leave = lowest(*(highest(*side) + growth for side, growth in zip(sides, self.growth, strict=True)))
        return enter, leave


class Triangles:
    """Triangles as tables: `rows` (see `triangle_rows`), and `levels`, how far each one's plane is from 0.

    `numbers` is the table of their numbers, if these are not their places. `levels` are computed from
    `rows` if they are not given. `given` are the arrays of which the tables were made. With `copy=False` the table
    shares `rows`, which are read-only (see `sh.Table`); levels are always shared. `instances` are the places of
    triangles whose rows are in coordinates of their own, None where none are.
    """

    def __init__(
        self,
        rows: NDArray[Any],
        name: str = "triangles",
        numbers: Any = None,
        levels: NDArray[np.float64] | None = None,
        *,
        copy: bool = True,
    ) -> None:
        self.sources = rows, constant(self.levels_in(rows) if levels is None else levels)
        self.rows = sh.Table(rows, sh.Attrib4f, name, copy=copy, unique=False)
        self.levels = sh.Table(self.sources[1], sh.Attrib1f, f"levels_of_{name}", copy=False, unique=False)
        self.numbers = numbers
        self.instances: Any = None

    @classmethod
    def of(cls, triangles: NDArray[Any] | Triangles, dtype: DTypeLike = np.float64) -> Triangles:
        """Return tables of `triangles` (see `triangle_rows`) for kernels that work in `dtype`, or the tables given.

        Walks through the same triangles share them.
        """
        if isinstance(triangles, Triangles):
            return triangles
        levels = cls.levels_in(triangles)
        if dtype == np.float32 and triangles.dtype != np.float32:
            return cls(constant(triangles.astype(np.float32)), levels=levels, copy=False)  # half the memory
        return cls(triangles, levels=levels)

    @staticmethod
    def levels_in(rows: NDArray[Any]) -> NDArray[np.float64]:
        """Return how far the planes of the triangles in `rows` are from 0."""
        levels = np.empty(len(rows) // 3)
        for part in parts(len(levels)):
            wide_rows = rows.reshape(-1, 3, 4)[part].astype(np.float64, copy=False)
            corners = wide_rows[..., :3]
            # Rounding rows to another precision keeps corners, which are exact in it, but not normals.
            levels[part] = levels_of(corners, wide_rows[..., 3] if rows.dtype == np.float64 else normals_of(corners))
        return levels

    def renew(self, rows: NDArray[Any], levels: NDArray[np.float64], first: int) -> None:
        """Replace the triangles from the place `first` on; `levels` are those in `rows`."""
        self.rows.update(rows, start=3 * first)
        self.levels.update(levels, start=first)

    def __getitem__(self, k: Any) -> list[Any]:
        """Return the three rows of triangle `k`."""
        return [self.rows[3 * k + corner] for corner in range(3)]

    def plane(self, k: Any, rows: Sequence[Any], ray: Any, eye: Any) -> tuple[Sequence[Any], PlaneView]:
        """Return the unit normal of triangle `k`, whose rows these are, and its plane as a ray sees it."""
        normal = [row.w for row in rows]
        plane = PlaneView(normal, self.levels[k], ray, eye)
        return normal, plane

    def corners_of(self, hit: Any) -> Sequence[Any]:
        """Return the rows of the triangle that was hit, in the scene's coordinates."""
        rows = self[hit.id]
        if self.instances is None or hit.instance is None:
            return rows
        placement = self.instances[hit.instance]
        normal = placement.normal([row.w for row in rows])
        return [sh.Attrib4f(placement.point(row), normal[axis]) for axis, row in enumerate(rows)]

    def plane_of(self, hit: Any, face: Any, ray: Any, eye: Any) -> PlaneView:
        """Return the plane of the triangle that was hit, whose unit normal is `face`, as a ray sees it."""
        if self.instances is None or hit.instance is None:
            plane = PlaneView(face, self.levels[hit.id], ray, eye)
            return plane
        normal = [row.w for row in self[hit.id]]
        _, placed = self.instances[hit.instance].plane(normal, self.levels[hit.id], ray, eye)
        return cast(PlaneView, placed)

    def number(self, k: Any) -> Any:
        """Return the number of the triangle at place `k`."""
        return k if self.numbers is None else self.numbers[k]


class PlaneView:
    """A triangle's plane as a ray sees it, from its unit normal and its level, given by components.

    `slope` is how fast the ray comes nearer to it, `height` how far the eye is from it, both along the normal; `pace`
    and `size` are what their roundings are parts of. `beside`, a part of `size`, is for corners of an instance, which
    are rounded by themselves; None for others.
    """

    def __init__(self, normal: Sequence[Any], level: Any, ray: Any, eye: Any, beside: Any = None) -> None:
        self.slope = product(normal, ray)
        self.height = level - product(normal, eye)
        size = [abs(n) for n in normal]
        self.pace = product(size, [abs(ray[k]) for k in range(3)])
        self.size = abs(level) + product(size, [abs(eye[k]) for k in range(3)])
        self.beside = beside
        if beside is not None:
            self.size = self.size + beside

    def improve(self, t: Any, large: Any) -> Any:
        """Return the distance to the plane; or `t`, a mean of corners within `large`, if that is not far worse."""
        return sh.cond(self.is_better(t, large), self.height / self.slope, t)

    def is_better(self, t: Any, large: Any) -> Any:
        """Return whether the distance to the plane, about `t`, is known far better than a mean of corners.

        Both errors grow as 1 / slope: roundings of `error_at(t)`, and of the corners' largest coordinate `large`.
        A mean stays between its corners, however, so the plane must also be known better than that.
        """
        return PLANE * self.error_at(t) < large * lower(abs(self.slope) * rounded(EDGE_ON), 1.0)

    def error_at(self, t: Any) -> Any:
        """Return the distance, in roundings, by which the ray's point at `t` may seem to be off the plane."""
        return self.size + abs(t) * self.pace


class Walk(ABC):
    """The walk that finds a ray's hit among `triangles`, at points that pass the filter `accept`."""

    triangles: Triangles
    bound: AheadBound | None = None
    accept: Accept | None = None

    def bounded(self, bound: AheadBound | None) -> Self:
        """Return the walk through the same tables with another bound of rays that may start from a triangle."""
        walk = copy(self)
        walk.bound = bound
        return walk

    def __call__(self, ray: Any, eye: Any, near: Any, limit: Any, any_hit: Any) -> RayHit:
        """Find the nearest hit at a distance in [near, limit); where `any_hit` holds, the first that is found."""
        hit = self.hit_before(limit)
        self.collect(hit, ray, eye, near, near, any_hit)
        return hit

    def hit_before(self, limit: Any) -> RayHit:
        """Return a hit to be searched at distances less than `limit`."""
        return RayHit(limit, self.accept)

    def place(self, levels: Any) -> bool:
        """Update the tables of instances that have moved; return whether they fit, as none does in one level."""
        return False

    @abstractmethod
    def collect(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        """Offer to `hit` each triangle that is met at a distance in [near, hit.l), boxes from `begin` on."""


class TriangleTest:
    """The constants of a ray for tests against many triangles; `bound` is for rays that may start from one."""

    def __init__(self, ray: Any, eye: Any, bound: AheadBound | None = None) -> None:
        self.sight, self.bound = Sight(ray, eye), bound
        self.ray, self.eye = ray, eye

    def __call__(self, triangles: Triangles, k: Any, near: Any, hit: RayHit) -> None:
        """Offer the triangle at place `k` to `hit`, which takes it if the ray meets it at a distance in [near, hit.l).

        A triangle that has no area as the ray sees it is never met.
        """
        sight = self.sight
        rows = triangles[k]
        a, b, c = ([part - eye for part, eye in zip(sight.turned(row), sight.eye, strict=True)] for row in rows)
        wa, wb, wc = sight.edges(a, b, c)
        whole = wa + wb + wc
        with SH_IF(same_side(wa, wb, wc) & (whole != 0)):
            normal, plane = triangles.plane(k, rows, self.ray, self.eye)
            enter, leave = sight.span(a, b, c)
            t = within(enter, leave, sight.distance((wa, wb, wc), whole, (a[2], b[2], c[2]), plane))
            met = (t >= near) & meets(enter, leave, near)
            if self.bound is not None:
                met &= self.bound(plane, normal, rows[0].xyz - self.eye)
            hit.offer(met, t, triangles.number(k), (wb, wc, whole))


@dataclass(frozen=True)
class AheadBound:
    """Tells which planes lie ahead beyond doubt: a ray of unit length at most that starts from one is not on it.

    `roundoff` is the largest relative error of one rounding. `start` is how far an origin may be off its triangle's
    plane, in roundings of the plane's level and the origin; 0 if it is known to lie outside.
    """

    roundoff: float
    start: float = 0.0

    def __call__(self, plane: PlaneView, normal: Sequence[Any], corner: Any) -> Any:
        """Return whether a plane lies ahead in spite of rounding, as one of its corners or its level says.

        `corner` is relative to the ray's origin. Both products have five roundings at most: of the corner's difference
        from the eye, or of the level and of the difference from it; of the normal, of the product and of two sums. Of
        the slope, where no factor is larger than 1, that is less than 6 roundings of 1. The distance to a corner says
        nothing of an origin that is itself rounded.
        """
        doubt = 6 * self.roundoff
        away = product(normal, corner)
        size = product([abs(n) for n in normal], [abs(corner[k]) for k in range(3)])
        if plane.beside is not None:
            size = size + plane.beside
        toward = sh.cond(plane.slope < 0, -1.0, 1.0)
        if self.start:
            ahead = toward * plane.height > (doubt + self.start * self.roundoff) * plane.size
        else:
            ahead = (toward * away > doubt * size) | (toward * plane.height > doubt * plane.size)
        return ahead & (abs(plane.slope) > doubt)


def meets(enter: Any, leave: Any, near: Any) -> Any:
    """Return whether a ray meets a triangle's box, which it enters and leaves here, beyond `near` or close to it."""
    enter = higher(near, enter)
    return enter - BESIDE * abs(enter) <= leave


def within(enter: Any, leave: Any, t: Any) -> Any:
    """Return the distance `t` of a hit, or the end of its box that it exceeds by more than the part `REACH / 2`."""
    return higher(lower(t, leave + (REACH / 2) * abs(leave)), enter - (REACH / 2) * abs(enter))


def product(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Return the scalar product of vectors that are given by components."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def same_side(a: Any, b: Any, c: Any) -> Any:
    """Return True if no two of the numbers, which are never NaN, have opposite signs."""
    return (lowest(a, b, c) >= 0) | (highest(a, b, c) <= 0)


def is_ray(ray: Any, eye: Any) -> Any:
    """Return True for a direction and a place: finite numbers, and a direction that is not zero."""
    along = abs(ray.x) + abs(ray.y) + abs(ray.z)
    return (along > 0) & (along + (abs(eye.x) + abs(eye.y) + abs(eye.z)) <= far())


def inverse_of(ray: Any) -> Any:
    """Return 1 / ray by component, FAR where a component is too small for that: 0 times it is 0."""
    return sh.clamp(1 / ray, -far(sh.Attrib3u), far(sh.Attrib3u))


def farther(distance: Any) -> Any:
    """Return the distance up to which boxes must be visited when the nearest hit is at this distance."""
    return distance + REACH * abs(distance)
