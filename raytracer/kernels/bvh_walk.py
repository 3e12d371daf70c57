"""The walk through a BVH: the boxes of a hierarchy, nearer child first, each with a link past its contents.

Stage: kernel. An iteration looks into one node: a ray that meets its box goes on inside, another ray goes past.

Rays that run side by side may walk together: they go into a box if any of them meets it, so the number of the node is
one number for all of them, its box and triangles are read once, and each ray takes part where it meets the box itself.
Whether they do, and how many there are, makes no difference to what is hit: whatever the order, a ray tries all leaves
whose boxes it meets no farther than its nearest hit, and of triangles at the same distance the one of the lowest number
is hit. For this to hold to the bit, boxes are met with a margin for rounding (Ize 2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import shpy as sh
from raytracer.accel.bounds import FAR, higher, lower
from raytracer.accel.bvh import COUNT_BITS, Bvh
from raytracer.accel.forest import Forest
from raytracer.accel.planes import constant, copy_columns
from raytracer.kernels.triangle import AheadBound, RayHit, Triangles, TriangleTest, Walk, farther, is_ray
from raytracer.scene.layout import Change
from shpy import SH_BREAK, SH_DO, SH_IF, SH_UNTIL, SH_WHILE

MARGIN = 8.0
"""The margin of a ray's distance to a face, in units in the last place: more than `triangle.BESIDE`, so that
where a triangle is met so are the boxes that hold it."""


class BvhIntersector(Walk):
    """The tables of a hierarchy over `triangles` (see `triangle_rows`), and the walk through them.

    `together`: rays that run side by side look into the same node. `bound` is for rays that may start from a triangle.
    """

    def __init__(self, bvh: Bvh, triangles: Any, together: bool, bound: AheadBound | None = None) -> None:
        self.bound = bound
        self.triangles = Triangles.of(triangles, bvh.low.dtype)
        self.items, self.leaves = leaf_tables(bvh, self.triangles)
        self.boxes = sh.Table(box_rows(bvh.low, bvh.high), sh.Attrib4f, "boxes", copy=False, unique=False)
        first, past = bvh.links.reshape(-1, 2).T
        self.first = sh.Table(first, sh.Attrib1i, "first", unique=False)
        self.past = sh.Table(past, sh.Attrib1i, "past", unique=False)
        nodes = sh.Param(sh.Attrib1i, len(bvh.low), title="")
        self.nodes = nodes
        working = np.finfo(bvh.low.dtype)
        self.margin = MARGIN * float(working.eps)
        self.steepest = min(float(working.max), FAR)
        self.vote = sh.any_lane if together else sh.Attrib1b

    def renew(self, forest: Forest, changes: Sequence[Change]) -> None:
        """Update the parts of the tables that changed: of `forest.bvh`, and of the triangles.

        The changes are those that `forest.change` was told, in the same order.
        """
        bvh, nodes = forest.bvh, len(forest.bvh.low)
        for (first, _, shape, _), (item, end) in zip(changes, forest.stale_items, strict=True):
            items = bvh.items[item:end]
            order = items - first
            self.triangles.renew(shape.rows, shape.levels, first)
            self.items.update(items, start=item)
            leaves = shape.rows.reshape(-1, 12).take(order, axis=0).reshape(-1, 4)
            self.leaves.renew(leaves, shape.levels.take(order), item)
        for first, past in forest.stale_boxes:
            self.boxes.update(box_rows(bvh.low[first:past], bvh.high[first:past]), start=2 * first)
        for octant, first, past in forest.stale_links:
            links = bvh.links[octant, first:past]
            self.first.update(links[:, 0], start=octant * nodes + first)
            self.past.update(links[:, 1], start=octant * nodes + first)
        forest.clear()

    def __call__(self, ray: Any, eye: Any, near: Any, limit: Any, any_hit: Any) -> RayHit:
        """Find the nearest hit at a distance in [near, limit); where `any_hit` holds, the first that is found."""
        hit = self.hit_before(limit)
        self._collect_before(limit, hit, ray, eye, near, near, any_hit)
        return hit

    def collect(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        """Offer to `hit` each triangle that is met at a distance in [near, hit.l), boxes from `begin` on."""
        self._collect_before(hit.l, hit, ray, eye, near, begin, any_hit)

    def _collect_before(self, limit: Any, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        box = BoxTest(ray, eye, begin, self.margin, self.steepest)
        reach = farther(limit)
        with SH_IF((near < limit) & is_ray(ray, eye) & self.meets(box, 0, reach)):
            self.walk(ray, eye, near, any_hit, box, reach, hit)

    def walk(self, ray: Any, eye: Any, near: Any, any_hit: Any, box: BoxTest, reach: Any, hit: Any) -> None:
        """Go through all nodes whose boxes are met no farther than `reach`."""
        test = TriangleTest(ray, eye, self.bound)
        links = self.octant_of(ray) * self.nodes
        node = sh.Attrib1i(0)
        with SH_DO():
            # All rays go on to a leaf, or to the end, before any tries triangles.
            leaf = sh.Attrib1i(0)
            there = sh.Attrib1i(0)
            with SH_WHILE(lambda: node >= 0):
                there[:] = node
                node[:] = self.past[links + there]
                with SH_IF(self.vote(self.meets(box, there, reach))):
                    link = self.first[links + there]
                    with SH_IF(link < 0):
                        leaf[:] = -1 - link
                        SH_BREAK()
                    node[:] = link
            # The box is tested once more: a mask that is kept from the loop would cost more in each iteration.
            with SH_IF((leaf > 0) & self.meets(box, there, reach)):
                try_leaf(self.leaves, leaf, near, test, hit)
                reach[:] = farther(hit.l)
            SH_UNTIL((node < 0) | (any_hit & (hit.id >= 0)))

    def octant_of(self, ray: Any) -> Any:
        """Return the octant in whose order a ray visits nodes: that of its direction, or of some ray of a packet."""
        octant = sh.Attrib1i(0)
        for axis in range(3):
            with SH_IF(self.vote(ray[axis] < 0)):
                octant += 1 << axis
        return octant

    def meets(self, box: BoxTest, node: Any, reach: Any) -> Any:
        """Return True if the ray meets a node's box before `reach`."""
        return box(self.boxes[2 * node].xyz, self.boxes[2 * node + 1].xyz, reach)


