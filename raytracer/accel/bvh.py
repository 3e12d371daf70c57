"""The bounding volume hierarchy: boxes within boxes, each with links to the next box to visit.

Stage: accelerate. A `Bvh` has for every node a box, and for every octant of ray directions two links, one to follow if
the ray meets the box and one if it misses. A ray that follows them visits the nodes depth first, the nearer child
first, and needs no stack (Smits 1998, whose skip pointers exist here once per octant). `ploc.build_bvh` builds it.

`cut_apart` makes the nodes near the root. A node is split where the surface area heuristic is least, estimated at the
borders of bins along each axis (Wald 2007). All nodes of a level are split at once, by numpy.

>>> levels, order = cut_apart(np.float32([[0, 0, 0], [2, 0, 0]]), np.float32([[1, 1, 1], [3, 1, 1]]), np.inf)
>>> [level.child.tolist() for level in levels], order.tolist()
([[0], [-1, -1]], [0, 1])
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.planes import largest_of

Floats = NDArray[np.float32]
Bounds = NDArray[np.floating]
Ints = NDArray[np.int64]

BINS = 16
MAX_LEAF = 4
"""Triangles of a leaf, at most: as many as a block of `accel.wide` holds."""
COUNT_BITS = 3
GROWTH = 2.0**-67
"""By how much boxes are grown at least: more than `kernels.triangle` grows those of triangles."""
DESCENT = 3.0
"""The cost of visiting the two nodes below a node; the test of a triangle costs 1."""
SIZED = 8
"""Levels in which boxes are split by their surfaces, too, so that walls and floors stand apart from small triangles.

