"""A hierarchy from the bottom up: clusters beside each other on a Morton curve are joined in pairs, many at a time.

Stage: accelerate. Takes corners (N, 3, 3), gives a `Bvh`, in a third to a quarter of the time of `bvh.build_bvh`.
Triangles are sorted along a Morton curve. In each round every cluster finds, among its `REACH` neighbours on either
side, the one with which it makes the smallest box; two clusters that find each other are joined (Meister and Bittner
2018, parallel locally ordered clustering). Neighbours on the curve say little about large clusters, so the last
clusters are cut apart by the surface area heuristic, as in `bvh`.

>>> bvh = build_ploc(np.eye(3)[None])
>>> bvh.items.tolist(), bvh.links[0].tolist()
([0], [[-2, -1]])
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raytracer.accel.bvh import COUNT_BITS, END, MAX_LEAF, Bounds, Bvh, Floats, Ints, cut_apart, grown, unit_boxes

REACH = 8
"""Neighbours on either side among which a cluster looks for its partner."""
PROGRESS = 8
"""A round that joins fewer than one cluster in this many joins all pairs of neighbours, which bounds the rounds."""
CLUSTER = 16
"""Triangles of a cluster, on average, from which on nodes are cut from the top down."""
CHUNK = 8192
"""Clusters whose boxes fit a processor's cache together; an even number."""


def build_ploc(corners: NDArray[np.floating], dtype: DTypeLike = np.float32) -> Bvh:
    """Build the BVH of triangles with `corners` (N, 3, 3), N > 0; boxes hold them when rounded to `dtype`."""
    a, b, c = np.asarray(corners, dtype=np.float64).reshape(-1, 3, 3).transpose(1, 0, 2)
    lows, highs = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    low, high = unit_boxes(lows, highs)
    order = morton_order(low + high)
    joined = _joined(np.concatenate([low.T, -high.T])[:, order])
    return _linked(_numbered(joined, order), *grown(lows, highs, np.dtype(dtype)))


