"""The hierarchy with eight boxes a node and four triangles a leaf: what one ray can try at once on vectors of four.

Stage: accelerate. Takes a `Bvh` and the corners of its triangles, gives a `WideBvh`. What holds four triangles or fewer
is a leaf. A node takes the place of up to seven of the two-armed ones; of all ways to choose them that is taken whose
nodes have the least surface in all, for so often are they looked into (Ylitie, Karras and Laine 2017).

>>> from raytracer.accel.bvh import build_bvh
>>> wide = widen(build_bvh(np.eye(3)[None]), np.eye(3)[None])
>>> wide.records.shape, wide.records[0, FIRST, 0].tolist(), wide.records[1, NUMBERS].tolist()
((2, 16, 4), 1, [0, 4294967295, 4294967295, 4294967295])
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.bvh import COUNT_BITS, Bounds, Bvh
from raytracer.accel.planes import levels_of, normals_of

Ints = NDArray[np.int64]
Words = NDArray[np.uint32]

WIDTH = 8
"""Boxes of a node."""
HALF = 4
"""Numbers in a row; triangles of a block."""
ROWS = 16
"""Rows of a record, whether it is a node or a block."""
TAGS, FIRST = 12, 14
"""Rows of a node: after two rows for each lower and each upper side."""
NUMBERS = 9
"""Row of a block: after three rows for each corner."""
NORMALS, LEVEL = 10, 13
"""Rows of a block: three for the unit normal, and one for the plane's level."""
LEAF = 8
"""Bit of a tag: the box is that of a block. The bits below it are a number among its siblings."""
_FAR = np.float32(3e38)


@dataclass(frozen=True, slots=True, eq=False)
class WideBvh:
    """`records` (M, 16, 4), each 16 rows of four 32-bit words; `depth` is the number of levels of nodes.

    The first record is a node, the others nodes and blocks, siblings side by side. A node: the lower sides of its eight
    boxes along x, y and z as floats, the upper sides, the boxes' tags, and the number of its first child's record. A
    box that is not there is inside out. A block: x, y and z of four triangles' first corners, of the second, of the
    third, their numbers, unit normals and levels (see `mesh.levels_of`); one that is not there has no area and the
    number -1.
    """

    records: Words
    depth: int


@dataclass(frozen=True, slots=True, eq=False)
class _Binary:
    """The nodes of the two-armed hierarchy: boxes (M, 3), which items each holds, its two children, -1 for a leaf."""

    low: Bounds
    high: Bounds
    start: Ints
    count: Ints
    left: Ints
    right: Ints


def widen(bvh: Bvh, corners: NDArray[np.floating]) -> WideBvh:
    """Return the wide form of a hierarchy over triangles with `corners` (N, 3, 3), all rounded to f32."""
    tree = _with_small_leaves(_binary(bvh))
    levels = _gathered(_shares(tree), tree)
    children = np.concatenate(levels)
    there = children >= 0
    kids = children[there]
    is_block = np.concatenate([[False], tree.count[kids] <= HALF])
    records = np.zeros((len(is_block), ROWS, HALF), np.uint32)
    records[~is_block] = _nodes(tree, children)
    blocks = kids[is_block[1:]]
    records[is_block, : LEVEL + 1] = _blocks(bvh, corners, tree.start[blocks], tree.count[blocks])
    return WideBvh(records, len(levels))


def _binary(bvh: Bvh) -> _Binary:
    """Return the nodes of a hierarchy, with what follows from its links."""
    first, past = bvh.links[0].T.astype(np.int64)
    code = -1 - first
    held = np.where(first < 0, code & ((1 << COUNT_BITS) - 1), 0)
    before = np.concatenate([[0], np.cumsum(held)])
    end = np.where(past < 0, len(first), past)  # nodes are numbered depth first: here what a node holds ends
    left = np.where(first < 0, -1, first)
    right = np.where(first < 0, -1, past[np.maximum(first, 0)])
    return _Binary(bvh.low, bvh.high, before[:-1], before[end] - before[:-1], left, right)


def _with_small_leaves(tree: _Binary) -> _Binary:
    """Return the nodes with two leaves in the box of each leaf that holds more triangles than a block.

    A leaf of a `Bvh` has room for seven triangles, so two blocks hold them.
    """
    large = np.flatnonzero((tree.left < 0) & (tree.count > HALF))
    if not len(large):
        return tree
    box = np.concatenate([np.arange(len(tree.count)), np.repeat(large, 2)])
    start = np.concatenate([tree.start, np.stack([tree.start[large], tree.start[large] + HALF], axis=1).reshape(-1)])
    count = np.concatenate(
        [tree.count, np.stack([np.full(len(large), HALF), tree.count[large] - HALF], axis=1).reshape(-1)]
    )
    left, right = (np.concatenate([arm, np.full(2 * len(large), -1)]) for arm in (tree.left, tree.right))
    left[large] = len(tree.count) + 2 * np.arange(len(large))
    right[large] = left[large] + 1
    return _Binary(tree.low[box], tree.high[box], start, count, left, right)


