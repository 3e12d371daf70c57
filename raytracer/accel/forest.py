"""The hierarchies of moving objects and of the static triangles, joined to one `Bvh` that is updated in parts.

Stage: accelerate. Takes corners (N, 3, 3), and the triangles of each moving object. Node 0 holds everything. Rays visit
the moving objects first, through a small hierarchy over their boxes that is rebuilt after each change, and the static
triangles last. So no link of the static part depends on the objects, and it never changes.

An object that has moved or changed its shape keeps the links of its hierarchy; the boxes are refitted to its triangles
from the bottom up. When refitting has made the hierarchy too costly, it is rebuilt in its place.

>>> corners = np.arange(18.0).reshape(2, 3, 3)
>>> forest = Forest(corners, [(1, 2)])
>>> forest.bvh.items.tolist(), (forest.bvh.high[0] - forest.bvh.low[0]).round(3).tolist()
([1, 0], [15.0, 15.0, 15.0])
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raytracer.accel.bvh import COUNT_BITS, DESCENT, END, Bvh, growth_of, half_area
from raytracer.accel.planes import copy_columns
from raytracer.accel.ploc import build_bvh
from raytracer.accel.shape import Shape

Corners = NDArray[np.floating]
Ints = NDArray[np.int64]

DEGRADED = 2.0
"""Growth of a refitted hierarchy's expected cost at which it is rebuilt.

Measured on a ring of 69,696 triangles that was deformed (OpenCL, CPU time): pictures at 1.7 and 2.5 times take 1.28 and
1.31 times as long as through a new hierarchy, and building that takes as long as ten pictures of 512 x 512.
"""
GAP = 256
"""Links that are sent together, though only those at the ends of the range have changed."""


class Forest:
    """The joined hierarchy `bvh` over all triangles; `moving` are the ranges (first, past) of the objects' triangles.

    Hierarchies are built on `backend`. Without `static` the hierarchy holds the moving objects alone, beside another
    accelerator for the rest.

    `stale_boxes` are the ranges of nodes whose boxes changed since they were last cleared, `stale_links` those (octant,
    first, past) of nodes whose links changed, `stale_items` the changed ranges of `bvh.items`. `shapes` are the shapes
    that objects have taken, and `rebuilt` counts the rebuilt hierarchies of objects.
    """

    def __init__(
        self,
        corners: Corners,
        moving: Sequence[tuple[int, int]],
        dtype: DTypeLike = np.float32,
        backend: str = "numpy",
        *,
        static: bool = True,
    ) -> None:
        self.dtype, self.backend = np.dtype(dtype), backend
        self.moving = list(moving)
        self.rebuilt = 0
        still = still_of(len(corners), moving) if static else np.zeros(0, np.int64)
        sizes = [past - first for first, past in self.moving]
        # An object has room for as many nodes as its triangles can need.
        roots = np.cumsum([len(sizes), *(2 * size - 1 for size in sizes)])
        self.clear()
        self.still = self._built(corners[still]) if len(still) else None
        total = int(roots[-1]) + (0 if self.still is None else len(self.still.low))
        low, high = np.zeros((total, 3), self.dtype), np.zeros((total, 3), self.dtype)
        links, items = np.full((8, total, 2), END, np.int32), np.zeros(sum(sizes) + len(still), np.int32)
        self.bvh = Bvh(low, high, links, items)
        places = np.cumsum([0, *sizes])
        self.objects = [_Object(self.bvh, *place) for place in zip(roots, places, [m[0] for m in moving], strict=False)]
        for hierarchy, (first, past) in zip(self.objects, self.moving, strict=True):
            hierarchy.put(self._built(corners[first:past]))
        self.shapes = [Shape(size, self.dtype, backend) for size in sizes]
        self.past_objects = END
        if self.still is not None:
            self.past_objects = int(roots[-1])
            put_part(self.bvh, self.still, self.past_objects, int(places[-1]), END)
            items[places[-1] :] = still[self.still.items]
        self.join()
        self.clear()

    def _built(self, corners: Corners) -> Bvh:
        return build_bvh(corners, self.dtype, self.backend)

    def clear(self) -> None:
        """Forget what has changed."""
        self.stale_boxes: list[tuple[int, int]] = []
        self.stale_links: list[tuple[int, int, int]] = []
        self.stale_items: list[tuple[int, int]] = []

    def change(self, number: int) -> None:
        """Refit the hierarchy of the moving object of this number to its new shape."""
        hierarchy, shape = self.objects[number], self.shapes[number]
        hierarchy.refit(shape.sides)
        if hierarchy.cost() > DEGRADED * hierarchy.built_cost:
            hierarchy.put(self._built(shape.corners))
            self.rebuilt += 1
            self.stale_links += [(octant, hierarchy.root, hierarchy.root + hierarchy.count) for octant in range(8)]
        self.stale_items.append((hierarchy.item, hierarchy.item + len(shape)))
        self.stale_boxes.append((hierarchy.root, hierarchy.root + hierarchy.count))

    def join(self) -> None:
        """Rebuild the hierarchy over the objects' boxes, and link it to the nodes before and after it."""
        bvh, past = self.bvh, self.past_objects
        top = _Top(bvh, self.objects)
        inner = len(self.objects)  # node 0 counts, too
        before = bvh.links[:, :inner].copy()
        for octant in range(8):
            bvh.links[octant, 0] = top.root, END
            for hierarchy, end in top.linked(octant, past):
                self.stale_links += [(octant, *part) for part in hierarchy.link(octant, end)]
        boxes = [top.root] if past == END else [top.root, past]
        bvh.low[0], bvh.high[0] = bvh.low[boxes].min(axis=0), bvh.high[boxes].max(axis=0)
        if not np.array_equal(before, bvh.links[:, :inner]):
            self.stale_links += [(octant, 0, inner) for octant in range(8)]
        self.stale_boxes.append((0, inner))