def morton_order(places: Floats) -> Ints:
    """Return the order of places (N, 3) in [0, 2] along a Morton curve; those in one cell stay in order."""
    index_bits = max(1, (len(places) - 1).bit_length())
    bits = min(20, (63 - index_bits) // 3)
    cells = np.minimum(places.T * np.float32(1 << (bits - 1)), (1 << bits) - 1).astype(np.uint64)
    x, y, z = (_spread(cell) for cell in cells)
    # The place itself is the last part of the key: keys differ, so that any sort gives the same order.
    keys = (x | y << np.uint64(1) | z << np.uint64(2)) << np.uint64(index_bits) | np.arange(
        len(places), dtype=np.uint64
    )
    keys.sort()
    return np.asarray(keys & np.uint64((1 << index_bits) - 1), np.int64)


def _spread(cell: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Move bit k of numbers below 2**21 to bit 3 k."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        cell = (cell | cell << np.uint64(shift)) & np.uint64(mask)
    return cell


class _Joined:
    """A binary tree over N boxes that is made in rounds: node k < N is box k, the others follow their children.

    `left`, `right` and `axis` (N - 1,) belong to the nodes from N on: their children, and the axis along which the left
    one lies lower. `count` (2N - 1,) is how many boxes a node holds. `rounds` are slices of the nodes from N on, in the
    order in which they were made.
    """

    def __init__(self, total: int) -> None:
        self.total = self.made = total
        self.left, self.right, self.axis = np.zeros((3, total - 1), np.int64)
        self.count = np.ones(2 * total - 1, np.int64)
        self.rounds: list[slice] = []

    def add(self, left: Ints, right: Ints, axis: Ints) -> Ints:
        """Make a node of each two nodes; return the numbers of the new nodes."""
        new = slice(self.made - self.total, self.made - self.total + len(left))
        self.left[new], self.right[new], self.axis[new] = left, right, axis
        nodes = np.arange(self.made, self.made + len(left))
        self.count[nodes] = self.count[left] + self.count[right]
        self.made += len(left)
        self.rounds.append(new)
        return nodes


def _joined(boxes: Floats) -> _Joined:
    """Join boxes (6, N), three lower sides and three negated upper sides, neighbours on a curve, to a tree."""
    tree = _Joined(boxes.shape[1])
    node = np.arange(tree.total)
    while len(node) * CLUSTER > tree.total + CLUSTER:
        first, second = _partners(boxes)
        a, b = boxes[:, first], boxes[:, second]
        apart = (b[:3] - b[3:]) - (a[:3] - a[3:])  # twice the way from middle to middle
        axis = np.abs(apart).argmax(axis=0)
        turned = apart[axis, np.arange(len(axis))] < 0
        one, other = node[first], node[second]
        boxes[:, first] = np.minimum(a, b)
        node[first] = tree.add(np.where(turned, other, one), np.where(turned, one, other), axis)
        kept = np.ones(len(node), bool)
        kept[second] = False
        boxes, node = boxes[:, kept], node[kept]
    _cut_above(tree, boxes, node)
    return tree


def _cut_above(tree: _Joined, boxes: Floats, clusters: Ints) -> None:
    """Make the nodes above clusters with these boxes from the top down; see `bvh.cut_apart`."""
    levels, order = cut_apart(np.ascontiguousarray(boxes[:3].T), np.ascontiguousarray(-boxes[3:].T), 1)
    below = np.zeros(0, np.int64)
    for level in reversed(levels):
        nodes, inner = clusters[order[level.start]], level.child >= 0
        first = level.child[inner]
        nodes[inner] = tree.add(below[first], below[first + 1], level.axis[inner])
        below = nodes


def _partners(boxes: Floats) -> tuple[Ints, Ints]:
    """Return the places of clusters that are joined, first and second of each pair, in order of the first."""
    total = boxes.shape[1]
    partner = np.empty(total, np.int64)
    for start in range(0, total, CHUNK):
        # With neighbours of neighbours on both sides; an even number of them, for the places' parity.
        begin, end = max(start - REACH - REACH % 2, 0), min(start + CHUNK + REACH, total)
        found = _nearest(boxes[:, begin:end])
        partner[start : start + CHUNK] = begin + found[start - begin : start - begin + CHUNK]
    place = np.arange(total)
    first = np.flatnonzero((partner > place) & (partner[partner] == place))
    if len(first) * PROGRESS < total - 1:
        first = place[: total - 1 : 2]
        return first, first + 1
    return first, partner[first]


def _nearest(boxes: Floats) -> Ints:
    """Return for each box (6, N) the place of that within `REACH` with which it makes the smallest box.

    Of pairs of the same surface those count that are closer, then those that begin at an even place, then the first.
    All boxes agree on this order, so two find each other at least; and of equal boxes all do.
    """
    total = boxes.shape[1]
    best = np.full(total, np.inf, np.float32)
    step = np.zeros(total, np.int64)
    for apart in range(1, min(REACH, total - 1) + 1):
        both = np.minimum(boxes[:, :-apart], boxes[:, apart:])
        x, y, z = both[:3] + both[3:]  # extents, negative all three
        area = x * (y + z) + y * z
        if apart == 1:
            best[1:], step[1:] = area, -1
            even = np.arange(total - 1) % 2 == 0
            better = (area < best[:-1]) | (even & (area == best[:-1]))
        else:
            late = best[apart:]
            better = area < late
            np.copyto(late, area, where=better)
            np.copyto(step[apart:], -apart, where=better)
            better = area < best[:-apart]
        np.copyto(best[:-apart], area, where=better)
        np.copyto(step[:-apart], apart, where=better)
    return np.arange(total) + step


@dataclass(frozen=True, slots=True, eq=False)
class _Numbered:
    """The nodes of a tree depth first: `leaf` and, for each round, `inner`.

    `items` (N,) are the triangles, leaf by leaf. A row of `leaf` (L, 3) is a leaf's number, its first item, and how
    many it holds. A row of `inner` (n, 4) is a node's number, its children's, and the axis along which the
    first lies lower.
    """

    items: Ints
    leaf: Ints
    inner: list[Ints]


def _numbered(tree: _Joined, order: Ints) -> _Numbered:
    """Give the nodes numbers, depth first; a node of `MAX_LEAF` triangles or fewer is a leaf."""
    count, total = tree.count, tree.total
    size = np.ones(len(count), np.int64)  # of the nodes of a tree below
    for own in tree.rounds:
        nodes = slice(own.start + total, own.stop + total)
        size[nodes] += np.where(count[nodes] > MAX_LEAF, size[tree.left[own]] + size[tree.right[own]], 0)
    begin, number = np.zeros((2, len(count)), np.int64)
    for own in reversed(tree.rounds):
        nodes = slice(own.start + total, own.stop + total)
        left, right = tree.left[own], tree.right[own]
        begin[left], begin[right] = begin[nodes], begin[nodes] + count[left]
        number[left], number[right] = number[nodes] + 1, number[nodes] + 1 + size[left]
    items = np.empty(total, np.int64)
    items[begin[:total]] = order
    rows = np.stack([number[total:], number[tree.left], number[tree.right], tree.axis], axis=1)
    is_inner = count[total:] > MAX_LEAF
    there = np.zeros(len(count), bool)
    there[-1] = there[tree.left[is_inner]] = there[tree.right[is_inner]] = True
    leaf = np.flatnonzero(there & (count <= MAX_LEAF))
    leaf = leaf[np.argsort(begin[leaf])]
    return _Numbered(
        items, np.stack([number, begin, count], axis=1)[leaf], [rows[own][is_inner[own]] for own in tree.rounds]
    )


def _linked(tree: _Numbered, lows: Bounds, highs: Bounds) -> Bvh:
    """Build the boxes of all nodes from the bottom up, their links from the top down; `lows`, `highs` of triangles."""
    nodes = len(tree.leaf) + sum(map(len, tree.inner))
    low, high = np.empty((2, nodes, 3), lows.dtype)
    links = np.full((nodes, 8, 2), END, np.int32)
    number, begin, count = tree.leaf.T
    low[number] = np.minimum.reduceat(lows[tree.items], begin)
    high[number] = np.maximum.reduceat(highs[tree.items], begin)
    links[number, :, 0] = (-1 - (begin << COUNT_BITS | count))[:, None]
    for node, left, right, _ in (rows.T for rows in tree.inner):
        low[node], high[node] = np.minimum(low[left], low[right]), np.maximum(high[left], high[right])
    for node, left, right, axis in (rows.T for rows in reversed(tree.inner)):
        turned = (np.arange(8) >> axis[:, None] & 1).astype(bool)
        near, far = np.where(turned, right[:, None], left[:, None]), np.where(turned, left[:, None], right[:, None])
        past = links[node, :, 1]
        links[node, :, 0] = near
        links[left, :, 1], links[right, :, 1] = np.where(turned, past, far), np.where(turned, far, past)
    return Bvh(low, high, np.ascontiguousarray(links.transpose(1, 0, 2)), tree.items.astype(np.int32))
