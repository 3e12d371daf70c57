"""The walk through a uniform grid: the scene's box, then cell by cell.

Stage: kernel. The `intersector` of Moreno-Fortuny and McCool with its two loops in one: an iteration either tries one
triangle or goes on to the next cell (3D-DDA, Amanatides and Woo 1987), so that rays that run side by side wait for
each other once a ray and not once a cell. As printed, the intersector writes `hit = 1 < INF` for `l < INF`; a hit is
taken here when no cell follows that is entered before it or with it. A triangle outside of the grid may be met at the
same distance as one inside: the walk goes on to the part `REACH` behind its nearest hit, as that through the hierarchy.
"""

from __future__ import annotations

from typing import Any

import shpy as sh
from raytracer.accel.grid import Grid
from raytracer.kernels.cells import CellBox, CellWalk
from raytracer.kernels.triangle import Accept, AheadBound, Hit, Triangles, TriangleTest, farther, is_ray
from shpy import SH_BREAK, SH_DO, SH_ELSE, SH_IF


class GridIntersector:
    """The tables of a grid over `triangles` (see `triangle_rows`), and the walk through them."""

    def __init__(self, grid: Grid, triangles: Any, bound: AheadBound | None = None) -> None:
        self.bound = bound
        self.accept: Accept | None = None
        self.triangles = Triangles(triangles)
        self.cells = sh.Table(grid.cells, sh.Attrib2i, "cells")
        self.items = sh.Table(grid.items, sh.Attrib1i, "items")
        self.outside = sh.Param(sh.Attrib1i, grid.outside, name="outside")
        self.box = CellBox(grid.low, grid.cell, grid.shape)

    def __call__(self, ray: Any, eye: Any, near: Any, limit: Any, any_hit: Any) -> Hit:
        """Find the nearest hit at a distance in [near, limit); where `any_hit` holds, the first that is found."""
        hit = Hit(limit, self.accept)
        self.collect(hit, ray, eye, near, near, any_hit)
        return hit

    def collect(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        """Offer to `hit` each triangle that is met at a distance in [near, hit.l), cells from `begin` on.

        A triangle is offered for each cell in which it lies.
        """
        test = TriangleTest(ray, eye, self.bound)
        cells = self.walk(ray, eye, begin)

        # The triangles outside of the grid are tried before the first cell.
        item = sh.Attrib1i(0)
        end = sh.Attrib1i(self.outside)
        with SH_IF(is_ray(ray, eye)), SH_DO():
            with SH_IF(item < end):
                self.try_next(test, item, near, hit)
                SH_BREAK(any_hit & (hit.id >= 0))
            with SH_ELSE():
                SH_BREAK(is_over(cells, hit))
                self.enter(cells, item, end)

    def walk(self, ray: Any, eye: Any, near: Any) -> CellWalk:
        """Return the cells that a ray goes through from the distance `near` on."""
        return CellWalk(self.box, ray, eye, near)

    def try_next(self, test: TriangleTest, item: Any, near: Any, hit: Hit) -> None:
        """Try the triangle at `item` of the lists, and go on to the next one."""
        test(self.triangles, self.items[item], near, hit)
        item += 1

    def enter(self, cells: CellWalk, item: Any, end: Any) -> None:
        """Take the list of the cell that the ray is in, and go on to the next cell."""
        span = self.cells[cells.voxel.zyx]
        item[:] = span.x
        end[:] = span.y
        cells.advance()


def is_over(cells: CellWalk, hit: Hit) -> Any:
    """Return whether no cell can follow that has a hit as near."""
    return (cells.t >= cells.far) | (cells.t > farther(hit.l))
