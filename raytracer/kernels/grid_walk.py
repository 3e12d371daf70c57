"""The walk through a uniform grid: the scene's box, then cell by cell.

Stage: kernel. The `intersector` of Moreno-Fortuny and McCool with its two loops in one: an iteration either tries one
triangle or goes on to the next cell (3D-DDA, Amanatides and Woo 1987), so that rays that run side by side wait for
each other once a ray and not once a cell. The crossings with a cell's far sides are computed anew from the integer
cell: nothing is added up, so nothing drifts. Each step goes on by one cell along at least one axis and never back, so
there are no more steps than the grid has cells along its three sides.

The listing keeps a hit within the current cell; a hit is taken here when no cell follows that is entered before it or
with it. A triangle outside of the grid may be met at the same distance as one inside: the walk goes on to the part
`REACH` behind its nearest hit, as that through the hierarchy.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bounds import far
from raytracer.accel.forest import Forest
from raytracer.accel.grid import Grid
from raytracer.kernels.bvh_walk import BvhIntersector
from raytracer.kernels.triangle import AheadBound, RayHit, Triangles, TriangleTest, Walk, farther, is_ray
from raytracer.scene.layout import Change
from shpy import SH_BREAK, SH_DO, SH_ELSE, SH_IF


class CellBox:
    """The uniforms of a grid: `shape` (x, y, z) cells of `size` (3,) from the corner `low` (3,)."""

    def __init__(self, low: NDArray[Any], size: NDArray[Any], shape: tuple[int, ...]) -> None:
        # In f32 here as in the kernel, so that the far side of the last cell is the far side of the box to the bit.
        corner, cell = low.astype(np.float32), size.astype(np.float32)
        grid_low = sh.Param(sh.Point3f, corner, title="")
        grid_high = sh.Param(sh.Point3f, corner + np.array(shape, np.float32) * cell, title="")
        cell_size = sh.Param(sh.Vector3f, cell, title="")
        last_cell = sh.Param(sh.Attrib3i, np.array(shape) - 1, title="")
        self.low, self.high, self.size, self.last = grid_low, grid_high, cell_size, last_cell


class CellWalk:
    """The place of a ray: in cell `voxel` (x, y, z) from the distance `t` on; at `far` it has left the grid.

    A ray that misses the grid begins with t >= far, and so does one that holds NaN.
    """

    def __init__(self, box: CellBox, ray: Any, eye: Any, near: Any) -> None:
        self.low, self.size, self.eye = box.low, box.size, eye
        self.moving = ray != 0
        self.inverse = 1 / sh.cond(self.moving, ray, 1.0)
        self.step = sh.Attrib3i(sh.sign(ray))
        self.ahead = sh.max(self.step, 0)
        # The scene box, side by side; a ray along a side is inside or misses.
        t0 = (self.low - eye) * self.inverse
        t1 = (box.high - eye) * self.inverse
        between = (eye >= self.low) & (eye <= box.high)
        enter = sh.cond(self.moving, sh.min(t0, t1), sh.cond(between, -far(sh.Attrib3u), far(sh.Attrib3u)))
        leave = sh.cond(self.moving, sh.max(t0, t1), far())
        t_exit = sh.max(near, enter.x, enter.y, enter.z)
        self.far = sh.min(leave.x, leave.y, leave.z)
        inter = eye + t_exit * ray
        voxel = sh.clamp(sh.Attrib3i((inter - self.low) / self.size), 0, box.last)
        self.t, self.voxel = t_exit, voxel

    def advance(self) -> None:
        """Go on to the next cell, or to several at once where they meet."""
        corner = self.low + sh.Vector3f(self.voxel + self.ahead) * self.size
        crossing = sh.cond(self.moving, (corner - self.eye) * self.inverse, far())
        self.t[:] = sh.min(crossing.x, crossing.y, crossing.z)
        self.voxel += sh.cond(crossing <= self.t, self.step, 0)


class GridIntersector(Walk):
    """The tables of a grid over `triangles` (see `triangle_rows`), and the walk through them."""

    def __init__(self, grid: Grid, triangles: Any, bound: AheadBound | None = None) -> None:
        self.bound = bound
        self.triangles = Triangles.of(triangles)
        self.cells = sh.Table(grid.cells, sh.Attrib2i, "cells", unique=False)
        self.items = sh.Table(grid.items, sh.Attrib1i, "items", unique=False)
        outside = sh.Param(sh.Attrib1i, grid.outside, title="")
        self.outside = outside
        self.box = CellBox(grid.low, grid.cell, grid.shape)

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

    def try_next(self, test: TriangleTest, item: Any, near: Any, hit: RayHit) -> None:
        """Try the triangle at `item` of the lists, and go on to the next one."""
        test(self.triangles, self.items[item], near, hit)
        item += 1

    def enter(self, cells: CellWalk, item: Any, end: Any) -> None:
        """Take the list of the cell that the ray is in, and go on to the next cell."""
        span = self.cells[cells.voxel.zyx]
        item[:] = span.x
        end[:] = span.y
        cells.advance()


def is_over(cells: CellWalk, hit: RayHit) -> Any:
    """Return whether no cell can follow that has a hit as near."""
    return (cells.t >= cells.far) | (cells.t > farther(hit.l))


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