def still_of(count: int, moving: Sequence[tuple[int, int]]) -> Ints:
    """Return the numbers below `count` of the triangles outside all ranges (first, past) of `moving`."""
    stays = np.ones(count, bool)
    for first, past in moving:
        stays[first:past] = False
    return np.flatnonzero(stays)


class _Object:
    """The hierarchy of a moving object: its nodes from `root` on, its items from `item` on, its first triangle."""

    def __init__(self, bvh: Bvh, root: int, item: int, first: int) -> None:
        self.bvh, self.root, self.item, self.first = bvh, int(root), int(item), int(first)
        self.count = 0

    def put(self, built: Bvh) -> None:
        """Copy a hierarchy that was built for the object alone into the object's place in the joined one."""
        self.count = len(built.low)
        put_part(self.bvh, built, self.root, self.item, END)
        self.bvh.items[self.item : self.item + len(built.items)] = built.items + self.first
        first, past = built.links[0].T.astype(np.int64)
        inner = first >= 0
        self.leaves = np.flatnonzero(~inner)
        code = -1 - first[self.leaves]
        starts, counts = code >> COUNT_BITS, code & ((1 << COUNT_BITS) - 1)
        # The first triangle of each leaf, the second, and so on; of a leaf with fewer, the last one again.
        self.members = [built.items[starts + np.minimum(k, counts - 1)] for k in range(int(counts.max()))]
        self.order, self.levels = _levels(np.where(inner, first, -1), np.where(inner, past[np.maximum(first, 0)], -1))
        self.place = np.argsort(self.order)
        self.leaf_places = self.place[self.leaves]
        self.ordered, self.placed = (np.empty((self.count, 6), built.low.dtype) for _ in range(2))
        self.weights = np.full(self.count, DESCENT)
        self.weights[self.leaves] = counts
        self.ends = [np.flatnonzero(links[:, 1] == END) + self.root for links in built.links]
        self.next: list[int | None] = [None] * 8
        self.built_cost = self.cost()

    def refit(self, sides: NDArray[np.floating]) -> None:
        """Refit the boxes to the moved triangles; see `Shape`."""
        # Member by member of all leaves: several times as fast as `reduceat`, which goes number by number. `take` is
        # several times as fast as an index.
        leaf_sides = reduce(np.minimum, (sides.take(members, axis=0) for members in self.members))
        leaf_sides -= growth_of(reduce(np.maximum, np.abs(leaf_sides.T)), sides.dtype).astype(sides.dtype)[:, None]
        ordered, placed = self.ordered, self.placed
        ordered[self.leaf_places] = leaf_sides
        for inner, first, middle, past in self.levels:
            ordered[inner] = np.minimum(ordered[first:middle], ordered[middle:past])
        ordered.take(self.place, axis=0, out=placed, mode="clip")
        span = slice(self.root, self.root + self.count)
        copy_columns(self.bvh.low[span], placed[:, :3])
        copy_columns(self.bvh.high[span], -placed[:, 3:])

    def cost(self) -> float:
        """Return the expected cost of a ray that meets the root, by the surface area heuristic."""
        span = slice(self.root, self.root + self.count)
        extent = self.bvh.high[span].astype(np.float64) - self.bvh.low[span]
        area = half_area((extent / (extent[0].max() or 1.0)).T)
        return float((area * self.weights).sum() / (area[0] or 1.0))

    def link(self, octant: int, past: int) -> list[tuple[int, int]]:
        """Make a node the one to visit after the object; return the ranges of nodes whose links changed."""
        if self.next[octant] == past:
            return []
        self.next[octant] = past
        ends = self.ends[octant]
        self.bvh.links[octant, ends, 1] = past
        parts = np.split(ends, np.flatnonzero(np.diff(ends) > GAP) + 1)
        return [(int(part[0]), int(part[-1]) + 1) for part in parts]