def _shares(tree: _Binary) -> Ints:
    """Return (WIDTH + 1, M): how many of so many boxes a node's left child takes; 0 if one box for all costs less.

    From the bottom up: what a node holds costs, in so many boxes, the least that its children's cost in a part of them
    each; in one box the node's surface and what it costs in all boxes of a node.
    """
    count, left, right = tree.count, tree.left, tree.right
    extent = (tree.high - tree.low).astype(np.float64)
    area = extent[:, 0] * extent[:, 1] + extent[:, 1] * extent[:, 2] + extent[:, 2] * extent[:, 0]
    cost = np.tile(area, (WIDTH + 1, 1))
    share = np.zeros((WIDTH + 1, len(area)), np.int64)
    levels = [np.zeros(1, np.int64)]
    while len(levels[-1]):
        nodes = levels[-1][count[levels[-1]] > HALF]
        levels.append(np.concatenate([left[nodes], right[nodes]]))
    for level in reversed(levels):
        nodes = level[count[level] > HALF]
        one, other = cost[:, left[nodes]], cost[:, right[nodes]]
        own, parts = cost[:, nodes], share[:, nodes]
        for boxes in range(2, WIDTH + 1):
            least = one[1] + other[boxes - 1]
            part = np.ones(len(nodes), np.int64)
            for k in range(2, boxes):
                both = one[k] + other[boxes - k]
                np.copyto(part, k, where=both < least)
                np.minimum(least, both, out=least)
            own[boxes], parts[boxes] = least, part
        own[1] += own[WIDTH]
        whole = own[1] < own
        cost[:, nodes] = np.where(whole, own[1], own)
        share[:, nodes] = np.where(whole, 0, parts)
    return share


def _gathered(share: Ints, tree: _Binary) -> list[Ints]:
    """Return for each level the nodes whose boxes each wide node has (n, WIDTH), -1 where there are fewer."""
    levels = []
    nodes = np.zeros(1, np.int64)
    while len(nodes):
        children = np.full((len(nodes), WIDTH), -1)
        boxes = np.zeros((len(nodes), WIDTH), np.int64)
        children[:, 0], boxes[:, 0] = nodes, WIDTH
        while len((opened := np.nonzero(share[boxes, children]))[0]):
            node, whole = children[opened], boxes[opened]
            part = share[whole, node]
            beside = opened[0], opened[1] + part
            children[opened], boxes[opened] = tree.left[node], part
            children[beside], boxes[beside] = tree.right[node], whole - part
        levels.append(children)
        nodes = children[(children >= 0) & (tree.count[children] > HALF)]
    return levels


def _nodes(tree: _Binary, children: Ints) -> Words:
    """Return the records of nodes with these children (n, WIDTH), whose own records follow in this order."""
    there = children >= 0
    sides = np.empty((len(children), 2, 3, WIDTH), np.float32)
    sides[:, 0] = np.where(there[:, None], tree.low[children].transpose(0, 2, 1), _FAR)
    sides[:, 1] = np.where(there[:, None], tree.high[children].transpose(0, 2, 1), -_FAR)
    tags = np.cumsum(there, axis=1) - 1 | np.where(tree.count[children] <= HALF, LEAF, 0)
    family = there.sum(axis=1)
    nodes = np.zeros((len(children), ROWS, HALF), np.uint32)
    nodes[:, :TAGS].view(np.float32)[:] = sides.reshape(-1, TAGS, HALF)
    nodes[:, TAGS:FIRST] = np.where(there, tags, 0).reshape(-1, 2, HALF)
    nodes[:, FIRST, 0] = np.cumsum(family) - family + 1
    return nodes


def _blocks(bvh: Bvh, corners: NDArray[np.floating], start: Ints, count: Ints) -> Words:
    """Return the triangles of leaves, four at a time."""
    place = start[:, None] + np.arange(HALF)
    there = np.arange(HALF) < count[:, None]
    item = np.where(there, bvh.items[np.minimum(place, len(bvh.items) - 1)], -1)
    places = np.asarray(corners, np.float64)
    normals = normals_of(places)
    # A row for each triangle, and the last one, which is that of -1, for one that is not there.
    held = np.zeros((len(places) + 1, LEVEL + 1), np.uint32)
    floats = held[:-1].view(np.float32)
    floats[:, :NUMBERS] = np.reshape(corners, (-1, 9))
    floats[:, NORMALS:LEVEL], floats[:, LEVEL] = normals, levels_of(places, normals)
    held[:-1, NUMBERS], held[-1, NUMBERS] = np.arange(len(places)), 0xFFFFFFFF
    return held[item].transpose(0, 2, 1)
