"""The ways to keep more than the nearest hit of a ray: their number, or some that follow one another.

Stage: kernel. A walk offers them the triangles that are met, as it does to `triangle.RayHit`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import shpy as sh
from shpy import SH_IF


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
            for held, variable in zip(self.columns, (distance, taken, u, v), strict=True):
                held.append(variable)
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
                # What stands before it moves up where the new hit comes before that, too.
                ahead = self.is_before(t, number, place - 1) if place else False
                for held, new in zip(self.columns, found, strict=True):
                    moved = sh.cond(ahead, held[place - 1], new) if place else new
                    held[place][:] = sh.cond(here, moved, held[place])

    def is_before(self, t: Any, number: Any, place: int) -> Any:
        """Return whether a hit comes before the one at `place`; a free place is at the limit."""
        return (t < self.t[place]) | ((t == self.t[place]) & (number < self.id_of[place]))
