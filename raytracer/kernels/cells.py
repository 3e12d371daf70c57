"""The cells of a uniform grid that a ray goes through, one after the other.

Stage: kernel. 3D-DDA (Amanatides and Woo 1987), but that the crossings with a cell's far sides are computed anew from
the integer cell: nothing is added up, so nothing drifts, however many cells there are. Each step goes on by one cell
along at least one axis and never back, so there are no more steps than the grid has cells along its three sides.

    cells = CellWalk(CellBox(low, size, shape), ray, eye, near)
    with SH_DO():
        SH_UNTIL(cells.t >= cells.far)
        ... cells.voxel ...
        cells.advance()
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bounds import FAR


class CellBox:
    """The uniforms of a grid: `shape` (x, y, z) cells of `size` (3,) from the corner `low` (3,)."""

    def __init__(self, low: NDArray[Any], size: NDArray[Any], shape: tuple[int, ...]) -> None:
        # In f32 here as in the kernel, so that the far side of the last cell is the far side of the box to the bit.
        corner, cell = low.astype(np.float32), size.astype(np.float32)
        self.low = sh.Param(sh.Point3f, corner, name="grid_low")
        self.high = sh.Param(sh.Point3f, corner + np.array(shape, np.float32) * cell, name="grid_high")
        self.size = sh.Param(sh.Vector3f, cell, name="cell_size")
        self.last = sh.Param(sh.Attrib3i, np.array(shape) - 1, name="last_cell")


class CellWalk:
    """The place of a ray: in cell `voxel` (x, y, z) from the distance `t` on; at `far` it has left the grid.

    A ray that misses the grid begins with t >= far, and so does one that is NaN: it is nowhere.
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
        enter = sh.cond(self.moving, sh.min(t0, t1), sh.cond(between, sh.Attrib3f(-FAR), sh.Attrib3f(FAR)))
        leave = sh.cond(self.moving, sh.max(t0, t1), FAR)
        t_exit = sh.max(near, enter.x, enter.y, enter.z)
        self.far = sh.min(leave.x, leave.y, leave.z)
        inter = eye + t_exit * ray
        voxel = sh.clamp(sh.Attrib3i((inter - self.low) / self.size), 0, box.last)
        self.t, self.voxel = t_exit, voxel

    def advance(self) -> None:
        """Go on to the next cell, or to several at once where they meet."""
        corner = self.low + sh.Vector3f(self.voxel + self.ahead) * self.size
        crossing = sh.cond(self.moving, (corner - self.eye) * self.inverse, FAR)
        self.t[:] = sh.min(crossing.x, crossing.y, crossing.z)
        self.voxel += sh.cond(crossing <= self.t, self.step, 0)
