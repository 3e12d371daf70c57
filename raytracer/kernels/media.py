"""The medium in which a ray is: it travels with the ray, is set on entering a body and restored on leaving it.

Stage: kernel. A ray knows the numbers of the bodies that hold it, in as many registers as the scene's bodies can need
(`scene.bodies`). Of them the one of the largest number, the innermost, is its medium. So the order in which bodies are
entered and left does not matter, and where two overlap, one of them is there, as in Schmidt and Budge 2002, Simple
nested dielectrics in ray traced images. What is hit tells for certain on which side of its own body the ray was: by
that a ray corrects what rounding, or an open mesh, has made wrong.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import shpy as sh
from raytracer.accel.bounds import far
from raytracer.kernels.instances import TouchingInstanceHit
from raytracer.kernels.triangle import AheadBound, CandidateHit, RayHit, TouchingHit, Triangles
from raytracer.scene.bodies import Bodies
from raytracer.scene.layout import Change
from shpy import SH_DO, SH_IF, SH_UNTIL

MOST_TOUCHING = 3
"""Surfaces that may touch another one at a place and are seen there."""
TOUCHING = 2.0**-12
"""The part of its distance by which a hit can be farther than another one and be taken for the same place."""


class RayBodies:
    """The bodies that hold a ray: their numbers, 0 in the `slots` that are free.

    `beyond`, if it is there, are those behind the surface that the ray hit last.
    """

    def __init__(self, slots: list[Any], beyond: RayBodies | None = None) -> None:
        self.slots, self.beyond = slots, beyond

    def take(self, other: RayBodies) -> None:
        """Become equal to another one."""
        for slot, value in zip(self.slots, other.slots, strict=True):
            slot[:] = value

    def cross(self) -> None:
        """Go through the surface that the ray hit last."""
        assert self.beyond is not None
        self.take(self.beyond)

    def innermost(self) -> Any:
        """Return the innermost body, 0 for the empty space around all."""
        first, *others = self.slots
        for slot in others:
            first = sh.max(first, slot)
        return first

    def put(self, body: Any, inside: Any) -> None:
        """Mark the ray as inside or outside a body (0: no body). With too many bodies, the last slot is overwritten."""
        missing = inside & (body > 0)
        for slot in self.slots:
            slot[:] = sh.cond(slot == body, 0, slot)
        for slot in self.slots[:-1]:
            here = missing & (slot == 0)
            slot[:] = sh.cond(here, body, slot)
            missing = missing & ~here
        self.slots[-1][:] = sh.cond(missing, body, self.slots[-1])


class Media:
    """The tables of bodies, and their effect on rays.

    `start` are the Params of the bodies that hold the eye, or the point `reference` where rays of a picture start in
    several media: `wades` says so, and an eye ray goes from there to its own origin first.
    """

    def __init__(self, bodies: Bodies, triangles: Triangles, scale: Any, roundoff: float) -> None:
        self.bodies, self.triangles, self.scale = bodies, triangles, scale
        self.ahead = AheadBound(roundoff)
        self.rows = sh.Table(bodies.rows, sh.Attrib4f, "media")
        self.body_of = sh.Table(bodies.body_of, sh.Attrib1i, "body_of")
        self.start = [sh.Param(sh.Attrib1i, 0, name=f"eye_body_{k}") for k in range(bodies.slots)]
        self.reference = sh.Param(sh.Point3f, (0, 0, 0), name="reference")
        self.touches = bodies.touches
        self.wades = False

    def renew(self, bodies: Bodies) -> None:
        """Take other bodies, as many of them, after objects have moved or materials changed."""
        if not np.array_equal(bodies.body_of, self.bodies.body_of):
            self.body_of.update(bodies.body_of)
        if not np.array_equal(bodies.rows, self.bodies.rows):
            self.rows.update(bodies.rows)
        self.bodies = bodies

    def take(self, bodies: Bodies) -> bool:
        """Take other bodies; return False, having changed nothing, where they need another kernel."""
        suits = self.suit(bodies)
        if suits:
            self.renew(bodies)
        return suits

    def heeds(self, changes: Sequence[Change]) -> bool:
        """Return whether bodies can differ after changes of triangles."""
        return not self.touches or any(self.bodies.has(change.first, change.past) for change in changes)

    def suit(self, bodies: Bodies | None) -> bool:
        """Return whether `renew` can take other bodies."""
        if bodies is None:
            return False
        fits = len(self.start) >= bodies.slots and self.touches >= bodies.touches
        return fits and bodies.rows.shape == self.bodies.rows.shape

    def look_from(self, middle: Any, half: Any) -> None:
        """Set the bodies in which eye rays start; their origins lie in a box round `middle`, `half` to each side."""
        around = self.bodies.around(np.asarray(middle, np.float64))[: len(self.start)]
        for start, body in zip(self.start, [*around, *[0] * len(self.start)], strict=False):
            start.value = body
        self.wades = bool(np.any(half)) and self.bodies.cut(middle - half, middle + half)
        if self.wades:
            self.reference.value = middle

    def make_ray_bodies(self) -> RayBodies:
        """Return the variables of a ray that is in no body."""
        slots, beyond = ([sh.Attrib1i(0) for _ in self.start] for _ in range(2))
        return RayBodies(slots, RayBodies(beyond))

    def of_rays(self, waiting: int) -> tuple[RayBodies, RayBodies, list[Any]]:
        """Return the bodies of a ray and of its shadow ray, and for each slot an array for those of rays that wait."""
        waiting_bodies = [sh.Array(sh.Attrib1i, waiting) for _ in self.start]
        return self.make_ray_bodies(), self.make_ray_bodies(), waiting_bodies

    def surface_of(self, number: Any, ray: Any) -> Any:
        """Return twice the body to whose surface a triangle belongs, and 1 more where the ray leaves it."""
        face = sh.Vector3f(*(row.w for row in self.triangles[number]))
        return 2 * self.body_of[number] + sh.cond(sh.dot(face, ray) > 0, 1, 0)

    def touching(self, limit: Any, ray: Any, accept: Any) -> TouchingHit:
        """Return the hit of a ray that searches for surfaces in contact with the nearest one."""
        arguments = limit, accept, self.surface_of, ray, min(len(self.start), MOST_TOUCHING)
        if self.triangles.instances is None:
            return TouchingHit(*arguments)
        return TouchingInstanceHit(self.triangles.instances, *arguments)

    def merge(self, hit: RayHit, ray: Any, behind: Callable[[], Any]) -> None:
        """Keep the other surfaces of a hit that touch the nearest one, and forget those that do not.

        A ray that continues from the nearest surface, at `behind()`, would miss them. An opaque surface takes
        precedence.
        """
        if not isinstance(hit, TouchingHit):
            return
        reach, clear = hit.l + TOUCHING * hit.l, hit.surface >= 0
        near = [(other.id >= 0) & clear & (other.l <= reach) for other in hit.others]
        together = [sh.Attrib1b(False) for _ in hit.others]
        with SH_IF(functools.reduce(operator.or_, near)):
            place = behind()
            for other, is_near, touches in zip(hit.others, near, together, strict=True):
                instance = None if other.instance is None else sh.max(other.instance, 0)
                candidate = CandidateHit(sh.max(other.id, 0), other.uv, instance)
                rows = self.triangles.corners_of(candidate)
                normal = [row.w for row in rows]
                plane = self.triangles.plane_of(candidate, normal, ray, place)
                touches[:] = is_near & ~self.ahead(plane, normal, rows[0].xyz - place)
        for other, touches in zip(hit.others, together, strict=True):
            with SH_IF(touches & (other.surface < 0) & (hit.surface >= 0)):
                hit.places[0].take(other)
            other.surface[:] = sh.cond(touches & (other.surface > 0), other.surface, 0)

    def begin(self, ray_bodies: RayBodies, meet: Callable[..., RayHit], behind: Callable[..., Any], eye: Any) -> None:
        """Let `ray_bodies` be the bodies in which an eye ray from `eye` starts.

        `meet(ray, eye, limit)` finds a hit, and `behind(hit, ray, eye)` is where the ray goes on.
        """
        for slot, start in zip(ray_bodies.slots, self.start, strict=True):
            slot[:] = start
        if not self.wades:
            return
        place = sh.Point3f(self.reference)
        way = eye - place
        left = sh.Attrib1f(sh.length(way))
        ray = sh.Vector3f(sh.cond(left > 0, way / left, sh.Vector3f(0, 0, 1)))
        with SH_DO():
            hit = meet(ray, place, left)
            with SH_IF(hit.id >= 0):
                self.reach(ray_bodies, hit, (self.surface_of(hit.id, ray) & 1) == 0, 1.0)
                ray_bodies.cross()
                place[:] = behind(hit, ray, place)
            left[:] = sh.cond(hit.id >= 0, left - hit.l, 0.0)
            SH_UNTIL(left <= 0)

    def reach(self, ray_bodies: RayBodies, hit: RayHit, outside: Any, ior: Any) -> tuple[Any, Any]:
        """Take in a hit of a surface from `outside`, or from inside, whose body has the refractive index `ior`.

        `ray_bodies` is corrected by it. Return the share of light that the way to the hit has left, and the refractive
        index inside relative to that outside: 1 where the medium does not change.
        """
        if isinstance(hit, TouchingHit):
            body, others = sh.max(hit.surface >> 1, 0), [other.surface for other in hit.others]
        else:
            body, others = sh.max(self.body_of[hit.id], 0), []
        ray_bodies.put(body, ~outside)
        for other in others:
            ray_bodies.put(sh.cond(other >> 1 == body, 0, other >> 1), (other & 1) == 1)
        assert ray_bodies.beyond is not None
        ray_bodies.beyond.take(ray_bodies)
        ray_bodies.beyond.put(body, outside)
        for other in others:
            ray_bodies.beyond.put(other >> 1, (other & 1) == 0)
        before, after = (self.index_in(part.innermost(), body, ior) for part in (ray_bodies, ray_bodies.beyond))
        return self.kept(ray_bodies, hit.l), sh.cond(outside, after / before, before / after)

    def index_in(self, medium: Any, body: Any, ior: Any) -> Any:
        """Return the refractive index of a medium: `ior` for the body that was hit, as a program may say it."""
        return sh.cond(medium == body, sh.cond(body > 0, ior, 1.0), self.rows[medium].a)

    def kept(self, ray_bodies: RayBodies, way: Any) -> Any:
        """Return the share (r, g, b) of light that a way in the ray's medium leaves, by Beer's law."""
        return sh.exp(-(way / self.scale) * self.rows[ray_bodies.innermost()].rgb)

    def kept_to_light(self, ray_bodies: RayBodies, way: Any) -> Any:
        """Return the same of the way to a light; nothing is lost to one that is infinitely far, beyond all bodies."""
        return sh.cond(way < far(), self.kept(ray_bodies, way), sh.Color3f(1, 1, 1))
