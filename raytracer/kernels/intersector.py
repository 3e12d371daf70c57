"""What a ray meets first: the scene box, then the uniform grid cell by cell.

Stage: kernel. The `intersector` of Moreno-Fortuny and McCool with its two loops in one: a turn either tries one
triangle or goes on to the next cell (3D-DDA, Amanatides and Woo 1987), so that rays that run side by side wait for
each other once a ray and not once a cell. As printed, the intersector writes `hit = 1 < INF` for `l < INF`; a hit is
taken here when it is nearer than the far side of its cell. The crossings with the cell's far sides are computed anew
from the integer cell, so nothing drifts.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import shpy as sh
from raytracer.accel.grid import Grid
from raytracer.kernels.triangle import FAR, Hit, TriangleTest
from shpy import SH_BREAK, SH_DO, SH_ELSE, SH_IF


class GridIntersector:
    """The tables of a grid over `triangles` (see `layout.triangle_rows`), and the walk through them."""

    def __init__(self, grid: Grid, triangles: Any, roundoff: float | None = None) -> None:
        self.roundoff = roundoff
        self.triangles = sh.Table(triangles, sh.Attrib4f, "triangles")
        self.cells = sh.Table(grid.cells, sh.Attrib2i, "cells")
        self.items = sh.Table(grid.items, sh.Attrib1i, "items")
        self.outside = grid.outside
        self.shape = grid.shape
        # In f32 here as in the kernel, so that the far side of the last cell is the far side of the box to the bit.
        self.low = grid.low.astype(np.float32)
        self.size = grid.cell.astype(np.float32)
        self.high = self.low + np.array(grid.shape, dtype=np.float32) * self.size

    def __call__(self, ray: Any, eye: Any, near: Any, limit: Any, any_hit: Any) -> Hit:
        """The nearest hit at a distance in [near, limit); where `any_hit` holds, the first that is found."""
        hit = Hit(limit)
        test = TriangleTest(ray, eye, self.roundoff)
        low = sh.Point3f(self.low)
        size = sh.Vector3f(self.size)
        moving = ray != 0
        inverse = 1 / sh.cond(moving, ray, 1.0)
        step = sh.Attrib3i(sh.sign(ray))
        ahead = sh.max(step, 0)

        # The scene box, side by side; a ray along a side is inside or misses.
        t0 = (low - eye) * inverse
        t1 = (sh.Point3f(self.high) - eye) * inverse
        between = (eye >= low) & (eye <= sh.Point3f(self.high))
        enter = sh.cond(moving, sh.min(t0, t1), sh.cond(between, sh.Attrib3f(-FAR), sh.Attrib3f(FAR)))
        leave = sh.cond(moving, sh.max(t0, t1), FAR)
        t_exit = sh.max(near, enter.x, enter.y, enter.z)
        far = sh.min(leave.x, leave.y, leave.z)
        inter = eye + t_exit * ray
        voxel = sh.clamp(sh.Attrib3i((inter - low) / size), 0, sh.Attrib3i(self.shape) - 1)

        # The triangles outside of the grid are tried before the first cell.
        item = sh.Attrib1i(0)
        end = sh.Attrib1i(self.outside)
        with SH_DO():
            with SH_IF(item < end):
                test(self.triangles, self.items[item], near, hit)
                item += 1
                SH_BREAK(any_hit & (hit.id >= 0))
            with SH_ELSE():
                SH_BREAK(t_exit >= sh.min(hit.l, far))  # nothing nearer can follow
                span = self.cells[voxel.zyx]
                item[:] = span.x
                end[:] = span.y
                corner = low + sh.Vector3f(voxel + ahead) * size
                crossing = sh.cond(moving, (corner - eye) * inverse, FAR)
                t_exit[:] = sh.min(crossing.x, crossing.y, crossing.z)
                voxel += sh.cond(crossing <= t_exit, step, 0)
        return hit
