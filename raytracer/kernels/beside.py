"""The walk through a grid of what stands still, beside the hierarchy of the objects that move.

Stage: kernel. Future work of Moreno-Fortuny and McCool ("separate accelerators for the static and dynamic parts of the
scene") and of Christen 2005, section 6.4. A ray tries the objects first, and then only the cells up to its nearest hit.
Of triangles at the same distance the one of the lowest number is hit, so the order makes no difference to what is hit.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any, Self

import shpy as sh
from raytracer.accel.forest import Forest
from raytracer.accel.grid import Grid
from raytracer.kernels.bvh_walk import BvhIntersector
from raytracer.kernels.grid_walk import GridIntersector
from raytracer.kernels.triangle import AheadBound, Triangles, Walk
from raytracer.scene.layout import Change
from shpy import SH_IF


class GridBeside(Walk):
    """The walks `grid` and `objects` over the same `triangles` (see `triangle_rows`).

    `forest` holds the hierarchies of the moving objects alone; `together` is that of `BvhIntersector`.
    """

    def __init__(self, grid: Grid, forest: Forest, triangles: Any, together: bool, bound: AheadBound | None) -> None:
        self.bound = bound
        self.triangles = Triangles.of(triangles, forest.dtype)
        self.grid = GridIntersector(grid, self.triangles, bound)
        # `items` are those of the hierarchy.
        self.grid.items = sh.Table(grid.items, sh.Attrib1i, "listed", unique=False)
        self.objects = BvhIntersector(forest.bvh, self.triangles, together, bound)

    def bounded(self, bound: AheadBound | None) -> Self:
        """Return the walk through the same tables with another bound of rays that may start from a triangle."""
        walk = copy(self)
        walk.bound = bound
        walk.grid, walk.objects = self.grid.bounded(bound), self.objects.bounded(bound)
        return walk

    def renew(self, forest: Forest, changes: Sequence[Change]) -> None:
        """Update the parts of the tables that changed; see `BvhIntersector.renew`."""
        self.objects.renew(forest, changes)

    def collect(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        """Offer to `hit` each triangle that is met at a distance in [near, hit.l), boxes and cells from `begin` on."""
        self.objects.collect(hit, ray, eye, near, begin, any_hit)
        if any_hit is False:
            self.grid.collect(hit, ray, eye, near, begin, any_hit)
            return
        with SH_IF(~sh.Attrib1b(any_hit & (hit.id >= 0))):
            self.grid.collect(hit, ray, eye, near, begin, any_hit)
