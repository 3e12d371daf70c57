"""The hierarchy with eight boxes a node and four triangles a leaf: one ray tests them on vectors of four.

Stage: accelerate. Takes a `Bvh` and the corners of its triangles, gives a `WideBvh`. A node with four triangles
or fewer is a leaf. A wide node replaces up to seven binary nodes, which `families` chooses.

>>> from raytracer.accel.ploc import build_bvh
>>> wide = widen(build_bvh(np.eye(3)[None]), np.eye(3, 4), np.ones(1))
>>> wide.records.shape, wide.records[0, FIRST, 0].tolist(), wide.records[1, NUMBERS].tolist()
((2, 16, 4), 1, [0, 4294967295, 4294967295, 4294967295])
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.bvh import COUNT_BITS, Bvh, target_for
from raytracer.accel.families import HALF, WIDTH, Binary, families
from raytracer.accel.planes import constant, copy_columns, parts

Ints = NDArray[np.int64]
Words = NDArray[np.uint32]

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
RECORDS = 1024
"""Records of a table, at least.

To look whether an index is in range costs 8 % of a walk, so a table has as many as its kernel may ask for.
"""
_FAR = np.float32(3e38)


@dataclass(frozen=True, slots=True, eq=False)
class WideBvh:
    """`records` (M, 16, 4), each 16 rows of four 32-bit words; `depth` is the number of levels of nodes.

    `table` begins with the records; others follow, so that it has the children of every record up to `last`.

    The first record is a node, the others nodes and blocks, siblings side by side. A node: the lower sides of its eight
    boxes along x, y and z as floats, the upper sides, the boxes' tags, and the number of its first child's record. A
    box that is not there is inside out. A block: x, y and z of four triangles' first corners, of the second, of the
    third, their numbers, unit normals and levels (see `planes.levels_of`); one that is not there has no area and the
    number -1.
    """

    table: Words
    count: int
    depth: int

    @property
    def records(self) -> Words:
        """The records that are used."""
        return self.table[: self.count]

    @property
    def last(self) -> int:
        """The number to which kernels clamp those of records, a power of 2 less 1 that is in their texts."""
        return _last(self.count)


def _last(count: int) -> int:
    return max(RECORDS, 1 << (count - 1).bit_length()) - 1


def widen(bvh: Bvh, rows: NDArray[np.floating], levels: NDArray[np.floating], backend: str = "numpy") -> WideBvh:
    """Return the wide form of a hierarchy over triangles, whose numbers are rounded to f32.

    `rows` (3N, 4) are as in `triangle_rows`, `levels` (N,) how far the triangles' planes are from 0. The result is the
    same for every backend on which nodes are chosen.
    """
    tree = _binary(bvh)
    generations = families(tree, target_for(len(bvh.items), backend))
    children = np.concatenate(generations)
    there = children >= 0
    kids = children[there]
    is_block = np.concatenate([[False], tree.count[kids] <= HALF])
    count = len(is_block)
    table = np.zeros((_last(count) + WIDTH, ROWS, HALF), np.uint32)
    table[np.flatnonzero(~is_block)] = _nodes(tree, children)
    blocks = kids[is_block[1:]]
    items = _block_items(bvh, tree.start[blocks], tree.count[blocks])
    _put_blocks(table, np.flatnonzero(is_block), items, _words(rows, levels))
    return WideBvh(constant(table), count, len(generations))


def _binary(bvh: Bvh) -> Binary:
    """Return the nodes of a hierarchy, with what follows from its links."""
    first, past = bvh.links[0].T.astype(np.int64)
    code = -1 - first
    counts = np.where(first < 0, code & ((1 << COUNT_BITS) - 1), 0)
    before = np.concatenate([[0], np.cumsum(counts)])
    end = np.where(past < 0, len(first), past)  # nodes are numbered depth first: here what a node holds ends
    left = np.where(first < 0, -1, first)
    right = np.where(first < 0, -1, past[np.maximum(first, 0)])
    return Binary(bvh.low, bvh.high, before[:-1], before[end] - before[:-1], left, right)


def _nodes(tree: Binary, children: Ints) -> Words:
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


def _block_items(bvh: Bvh, start: Ints, count: Ints) -> Ints:
    """Return the numbers (n, 4) of the triangles of leaves, -1 where there is none."""
    place = start[:, None] + np.arange(HALF)
    there = np.arange(HALF) < count[:, None]
    return np.where(there, bvh.items[np.minimum(place, len(bvh.items) - 1)], -1)


def _words(rows: NDArray[np.floating], levels: NDArray[np.floating]) -> Words:
    """Return what a block says of each triangle, (N + 1, 14); the last one is not there."""
    triangles = rows.reshape(-1, 3, 4)
    words = np.zeros((len(triangles) + 1, LEVEL + 1), np.uint32)
    floats = words[:-1].view(np.float32)
    for corner in range(3):
        copy_columns(floats[:, 3 * corner : 3 * corner + 3], triangles[:, corner, :3])
    copy_columns(floats[:, NORMALS:LEVEL], triangles[:, :, 3])
    floats[:, LEVEL] = levels
    words[:-1, NUMBERS], words[-1, NUMBERS] = np.arange(len(triangles)), 0xFFFFFFFF
    return words


def _put_blocks(table: Words, places: Ints, items: Ints, words: Words) -> None:
    """Write the records at `places` of blocks of the triangles `items` (n, 4), a cache's content at a time."""
    for part in parts(len(places)):
        table[places[part], : LEVEL + 1] = words.take(items[part], axis=0, mode="wrap").transpose(0, 2, 1)