Otherwise each node between them would be as large: the surfaces of all inner nodes, in units of the root's, would be
10.6 in place of 5.8 for balls of 100,000 triangles in a room, and 4.0 in place of 1.0 for the scene `mixed`. Path
traced pictures of that room take .9 of the time.
"""
_NARROW = BINS / np.finfo(np.float32).max
"""Extent up to which a node is not cut into bins, whose number in a unit of length would be infinite."""
END = -1
"""The link that ends the walk."""
MANY = 1 << 16
"""Triangles from which on a backend that compiles the kernels of a builder takes less time than numpy."""


@dataclass(frozen=True, slots=True, eq=False)
class Bvh:
    """A box (`low`, `high`), each (M, 3), for each of M nodes; `items` (N,) int32 are the triangles, leaf by leaf.

    `links` (8, M, 2) int32 holds for each octant and node the node to visit after the box is hit, and the node to visit
    after it is missed; END ends the walk. Bit a of the octant is set if the rays' component a is negative. The first
    link of a leaf is negative: `-1 - (first << COUNT_BITS | count)` says that it holds `items[first : first + count]`.
    """

    low: Bounds
    high: Bounds
    links: NDArray[np.int32]
    items: NDArray[np.int32]

    @property
    def bytes(self) -> int:
        """The size of all tables."""
        return sum(table.nbytes for table in (self.low, self.high, self.links, self.items))


def grown(lows: NDArray[np.float64], highs: NDArray[np.float64], dtype: np.dtype[Any]) -> tuple[Bounds, Bounds]:
    """Round boxes to `dtype` and grow them by a rounding of their coordinates, so that no triangle lies in a face."""
    grow = growth_of(largest_of(np.maximum(np.abs(lows), np.abs(highs))), dtype)[:, None]
    return (lows - grow).astype(dtype), (highs + grow).astype(dtype)


def growth_of(largest: NDArray[np.floating], dtype: np.dtype[Any]) -> NDArray[np.float64]:
    """Return by how much boxes are grown, given the largest coordinate of each, (N,)."""
    return float(np.finfo(dtype).eps) * largest.astype(np.float64) + GROWTH


@dataclass(slots=True, eq=False)
class Level:
    """The nodes at one depth: where the boxes of each begin in the order, its first child in the next level, its axis.

    `axis` is that of the split. `child` is -1 for a leaf; the second child follows the first.
    """

    start: Ints
    child: Ints
    axis: Ints


def cut_apart(lows: Floats, highs: Floats, deepest: float) -> tuple[list[Level], Ints]:
    """Split boxes (N, 3) level by level; return the levels of nodes, and the order of the boxes, which are the leaves.

    Nodes of the level `deepest` and below are split in the middle of their order, which bounds the number of levels.
    """
    order = np.arange(len(lows))
    middles, surfaces = lows + highs, half_area((highs - lows).T)[:, None]
    keys = np.concatenate([middles, surfaces], axis=1)
    levels: list[Level] = []
    start, count = np.zeros(1, np.int64), np.full(1, len(lows))
    while len(start):
        level = Level(start, np.full(len(start), -1), np.zeros(len(start), np.int64))
        levels.append(level)
        parents = np.flatnonzero(count > 1)
        axis, left = np.zeros((2, len(parents)), np.int64)
        is_pair = count[parents] == 2
        pairs, others = parents[is_pair], parents[~is_pair]
        axis[is_pair], left[is_pair] = _pair_cuts(lows, highs, order, start[pairs]), 1
        axis[~is_pair], left[~is_pair] = _best_cuts(
            (lows, highs, middles if len(levels) > SIZED else keys),
            *(order, start[others], count[others], len(levels) > deepest),
        )
        level.axis[parents] = axis
        level.child[parents] = 2 * np.arange(len(parents))
        start = np.stack([start[parents], start[parents] + left], axis=1).reshape(-1)
        count = np.stack([left, count[parents] - left], axis=1).reshape(-1)
    return levels, order


def _pair_cuts(lows: Floats, highs: Floats, order: Ints, start: Ints) -> Ints:
    """Split the two boxes of each node along an axis on which their centres differ: each split costs the same.

    Returns the axes.
    """
    pair = order[np.stack([start, start + 1])]
    one, other = lows[pair] + highs[pair]
    axis: Ints = (one != other).argmax(axis=1)
    place = np.arange(len(start))
    turned = one[place, axis] > other[place, axis]
    order[start[turned]], order[start[turned] + 1] = pair[::-1, turned]
    return axis


def _best_cuts(
    boxes: tuple[Floats, Floats, Floats], order: Ints, start: Ints, count: Ints, halves: bool
) -> tuple[Ints, Ints]:
    """Split each node where that is cheapest, or with `halves` in the middle, and reorder its part of `order`.

    Of `boxes` there are the lower and the upper sides, and the keys by which they are split: twice their middles, and
    maybe their surfaces.

    Returns the axis of each split, the first one for a split by surfaces, and the number of boxes before it.
    """
    if not len(start):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    node, place, within = _members(start, count)
    begins = np.cumsum(count) - count
    box = order[place]
    low, high, keys = (part[box] for part in boxes)
    bins = _binned(keys, node, begins)
    cost, axis, border = _cheapest(low, high, bins, node, len(start))
    # Nodes that no plane divides are halved in their present order.
    before = np.where((np.isfinite(cost) & (not halves))[node], bins[axis[node], np.arange(len(node))] <= border[node],
                      within < (count // 2)[node])  # fmt: skip
    left = np.add.reduceat(before, begins, dtype=np.int64)
    ahead = np.cumsum(before) - before  # the number of triangles in all nodes before
    ahead -= ahead[begins][node]
    moved = np.where(before, ahead, left[node] + within - ahead)
    order[start[node] + moved] = box
    return axis % 3, left


def _members(start: Ints, count: Ints) -> tuple[Ints, Ints, Ints]:
    """Return for all boxes of all nodes, node by node: the node, the place in the order, and the place in the node."""
    node = np.repeat(np.arange(len(start)), count)
    within = np.arange(len(node)) - (np.cumsum(count) - count)[node]
    return node, start[node] + within, within


def _binned(keys: Floats, node: Ints, begins: Ints) -> Ints:
    """Return the bin of each of K boxes in its node by each of its keys (K, n), (n, K)."""
    low = np.minimum.reduceat(keys, begins)
    extent = np.maximum.reduceat(keys, begins) - low
    scale = np.divide(BINS, extent, out=np.zeros_like(extent), where=extent > _NARROW)
    bins = np.minimum((keys - low[node]) * scale[node], BINS - 1)
    return np.ascontiguousarray(bins.T.astype(np.int64))


def _cheapest(low: Floats, high: Floats, bins: Ints, node: Ints, nodes: int) -> tuple[Floats, Ints, Ints]:
    """Find for each node the least cost of the boxes below a cut, the row of its bins, and the last bin before it.

    The cost is infinite where all boxes are in one bin.
    """
    costs = np.empty((len(bins), BINS - 1, nodes), np.float32)
    for axis in range(len(bins)):
        key = bins[axis] * nodes + node  # nodes stand side by side, for numpy to sweep all of them at once
        counts = np.bincount(key, minlength=BINS * nodes).reshape(BINS, nodes)
        flat = np.full((6, BINS * nodes), np.inf, np.float32)
        for k in range(3):
            np.minimum.at(flat[k], key, low[:, k])
            np.minimum.at(flat[3 + k], key, -high[:, k])
        bounds = flat.reshape(6, BINS, nodes)
        costs[axis] = _one_side(bounds, counts) + _one_side(bounds[:, ::-1], counts[::-1])[::-1]
    by_border = costs.reshape(-1, nodes)
    best = by_border.argmin(axis=0)
    return by_border[best, np.arange(nodes)], best // (BINS - 1), best % (BINS - 1)


def _one_side(bounds: Floats, counts: Ints) -> Floats:
    """Return area times count of the bins up to each border, (BINS - 1, nodes); infinite for no boxes."""
    reach = bounds[:, :-1].copy()
    for k in range(1, BINS - 1):  # several times as fast as minimum.accumulate
        np.minimum(reach[:, k - 1], reach[:, k], out=reach[:, k])
    number = np.cumsum(counts[:-1], axis=0)
    with np.errstate(invalid="ignore"):
        cost = half_area(-(reach[3:] + reach[:3])) * number
    return np.where(number > 0, cost, np.inf).astype(np.float32)


def half_area(extent: Floats) -> Floats:
    """Return half the surface of boxes with these extents (3, ...)."""
    x, y, z = extent
    return np.asarray(x * y + y * z + z * x)


def target_for(triangles: int, backend: str) -> str:
    """Return the backend that builds a hierarchy, the same on each, over `triangles`: numpy below `MANY`."""
    return backend if triangles >= MANY else "numpy"
