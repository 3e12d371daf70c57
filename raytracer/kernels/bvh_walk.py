"""What a ray meets first: the boxes of a hierarchy, nearer child first, each with a link past what it holds.

Stage: kernel. A turn looks into one node: a ray that meets its box goes on inside, one that misses it goes past.

Rays that run side by side may walk together: they go into a box if any of them meets it, so the number of the node is
one number for all of them, its box and triangles are read once, and each ray takes part where it meets the box itself.
Whether they do, and how many there are, makes no difference to what is hit: whatever the order, a ray tries all leaves
whose boxes it meets no farther than its nearest hit, and of triangles at the same distance the one of the lowest number
is hit. For this to hold to the bit, boxes are met with a margin for rounding (Ize 2013).
"""

from __future__ import annotations

from typing import Any

import numpy as np

import shpy as sh
from raytracer.accel.bvh import COUNT_BITS, Bvh
from raytracer.kernels.triangle import FAR, Hit, TriangleTest, farther, higher, lower
from shpy import SH_DO, SH_ELSE, SH_IF, SH_UNTIL

MARGIN = 8.0
"""Of where a ray meets a face, in units of the last place: three roundings there, as many in the test of triangles."""


class BvhIntersector:
    """The tables of a hierarchy over `triangles` (see `layout.triangle_rows`), and the walk through them.

    `together`: rays that run side by side look into the same node. `roundoff`: see `TriangleTest`.
    """

    def __init__(self, bvh: Bvh, triangles: Any, together: bool, roundoff: float | None = None) -> None:
        self.roundoff = roundoff
        self.triangles = sh.Table(triangles, sh.Attrib4f, "triangles")
        leaves = np.reshape(triangles, (-1, 3, 4))[bvh.items].reshape(-1, 4)
        self.leaves = sh.Table(leaves, sh.Attrib4f, "leaves")
        self.items = sh.Table(bvh.items, sh.Attrib1i, "items")
        boxes = np.pad(np.stack([bvh.low, bvh.high], axis=1).reshape(-1, 3), ((0, 0), (0, 1)))
        self.boxes = sh.Table(boxes, sh.Attrib4f, "boxes")
        self.links = sh.Table(bvh.links.reshape(-1, 2), sh.Attrib2i, "links")
        self.nodes = len(bvh.low)
        working = np.finfo(bvh.low.dtype)
        self.margin = MARGIN * float(working.eps)
        self.steepest = min(float(working.max), FAR)
        self.vote = sh.any_lane if together else sh.Attrib1b

    def __call__(self, ray: Any, eye: Any, near: Any, limit: Any, any_hit: Any) -> Hit:
        """The nearest hit at a distance in [near, limit); where `any_hit` holds, the first that is found."""
        hit = Hit(limit)
        test = TriangleTest(ray, eye, self.roundoff)
        inverse = sh.clamp(1 / ray, -self.steepest, self.steepest)  # finite, so that 0 times it is 0
        octant = sh.Attrib1i(0)
        for axis in range(3):
            with SH_IF(self.vote(ray[axis] < 0)):
                octant += 1 << axis
        links = octant * self.nodes
        node = sh.Attrib1i(0)
        reach = farther(limit)
        with SH_IF(near < limit), SH_DO():
            # All rays go on to a leaf, or to the end, before any tries triangles.
            leaf = sh.Attrib1i(0)
            inside = sh.Attrib1b(False)
            with SH_DO():
                t0 = (self.boxes[2 * node].xyz - eye) * inverse
                t1 = (self.boxes[2 * node + 1].xyz - eye) * inverse
                near_side = lower(t0, t1)
                far_side = higher(t0, t1)
                enter = higher(higher(near, near_side.x), higher(near_side.y, near_side.z))
                enter -= self.margin * abs(enter)
                meets = enter <= lower(lower(reach, far_side.x), lower(far_side.y, far_side.z))
                link = self.links[links + node]
                node[:] = link.y
                with SH_IF(self.vote(meets)):
                    with SH_IF(link.x >= 0):
                        node[:] = link.x
                    with SH_ELSE():
                        leaf[:] = -1 - link.x
                        inside[:] = meets
                SH_UNTIL((node < 0) | (leaf > 0))
            with SH_IF(inside):
                self.try_leaf(leaf, near, test, hit)
                reach[:] = farther(hit.l)
            SH_UNTIL((node < 0) | (any_hit & (hit.id >= 0)))
        return hit

    def try_leaf(self, leaf: Any, near: Any, test: TriangleTest, hit: Hit) -> None:
        """Try the triangles of a leaf."""
        item = leaf >> COUNT_BITS
        end = item + (leaf & ((1 << COUNT_BITS) - 1))
        with SH_DO():
            test(self.leaves, item, near, hit, numbers=self.items)
            item += 1
            SH_UNTIL(item >= end)
