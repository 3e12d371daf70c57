"""The medium in which a ray is: it travels with the ray, is set on entering a body and restored on leaving it.

Stage: kernel. A ray knows the numbers of the bodies that hold it, in as many registers as the scene's bodies can need
(`scene.bodies`). Of them the one of the largest number, the innermost, is its medium. So the order in which bodies are
entered and left does not matter, and where two overlap, one of them is there, as in Schmidt and Budge 2002, Simple
nested dielectrics in ray traced images. What is hit tells for certain on which side of its own body the ray was: by
that a ray corrects what rounding, or an open mesh, has made wrong.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import shpy as sh
from raytracer.accel.bounds import far
from raytracer.kernels.triangle import RayHit
from raytracer.kernels.walk import meet_first
from raytracer.scene.bodies import Bodies
from shpy import SH_DO, SH_IF, SH_UNTIL


class Held:
    """The bodies that hold a ray: their numbers, 0 in the `slots` that are free."""

    def __init__(self, slots: list[Any]) -> None:
        self.slots = slots

    def take(self, other: Held) -> None:
        """Become equal to another one."""
        for slot, value in zip(self.slots, other.slots, strict=True):
            slot[:] = value

    def innermost(self, without: Any = None) -> Any:
        """Return the innermost body, of those but `without`."""
        found: Any = 0
        for slot in self.slots:
            found = sh.max(found, slot if without is None else sh.cond(slot == without, 0, slot))
        return found

    def put(self, body: Any, inside: Any) -> None:
        """Let the ray be inside a body, or outside; 0 is none. Of too many bodies the last slot forgets one."""
        missing = sh.Attrib1b(inside & (body > 0))
        for slot in self.slots:
            slot[:] = sh.cond(slot == body, 0, slot)
        for slot in self.slots[:-1]:
            here = missing & (slot == 0)
            slot[:] = sh.cond(here, body, slot)
            missing &= ~here
        self.slots[-1][:] = sh.cond(missing, body, self.slots[-1])


class Media:
    """The tables of bodies, and what they do to rays.

    `start` are the Params of the bodies that hold the eye, or the point `reference` where rays of a picture start in
    several media: `wades` says so, and an eye ray goes from there to its own origin first.
    """

    def __init__(self, bodies: Bodies, scale: Any) -> None:
        self.bodies, self.scale = bodies, scale
        self.rows = sh.Table(bodies.rows, sh.Attrib4f, "media")
        self.body_of = sh.Table(bodies.body_of, sh.Attrib1i, "body_of")
        self.start = [sh.Param(sh.Attrib1i, 0, name=f"eye_body_{k}") for k in range(bodies.slots)]
        self.reference = sh.Param(sh.Point3f, (0, 0, 0), name="reference")
        self.wades = False

    def renew(self, bodies: Bodies) -> None:
        """Take other bodies, as many of them, after objects have moved or materials changed."""
        if not np.array_equal(bodies.body_of, self.bodies.body_of):
            self.body_of.update(bodies.body_of)
        if not np.array_equal(bodies.rows, self.bodies.rows):
            self.rows.update(bodies.rows)
        self.bodies = bodies

    def suit(self, bodies: Bodies | None) -> bool:
        """Return whether `renew` can take other bodies."""
        if bodies is None:
            return False
        return bodies.slots <= self.bodies.slots and bodies.rows.shape == self.bodies.rows.shape

    def look_from(self, middle: Any, half: Any) -> None:
        """Set the bodies in which eye rays start; their origins lie in a box round `middle`, `half` to each side."""
        around = self.bodies.around(np.asarray(middle, np.float64))[: len(self.start)]
        for start, body in zip(self.start, [*around, *[0] * len(self.start)], strict=False):
            start.value = body
        self.wades = bool(np.any(half)) and self.bodies.cut(middle - half, middle + half)
        if self.wades:
            self.reference.value = middle

    def held(self) -> Held:
        """Return the variables of a ray that is in no body."""
        return Held([sh.Attrib1i(0) for _ in range(self.bodies.slots)])

    def of_rays(self, waiting: int) -> tuple[Held, Held, list[Any]]:
        """Return the bodies of a ray and of its shadow ray, and for each slot an array for those of rays that wait."""
        return self.held(), self.held(), [sh.Array(sh.Attrib1i, waiting) for _ in range(self.bodies.slots)]

    def begin(self, held: Held, surfaces: Any, walk: Any, eye: Any) -> None:
        """Let `held` be the bodies in which an eye ray from `eye` starts."""
        for slot, start in zip(held.slots, self.start, strict=True):
            slot[:] = start
        if not self.wades:
            return
        place = sh.Point3f(self.reference)
        way = eye - place
        left = sh.Attrib1f(sh.length(way))
        ray = sh.Vector3f(sh.cond(left > 0, way / left, sh.Vector3f(0, 0, 1)))
        with SH_DO():
            hit = meet_first(walk, ray, place, left)
            with SH_IF(hit.id >= 0):
                held.put(self.body_of[hit.id], ~surfaces.comes_from_inside(hit, ray))
                place[:] = surfaces.behind(hit, ray, place)
            left[:] = sh.cond(hit.id >= 0, left - hit.l, 0.0)
            SH_UNTIL(left <= 0)

    def reach(self, held: Held, hit: RayHit, outside: Any) -> tuple[Any, Any, Any]:
        """Correct `held` by a hit of a body's surface from `outside`, or from inside.

        Return the share of light that the way to the hit has left; the body; and the body around its surface there.
        """
        body = self.body_of[hit.id]
        around = held.innermost(without=body) if len(self.start) > 1 else 0
        held.put(body, ~outside)
        return self.kept(held, hit.l), body, around

    def ratio(self, ior: Any, body: Any, around: Any) -> Any:
        """Return the refractive index of a surface's body, `ior`, to that around it; 1 where both are hidden."""
        if len(self.start) == 1:
            return ior
        return sh.cond(body > around, ior / self.rows[around].a, 1.0)

    def kept(self, held: Held, way: Any) -> Any:
        """Return the share (r, g, b) of light that a way in the ray's medium leaves, by Beer's law."""
        return sh.exp(-(way / self.scale) * self.rows[held.innermost()].rgb)

    def kept_to_light(self, held: Held, way: Any) -> Any:
        """Return the same of the way to a light; nothing is lost to one that is infinitely far, beyond all bodies."""
        return sh.cond(way < far(), self.kept(held, way), sh.Color3f(1, 1, 1))
