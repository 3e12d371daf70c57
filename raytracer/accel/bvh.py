"""The bounding volume hierarchy: boxes within boxes, each with links to the next box to visit.

Stage: accelerate. Takes corners (N, 3, 3), gives a `Bvh`: for every node a box, and for every octant of ray directions
two links, one to follow if the ray meets the box and one if it misses. A ray that follows them visits the nodes depth
first, the nearer child first, and needs no stack (Smits 1998, whose skip pointers exist here once per octant).

A node is split where the surface area heuristic is least, estimated at the borders of bins along each axis (Wald 2007).
All nodes of a level are split at once, by numpy; there is no recursion and no loop over nodes.

>>> bvh = build_bvh(np.eye(3)[None])
>>> bvh.items.tolist(), bvh.links[0].tolist()
([0], [[-2, -1]])
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

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
"""The cost of visiting the two nodes below a cut; the test of a triangle costs 1."""
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


def build_bvh(corners: NDArray[np.floating], dtype: DTypeLike = np.float32) -> Bvh:
    """Build the BVH of triangles with `corners` (N, 3, 3), N > 0; boxes hold them when rounded to `dtype`."""
    triangles = np.asarray(corners, dtype=np.float64).reshape(-1, 3, 3)
    lows, highs = triangles.min(axis=1), triangles.max(axis=1)
    levels, order = cut_apart(*unit_boxes(lows, highs), MAX_LEAF)
    return _flattened(levels, order, *grown(lows[order], highs[order], np.dtype(dtype)))


def grown(lows: NDArray[np.float64], highs: NDArray[np.float64], dtype: np.dtype[Any]) -> tuple[Bounds, Bounds]:
    """Round boxes to `dtype` and grow them by a rounding of their coordinates, so that no triangle lies in a face."""
    grow = growth_of(largest_of(np.maximum(np.abs(lows), np.abs(highs))), dtype)[:, None]
    return (lows - grow).astype(dtype), (highs + grow).astype(dtype)


def growth_of(largest: NDArray[np.floating], dtype: np.dtype[Any]) -> NDArray[np.float64]:
    """Return by how much boxes are grown, given the largest coordinate of each, (N,)."""
    return float(np.finfo(dtype).eps) * largest.astype(np.float64) + GROWTH


def unit_boxes(lows: NDArray[np.float64], highs: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """Scale boxes into the unit cube, so that areas neither vanish nor overflow."""
    low = lows.min(axis=0)
    size = float((highs - low).max()) or 1.0
    return ((lows - low) / size).astype(np.float32), ((highs - low) / size).astype(np.float32)


@dataclass(slots=True, eq=False)
class Level:
    """The nodes at one depth: the range of the order that each holds, its first child in the next level, its axis.

    `axis` is that of the split. `child` is -1 for a leaf; the second child follows the first.
    """

    start: Ints
    count: Ints
    child: Ints
    axis: Ints


def cut_apart(lows: Floats, highs: Floats, most: int, deepest: float = np.inf) -> tuple[list[Level], Ints]:
    """Split boxes (N, 3) level by level; return the levels of nodes, and the order of the boxes in them.

    A leaf holds at most `most` boxes. Nodes of the level `deepest` and below are split in the middle of their order,
    which bounds the number of levels.
    """
    order = np.arange(len(lows))
    levels = []
    start, count = np.zeros(1, np.int64), np.full(1, len(lows))
    while len(start):
        level = Level(start, count, np.full(len(start), -1), np.zeros(len(start), np.int64))
        levels.append(level)
        open_ = np.flatnonzero(count > 1)
        axis, left = np.zeros((2, len(open_)), np.int64)
        is_pair = (count[open_] == 2) & (most == 1)
        pairs, others = open_[is_pair], open_[~is_pair]
        axis[is_pair], left[is_pair] = _pair_cuts(lows, highs, order, start[pairs]), 1
        axis[~is_pair], left[~is_pair] = _best_cuts(
            lows, highs, order, start[others], count[others], most, len(levels) > deepest
        )
        cut = left > 0
        parents, left = open_[cut], left[cut]
        level.axis[parents] = axis[cut]
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
    lows: Floats, highs: Floats, order: Ints, start: Ints, count: Ints, most: int, halves: bool
) -> tuple[Ints, Ints]:
    """Split each node where that is cheapest, or with `halves` in the middle, and reorder its part of `order`.

    Returns the axis of each split, and the number of boxes before it: 0 where a leaf is cheaper.
    """
    if not len(start):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    node, place, within = _members(start, count)
    begins = np.cumsum(count) - count
    box = order[place]
    low, high = lows[box], highs[box]
    bins = _binned(low + high, node, begins)
    cost, axis, border = _cheapest(low, high, bins, node, len(start))
    area = half_area((np.maximum.reduceat(high, begins) - np.minimum.reduceat(low, begins)).T)
    cut = (cost + DESCENT * area < area * count) | (count > most)
    # Boxes that no border parts are halved as they stand.
    before = np.where((np.isfinite(cost) & (not halves))[node], bins[axis[node], np.arange(len(node))] <= border[node],
                      within < (count // 2)[node])  # fmt: skip
    before &= cut[node]
    left = np.add.reduceat(before, begins, dtype=np.int64)
    ahead = np.cumsum(before) - before  # how many come before, in all nodes so far
    ahead -= ahead[begins][node]
    moved = np.where(before, ahead, left[node] + within - ahead)
    order[start[node] + moved] = box
    return axis, left


def _members(start: Ints, count: Ints) -> tuple[Ints, Ints, Ints]:
    """Return for all boxes of all nodes, node by node: the node, the place in the order, and the place in the node."""
    node = np.repeat(np.arange(len(start)), count)
    within = np.arange(len(node)) - (np.cumsum(count) - count)[node]
    return node, start[node] + within, within


def _binned(centers: Floats, node: Ints, begins: Ints) -> Ints:
    """Return the bin of each center along each axis of its node, (3, K)."""
    low = np.minimum.reduceat(centers, begins)
    extent = np.maximum.reduceat(centers, begins) - low
    scale = np.divide(BINS, extent, out=np.zeros_like(extent), where=extent > _NARROW)
    bins = np.minimum((centers - low[node]) * scale[node], BINS - 1)
    return np.ascontiguousarray(bins.T.astype(np.int64))


def _cheapest(low: Floats, high: Floats, bins: Ints, node: Ints, nodes: int) -> tuple[Floats, Ints, Ints]:
    """Find for each node the least cost of the boxes below a cut, its axis, and the last bin before it.

    The cost is infinite where all boxes are in one bin.
    """
    costs = np.empty((3, BINS - 1, nodes), np.float32)
    for axis in range(3):
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


def _flattened(levels: list[Level], order: Ints, lows: Bounds, highs: Bounds) -> Bvh:
    """Build the nodes of all levels, numbered depth first: boxes from the bottom up, links from the top down."""
    numbers = _depth_first(levels)
    total = sum(len(level.start) for level in levels)
    low, high = np.empty((total, 3), lows.dtype), np.empty((total, 3), lows.dtype)
    links = np.full((8, total, 2), END, np.int32)
    for depth in reversed(range(len(levels))):
        level, number = levels[depth], numbers[depth]
        leaf = level.child < 0
        if leaf.any():
            ends = np.stack([level.start, level.start + level.count], axis=1)[leaf].reshape(-1)
            low[number[leaf]] = _reduced(np.minimum, lows, ends)
            high[number[leaf]] = _reduced(np.maximum, highs, ends)
            links[:, number[leaf], 0] = -1 - (level.start[leaf] << COUNT_BITS | level.count[leaf])
        if not leaf.all():
            below = numbers[depth + 1]
            left, right = below[level.child[~leaf]], below[level.child[~leaf] + 1]
            low[number[~leaf]] = np.minimum(low[left], low[right])
            high[number[~leaf]] = np.maximum(high[left], high[right])
    for depth, (level, number) in enumerate(zip(levels[:-1], numbers[:-1], strict=True)):
        inner = level.child >= 0
        children = np.stack([numbers[depth + 1][level.child[inner] + k] for k in (0, 1)])
        for octant in range(8):
            swapped = octant >> level.axis[inner] & 1
            near, far = children[swapped, np.arange(len(swapped))], children[1 - swapped, np.arange(len(swapped))]
            links[octant, number[inner], 0] = near
            links[octant, near, 1] = far
            links[octant, far, 1] = links[octant, number[inner], 1]
    return Bvh(low, high, links, order.astype(np.int32))


def _reduced(reduce: np.ufunc, rows: Bounds, ends: Ints) -> Bounds:
    """Return the reduction of rows[a:b] for each pair a < b that follow one another in `ends`."""
    padded = np.concatenate([rows, rows[-1:]])
    return np.asarray(reduce.reduceat(padded, ends)[::2])


def _depth_first(levels: list[Level]) -> list[Ints]:
    """Return the number of each node of each level, so that a first child follows its parent."""
    sizes = [np.ones(len(level.start), np.int64) for level in levels]
    for level, size, below in zip(levels[-2::-1], sizes[-2::-1], sizes[:0:-1], strict=True):
        inner = level.child >= 0
        size[inner] += below[level.child[inner]] + below[level.child[inner] + 1]
    numbers = [np.zeros(1, np.int64)]
    for level, below in zip(levels[:-1], sizes[1:], strict=True):
        inner = level.child >= 0
        first = numbers[-1][inner] + 1
        pairs = np.stack([first, first + below[level.child[inner]]], axis=1)
        numbers.append(pairs.reshape(-1))
    return numbers


def target_for(triangles: int, backend: str) -> str:
    """Return the backend that builds a hierarchy, the same on each, over `triangles`: numpy below `MANY`."""
    return backend if triangles >= MANY else "numpy"