def leaf_tables(bvh: Bvh, triangles: Triangles) -> tuple[Any, Triangles]:
    """Return the table of the triangles' numbers leaf by leaf, and tables of the triangles in this order."""
    rows, levels = triangles.sources
    leaves = constant(rows.reshape(-1, 12).take(bvh.items, axis=0)).reshape(-1, 4)
    items = sh.Table(bvh.items, sh.Attrib1i, "items", unique=False)
    return items, Triangles(leaves, "leaves", items, levels[bvh.items], copy=False)


def try_leaf(leaves: Triangles, leaf: Any, near: Any, test: TriangleTest, hit: RayHit) -> None:
    """Try the triangles of a leaf."""
    item = leaf >> COUNT_BITS
    end = item + (leaf & ((1 << COUNT_BITS) - 1))
    with SH_DO():
        test(leaves, item, near, hit)
        item += 1
        SH_UNTIL(item >= end)


def box_rows(low: Any, high: Any) -> Any:
    """Return rows (2M, 4) of the lower and the upper corner of M boxes, and a component of padding."""
    rows = np.zeros((len(low), 2, 4), low.dtype)
    copy_columns(rows[:, 0], low)
    copy_columns(rows[:, 1], high)
    return constant(rows).reshape(-1, 4)


class BoxTest:
    """The constants of a ray for tests against many boxes, with a margin for rounding.

    `eye` is where it starts for the lower sides of boxes, and `beyond` for the upper ones.
    """

    def __init__(self, ray: Any, eye: Any, near: Any, margin: float, steepest: float) -> None:
        self.inverse = sh.clamp(1 / ray, -steepest, steepest)  # finite, so that 0 times it is 0
        self.eye, self.near, self.margin = eye, near, margin
        self.beyond = eye
        self.forward = isinstance(near, float | int) and near >= 0

    def __call__(self, low: Any, high: Any, reach: Any) -> Any:
        """Return True if the ray meets the box before `reach`."""
        t0, t1 = (low - self.eye) * self.inverse, (high - self.beyond) * self.inverse
        first, last = lower(t0, t1), higher(t0, t1)
        enter = higher(higher(self.near, first.x), higher(first.y, first.z))
        soon = enter * (1 - self.margin) if self.forward else enter - self.margin * abs(enter)
        return soon <= lower(lower(reach, last.x), lower(last.y, last.z))