class _Top:
    """The hierarchy over the boxes of objects, whose inner nodes are 1, 2, ...; `root` is its first node."""

    def __init__(self, bvh: Bvh, objects: Sequence[_Object]) -> None:
        self.bvh, self.objects = bvh, objects
        roots = [hierarchy.root for hierarchy in objects]
        self.centers = bvh.low[roots].astype(np.float64) + bvh.high[roots]
        self.children: dict[int, tuple[int, int, int]] = {}
        self.by_root = {hierarchy.root: hierarchy for hierarchy in objects}
        self.root = self._cut(np.arange(len(objects)))

    def _cut(self, members: Ints) -> int:
        """Split objects in half along the axis on which they lie farthest apart; return the node that holds them."""
        if len(members) == 1:
            return self.objects[int(members[0])].root
        node = len(self.children) + 1
        self.children[node] = (0, 0, 0)  # reserve the number
        axis = int(np.ptp(self.centers[members], axis=0).argmax())
        order = members[np.argsort(self.centers[members, axis], kind="stable")]
        left, right = self._cut(order[: len(order) // 2]), self._cut(order[len(order) // 2 :])
        self.children[node] = left, right, axis
        self.bvh.low[node] = np.minimum(self.bvh.low[left], self.bvh.low[right])
        self.bvh.high[node] = np.maximum(self.bvh.high[left], self.bvh.high[right])
        return node

    def linked(self, octant: int, past: int) -> list[tuple[_Object, int]]:
        """Link the inner nodes in the order in which rays of an octant visit them; the last one leads to `past`.

        Returns the objects, each with the node that a ray visits after it.
        """
        successors = []
        todo = [(self.root, past)]
        while todo:
            node, after = todo.pop()
            if node in self.by_root:
                successors.append((self.by_root[node], after))
                continue
            left, right, axis = self.children[node]
            near, far = (right, left) if octant >> axis & 1 else (left, right)
            self.bvh.links[octant, node] = near, after
            todo += [(near, far), (far, after)]
        return successors


def put_part(bvh: Bvh, part: Bvh, root: int, item: int, past: int) -> None:
    """Copy the nodes of a hierarchy to `root` and on; `past` is the node to visit after it, `item` its first item."""
    span = slice(root, root + len(part.low))
    bvh.low[span], bvh.high[span] = part.low, part.high
    first, after = part.links[..., 0], part.links[..., 1]
    bvh.links[:, span, 0] = np.where(first < 0, first - (item << COUNT_BITS), first + root)
    bvh.links[:, span, 1] = np.where(after == END, past, after + root)


def _levels(left: Ints, right: Ints) -> tuple[Ints, list[tuple[Ints, int, int, int]]]:
    """Return the order of nodes level by level, and from the bottom up what joins each level to the one below.

    `left` and `right` are the children, -1 for those of leaves. In the order a level has the left children of the inner
    nodes above it, then the right ones: from `first` to `middle` and from there to `past`. `inner` are these nodes'
    places in the order.
    """
    order, levels, nodes, begin = [], [], np.zeros(1, np.int64), 0
    while len(nodes):
        order.append(nodes)
        inner = np.flatnonzero(left[nodes] >= 0)
        first = begin + len(nodes)
        levels.append((begin + inner, first, first + len(inner), first + 2 * len(inner)))
        nodes, begin = np.concatenate([left[nodes[inner]], right[nodes[inner]]]), first
    return np.concatenate(order), levels[-2::-1]
