"""The hierarchy with eight boxes a node and eight triangles a leaf: one ray tests them on vectors of eight.

Stage: accelerate. Takes a `Bvh` and the corners of its triangles, gives a `WideBvh`. A node with eight triangles
or fewer is a leaf. A wide node replaces up to seven binary nodes, which `families` chooses.

>>> from raytracer.accel.ploc import build_bvh
>>> wide = widen(build_bvh(np.eye(3)[None]), np.eye(3, 4), np.ones(1))
>>> wide.records.shape, wide.records[0, FIRST, 0].tolist(), wide.records[2, 2 * NUMBERS - ROWS].tolist()
((3, 16, 4), 1, [0, 4294967295, 4294967295, 4294967295])

`wide_nodes` gives the nodes alone, for packets, whose leaves are those of the `Bvh`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.bvh import COUNT_BITS, MAX_LEAF, Bvh, target_for
from raytracer.accel.families import HALF, WIDTH, Binary, families
from raytracer.accel.planes import constant, copy_columns, parts
from raytracer.accel.two_levels import TwoLevels

Ints = NDArray[np.int64]
Words = NDArray[np.uint32]

ROWS = 16
"""Rows of a record of four words each; a node has one record, a block two."""
BLOCK = 8
"""The most triangles of a block."""
TAGS, FIRST = 12, 14
"""Rows of a node: after two rows for each lower and each upper side."""
NUMBERS = 9
"""Row pair of a block: after three pairs for each corner."""
NORMALS, LEVEL = 10, 13
"""Row pairs of a block: three for the unit normal, and one for the plane's level."""
LEAF = 16
"""Bit of a tag: the box is that of a block. The bits below it are a number among its siblings' records."""
SIBLINGS = 2 * WIDTH
"""Records of a node's children, at most."""
RECORDS = 1024
"""Records of a table, at least.

To look whether an index is in range costs 8 % of a walk, so a table has as many as its kernel may ask for.
"""
_FAR = np.float32(3e38)


@dataclass(frozen=True, slots=True, eq=False)
class WideBvh:
    """`records` (M, 16, 4), each 16 rows of four 32-bit words; `depth` is the number of levels of nodes.

    `table` begins with the records; others follow, so that it has the children of every record up to `last`.

    The first record is a node, the others nodes and blocks, siblings side by side; a block takes two. A node: the lower
    sides of its eight boxes along x, y and z as floats, the upper sides, the boxes' tags, and the number of its first
    child's record. A box that is not there is inside out. A block: x, y and z of eight triangles' first corners, of the
    second, of the third, their numbers, unit normals and levels (see `planes.levels_of`), two rows each; one that is
    not there has no area and the number -1.
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
        """The number to which kernels clamp those of records: it is in their texts, so few counts have their own."""
        return _last(self.count)


def _last(count: int) -> int:
    """Return the next multiple, less 1, of an eighth of the largest power of 2 that is not above the count."""
    step = max(RECORDS, 1 << (count - 1).bit_length()) // 16
    return -(-max(count, RECORDS) // step) * step - 1


def widen(bvh: Bvh, rows: NDArray[np.floating], levels: NDArray[np.floating], backend: str = "numpy") -> WideBvh:
    """Return the wide form of a hierarchy over triangles, whose numbers are rounded to f32.

    `rows` (3N, 4) are as in `triangle_rows`, `levels` (N,) how far the triangles' planes are from 0. The result is the
    same for every backend on which nodes are chosen.
    """
    records = _Records(bvh, BLOCK, 2, backend)
    table = np.zeros((_last(records.count) + SIBLINGS + 1, ROWS, HALF), np.uint32)
    _put_part(table, records, _words(rows, levels))
    return WideBvh(constant(table), records.count, records.depth)


def widen_levels(
    levels: TwoLevels, rows: NDArray[np.floating], plane_levels: NDArray[np.floating], backend: str = "numpy"
) -> tuple[WideBvh, Ints, int]:
    """Return the wide form of two levels, as `widen` does for one: 2 I records of the upper one come first.

    An instance has one record there, whose first words are the instance's number and the record of its part's root.
    With it come the records of parts' roots, and the levels of nodes of the deepest part.
    """
    parts_of_table = [_Records(part, BLOCK, 2, backend) for part in levels.parts]
    roots = np.cumsum([2 * len(levels.part_of), *(part.count for part in parts_of_table)])
    (top, depth), count = top_records(levels, roots), int(roots[-1])
    table = np.zeros((_last(count) + SIBLINGS + 1, ROWS, HALF), np.uint32)
    table[: len(top)] = top
    starts = levels.starts
    for k, records in enumerate(parts_of_table):
        first, past = starts[k : k + 2]
        words = _words(rows[3 * first : 3 * past], plane_levels[first:past], first)
        _put_part(table[roots[k] : roots[k + 1]], records, words, int(roots[k]))
    below = max(records.depth for records in parts_of_table)
    return WideBvh(constant(table), count, depth + below), roots, below


def top_records(levels: TwoLevels, roots: Ints) -> tuple[Words, int]:
    """Return the records (2 I, 16, 4) of the upper level, and its depth; `roots` are the records of parts' roots."""
    records = _Records(levels.top, 1, 1, "numpy")
    table = np.zeros((2 * len(levels.part_of), ROWS, HALF), np.uint32)
    places, leaves = records.put_nodes(table)
    instances = levels.top.items[records.tree.start[leaves]]
    table[places, 0, 0], table[places, 0, 1] = instances, roots[levels.part_of[instances]]
    return table, records.depth


