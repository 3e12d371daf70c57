"""The hierarchy with four boxes a node and four triangles a leaf: what one ray can try at once on vectors of four.

Stage: accelerate. Takes a `Bvh` and the corners of its triangles, gives a `WideBvh`. A node takes the place of up to
three of the two-armed ones: of its boxes the largest is opened until there are four (Wald, Benthin and Boulos 2008).
What holds four triangles or fewer is a leaf.

>>> from raytracer.accel.bvh import build_bvh
>>> wide = widen(build_bvh(np.eye(3)[None]), np.eye(3)[None])
>>> wide.nodes.shape, wide.blocks.shape, wide.blocks[0, NUMBERS].tolist()
((1, 8, 4), (1, 10, 4), [0, 4294967295, 4294967295, 4294967295])
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.bvh import COUNT_BITS, Bvh

Ints = NDArray[np.int64]
Words = NDArray[np.uint32]

WIDTH = 4
TAGS, BASES = 6, 7
"""Rows of a node: after three rows of lower and three of upper sides."""
NUMBERS = 9
"""Row of a block: after three rows for each corner."""
LEAF = 4
"""Bit of a tag: the box is that of a leaf. The bits below it are a number among its siblings of that kind."""
BLOCKS_FROM = -(1 << 30)
"""What is added to a block's number, so that it is negative: a code says by its sign whether it means a node."""
_FAR = np.float32(3e38)


@dataclass(frozen=True, slots=True, eq=False)
class WideBvh:
    """`nodes` (M, 8, 4) and `blocks` (K, 10, 4), rows of four 32-bit words; `depth` is the number of levels of nodes.

    A node: the lower sides of its four boxes along x, y and z as floats, the upper sides, the boxes' tags, and the
    codes from which those of inner and of leaf children are counted. A box that is not there is inside out. A block:
    x, y and z of four triangles' first corners, of the second, of the third, and their numbers; one that is not there
    has no area and the number -1.
    """

    nodes: Words
    blocks: Words
    depth: int


def widen(bvh: Bvh, corners: NDArray[np.floating]) -> WideBvh:
    """The wide form of a hierarchy over triangles with `corners` (N, 3, 3), all rounded to f32."""
    start, count, left, right = _binary(bvh)
    levels = _gathered(bvh, count, left, right)
    children = np.concatenate(levels)
    there = children >= 0
    at = np.maximum(children, 0)
    leaf = there & (count[at] <= WIDTH)
    inner = there & ~leaf
    order, number = _numbered(children, inner, levels)
    children, leaf, inner, at = children[order], leaf[order], inner[order], at[order]

    rows = np.full((len(children), 8, WIDTH), 0, np.uint32)
    sides = rows[:, :TAGS].view(np.float32)
    sides[:, :3] = np.where(children[:, None] >= 0, bvh.low[at].transpose(0, 2, 1), _FAR)
    sides[:, 3:] = np.where(children[:, None] >= 0, bvh.high[at].transpose(0, 2, 1), -_FAR)
    rank = np.where(leaf, np.cumsum(leaf, axis=1), np.cumsum(inner, axis=1)) - 1
    rows[:, TAGS] = np.where(leaf, LEAF | rank, np.where(inner, rank, 0))
    bases = rows[:, BASES].view(np.int32)
    bases[:, 0] = number[order]
    bases[:, 1] = np.cumsum(leaf.sum(axis=1)) - leaf.sum(axis=1) + BLOCKS_FROM
    return WideBvh(rows, _blocks(bvh, corners, start[children[leaf]], count[children[leaf]]), len(levels))


def _binary(bvh: Bvh) -> tuple[Ints, Ints, Ints, Ints]:
    """For each node which of the items it holds, as start and count, and its two children, -1 for a leaf."""
    first, past = bvh.links[0].T.astype(np.int64)
    code = -1 - first
    held = np.where(first < 0, code & ((1 << COUNT_BITS) - 1), 0)
    before = np.concatenate([[0], np.cumsum(held)])
    end = np.where(past < 0, len(first), past)  # nodes are numbered depth first: here what a node holds ends
    left = np.where(first < 0, -1, first)
    right = np.where(first < 0, -1, past[np.maximum(first, 0)])
    return before[:-1], before[end] - before[:-1], left, right


def _gathered(bvh: Bvh, count: Ints, left: Ints, right: Ints) -> list[Ints]:
    """Level by level, for each wide node the nodes whose boxes it has (n, WIDTH), -1 where there is none."""
    extent = (bvh.high - bvh.low).astype(np.float64)
    area = extent[:, 0] * extent[:, 1] + extent[:, 1] * extent[:, 2] + extent[:, 2] * extent[:, 0]
    area = np.where(count > WIDTH, area, -1.0)  # what is not to be opened
    levels = []
    nodes = np.zeros(1, np.int64)
    while len(nodes):
        children = np.full((len(nodes), WIDTH), -1)
        children[:, 0] = nodes
        for k in range(1, WIDTH):
            areas = np.where(children >= 0, area[np.maximum(children, 0)], -1.0)
            widest = areas.argmax(axis=1)
            rows = np.flatnonzero(areas[np.arange(len(areas)), widest] >= 0)
            opened = children[rows, widest[rows]]
            children[rows, widest[rows]] = left[opened]
            children[rows, k] = right[opened]
        levels.append(children)
        nodes = children[(children >= 0) & (count[np.maximum(children, 0)] > WIDTH)]
    return levels


def _numbered(children: Ints, inner: NDArray[np.bool_], levels: list[Ints]) -> tuple[Ints, Ints]:
    """The nodes, which come level by level, in their final order, and the number of each one's first child there.

    Siblings stand side by side, and families as nearly depth first as that allows: what is visited together is
    together in memory.
    """
    total = len(children)
    family = inner.sum(axis=1)
    child = np.cumsum(family) - family + 1  # of each node the first, level by level
    size = np.ones(total, np.int64)
    ends = np.cumsum([len(level) for level in levels])
    for end, level in zip(ends[-2::-1], levels[-2::-1], strict=True):
        here = slice(end - len(level), end)
        below = np.concatenate([[0], np.cumsum(size[end:])])
        size[here] += below[child[here] - end + family[here]] - below[child[here] - end]
    first = np.ones(total, np.int64)  # of each node's children, in the final order
    place = np.zeros(total, np.int64)
    for end, level in zip(ends[:-1], levels[:-1], strict=True):
        parent = np.repeat(np.arange(end - len(level), end), family[end - len(level) : end])
        kids = np.arange(len(parent)) + end
        rank = kids - child[parent]
        place[kids] = first[parent] + rank
        before = np.cumsum(size[kids] - 1) - (size[kids] - 1)
        before -= before[child[parent] - end]
        first[kids] = first[parent] + family[parent] + before
    return np.argsort(place), first


def _blocks(bvh: Bvh, corners: NDArray[np.floating], start: Ints, count: Ints) -> Words:
    """The triangles of leaves, four at a time."""
    place = start[:, None] + np.arange(WIDTH)
    there = np.arange(WIDTH) < count[:, None]
    item = np.where(there, bvh.items[np.minimum(place, len(bvh.items) - 1)], -1)
    blocks = np.empty((len(start), NUMBERS + 1, WIDTH), np.uint32)
    held = np.asarray(corners, np.float32).reshape(-1, 9)[np.maximum(item, 0)]
    blocks[:, :NUMBERS].view(np.float32)[:] = np.where(there[:, None], held.transpose(0, 2, 1), 0)
    blocks[:, NUMBERS].view(np.int32)[:] = item
    return blocks