class _Records:
    """The records of a hierarchy, whose leaves of at most `leaf` triangles take `size` records each."""

    def __init__(self, bvh: Bvh, leaf: int, size: int, backend: str) -> None:
        self.bvh, self.tree = bvh, _binary(bvh)
        generations = families(self.tree, leaf, target_for(len(bvh.items), backend))
        self.depth, self.children = len(generations), np.concatenate(generations)
        self.there = self.children >= 0
        self.is_leaf = self.tree.count[self.children] <= leaf
        self.sizes = np.where(self.there, np.where(self.is_leaf, size, 1), 0)
        self.count = 1 + int(self.sizes.sum())

    def put_nodes(self, table: Words, first: int = 0) -> tuple[Ints, Ints]:
        """Write the nodes into a table, whose first record has this number; return the places and nodes of leaves."""
        there, sizes = self.there, self.sizes
        nodes = np.zeros((len(self.children), ROWS, HALF), np.uint32)
        _put_sides(nodes, self.tree, self.children)
        tags = np.cumsum(sizes, axis=1) - sizes | np.where(self.is_leaf, LEAF, 0)
        family = sizes.sum(axis=1)
        nodes[:, TAGS:FIRST] = np.where(there, tags, 0).reshape(-1, 2, HALF)
        nodes[:, FIRST, 0] = np.cumsum(family) - family + 1 + first
        own, is_leaf = sizes[there], self.is_leaf[there]
        places = 1 + np.cumsum(own) - own
        table[np.concatenate([[0], places[~is_leaf]])] = nodes
        return places[is_leaf], self.children[there][is_leaf]


def _put_part(table: Words, records: _Records, words: Words, first: int = 0) -> None:
    """Write the nodes and blocks of a hierarchy into a table, whose first record has this number."""
    places, leaves = records.put_nodes(table, first)
    items = _block_items(records.bvh, records.tree.start[leaves], records.tree.count[leaves])
    _put_blocks(table, places, items, words)


class WideNodes(NamedTuple):
    """Nodes of eight boxes over the leaves of a `Bvh`.

    `table` (n, 16, 4) has the rows of a node's record: a tag counts the nodes or the leaves before it among its
    siblings, and row FIRST has the numbers of the first node and of the first leaf. `leaves` (L,) are the leaves as
    nodes of the `Bvh`. `last` is the number to which kernels clamp those of nodes, `depth` the number of levels.
    """

    table: Words
    leaves: Ints
    last: int
    depth: int


def wide_nodes(bvh: Bvh, backend: str = "numpy") -> WideNodes:
    """Return the nodes of eight boxes for a hierarchy; the same for every backend on which they are chosen."""
    tree = _binary(bvh)
    generations = families(tree, MAX_LEAF, target_for(len(bvh.items), backend))
    children = np.concatenate(generations)
    there = children >= 0
    is_leaf = there & (tree.count[children] <= MAX_LEAF)
    is_node = there & ~is_leaf
    last = _last(len(children))
    table = np.zeros((last + WIDTH, ROWS, HALF), np.uint32)
    _put_sides(table[: len(children)], tree, children)
    tags = np.where(is_leaf, LEAF, 0)
    for first, (kind, before) in enumerate(((is_node, 1), (is_leaf, 0))):
        tags[kind] |= (np.cumsum(kind, axis=1) - 1)[kind]
        family = kind.sum(axis=1)
        table[: len(children), FIRST, first] = np.cumsum(family) - family + before
    table[: len(children), TAGS:FIRST] = tags.reshape(-1, 2, HALF)
    return WideNodes(constant(table), children[is_leaf], last, len(generations))


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


def _put_sides(nodes: Words, tree: Binary, children: Ints) -> None:
    """Write the sides of the boxes of children (n, WIDTH) into the records (n, ROWS, HALF) of their nodes."""
    there = (children >= 0)[:, None]
    sides = np.empty((len(children), 2, 3, WIDTH), np.float32)
    sides[:, 0] = np.where(there, tree.low[children].transpose(0, 2, 1), _FAR)
    sides[:, 1] = np.where(there, tree.high[children].transpose(0, 2, 1), -_FAR)
    nodes[:, :TAGS].view(np.float32)[:] = sides.reshape(-1, TAGS, HALF)


def _block_items(bvh: Bvh, start: Ints, count: Ints) -> Ints:
    """Return the numbers (n, 8) of the triangles of leaves, -1 where there is none."""
    place = start[:, None] + np.arange(BLOCK)
    there = np.arange(BLOCK) < count[:, None]
    return np.where(there, bvh.items[np.minimum(place, len(bvh.items) - 1)], -1)


def _words(rows: NDArray[np.floating], levels: NDArray[np.floating], first: int = 0) -> Words:
    """Return what a block says of each triangle, (N + 1, 14), numbered from `first`; the last one is not there."""
    triangles = rows.reshape(-1, 3, 4)
    words = np.zeros((len(triangles) + 1, LEVEL + 1), np.uint32)
    floats = words[:-1].view(np.float32)
    for corner in range(3):
        copy_columns(floats[:, 3 * corner : 3 * corner + 3], triangles[:, corner, :3])
    copy_columns(floats[:, NORMALS:LEVEL], triangles[:, :, 3])
    floats[:, LEVEL] = levels
    words[:-1, NUMBERS], words[-1, NUMBERS] = first + np.arange(len(triangles)), 0xFFFFFFFF
    return words


def _put_blocks(table: Words, places: Ints, items: Ints, words: Words) -> None:
    """Write the record pairs at `places` of blocks of the triangles `items` (n, 8), a cache's content at a time."""
    for part in parts(len(places)):
        pairs = np.zeros((len(items[part]), ROWS, BLOCK), np.uint32)
        pairs[:, : LEVEL + 1] = words.take(items[part], axis=0, mode="wrap").transpose(0, 2, 1)
        records = pairs.reshape(-1, 2, ROWS, HALF)
        table[places[part]], table[places[part] + 1] = records[:, 0], records[:, 1]
