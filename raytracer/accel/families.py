"""Choose which nodes of a binary hierarchy become the eight children of each wide node.

Stage: accelerate. The expected number of visits of a node is proportional to its surface area. So the nodes are chosen
that make the sum of the surface areas of all wide nodes least, by dynamic programming (Ylitie, Karras and Laine 2017).
All backends give the same numbers.

>>> low, high = np.zeros((3, 3)), np.ones((3, 3))
>>> start, count, left, right = np.array([[0, 0, 3], [6, 3, 3], [1, -1, -1], [2, -1, -1]])
>>> [found] = families(Binary(low, high, start, count, left, right), 4, "numpy")
>>> found.tolist()
[[1, 2, -1, -1, -1, -1, -1, -1]]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bvh import Bounds, half_area
from raytracer.accel.planes import constant
from raytracer.accel.programs import LateProgram
from shpy import SH_DO, SH_ELSE, SH_IF, SH_UNTIL

Ints = NDArray[np.int64]

WIDTH = 8
"""Children of a wide node."""
HALF = 4
"""Numbers in a row of a table."""
_BITS = 3
"""Bits for a number of boxes below `WIDTH`."""


@dataclass(frozen=True, slots=True, eq=False)
class Binary:
    """The nodes of a binary hierarchy: boxes (M, 3), the range of items in each, its two children, -1 for a leaf."""

    low: Bounds
    high: Bounds
    start: Ints
    count: Ints
    left: Ints
    right: Ints


def families(tree: Binary, leaf: int, backend: str) -> list[Ints]:
    """Return for each level the children (n, WIDTH) of each wide node, as nodes of `tree`; -1 fills the rest.

    A node of at most `leaf` items is a leaf.
    """
    rows = np.zeros((len(tree.count), 4), np.int32)
    rows[:, 0], rows[:, 1], rows[:, 2] = tree.left, tree.right, _shares(tree, leaf, backend)
    table, kernel = sh.Table(constant(rows), sh.Attrib4i, copy=False), family.on(backend)
    levels = []
    nodes = np.zeros(1, np.int32)
    while len(nodes):
        children = np.concatenate(kernel(nodes, table), axis=1)
        levels.append(children.astype(np.int64))
        nodes = children[(children >= 0) & (tree.count[children] > leaf)]
    return levels


def _shares(tree: Binary, leaf: int, backend: str) -> NDArray[np.int32]:
    """Return for each node how many of 2 to `WIDTH` boxes its left child gets, in `_BITS` bits per number.

    A number is 0 where one box for the whole node costs less. The costs are computed from the bottom up. In k > 1 boxes
    a node costs the least sum of its children's costs, over all ways to divide the k boxes between them. In one box, as
    a wide node of its own, it costs its surface area plus its cost in `WIDTH` boxes.
    """
    extent = (tree.high - tree.low).astype(np.float64)
    area = half_area((extent / (extent[0].max() or 1.0)).T).astype(np.float32)
    area[area < np.finfo(np.float32).tiny] = 0  # a GPU may flush denormals to 0
    levels = [np.zeros(1, np.int64)]
    while len(levels[-1]):
        nodes = levels[-1][tree.count[levels[-1]] > leaf]
        levels.append(np.stack([tree.left[nodes], tree.right[nodes]], axis=1).reshape(-1))
    shares = np.zeros(len(area), np.int32)
    below = [np.zeros((1, HALF), np.float32)] * 2
    for nodes in levels[-2::-1]:
        inner = tree.count[nodes] > leaf
        first = np.where(inner, 2 * np.cumsum(inner) - 2, -1).astype(np.int32)
        tables = [sh.Table(constant(cost), sh.Attrib4f, copy=False) for cost in below]
        *below, shares[nodes] = share.on(backend)(area[nodes], first, *tables)
    return shares


class Share(NamedTuple):
    """The least costs of a node in 1 to 4 boxes and in 5 to 8, and how its boxes are divided."""

    few: sh.Attrib4f
    many: sh.Attrib4f
    share: sh.Attrib1i


@LateProgram
def share(area: sh.Attrib1f, first: sh.Attrib1i, few: sh.Table[sh.Attrib4f], many: sh.Table[sh.Attrib4f]) -> Share:
    """Compute the costs of a node from its area and `first`, its first child's row in the tables, -1 for a leaf."""
    one, other = ([*few[first + k], *many[first + k]] for k in (0, 1))  # entry k - 1 is for a split into k boxes
    least, parts = [], []
    for boxes in range(2, WIDTH + 1):
        cost, part = one[0] + other[boxes - 2], sh.Attrib1i(1)
        for k in range(2, boxes):
            both = one[k - 1] + other[boxes - k - 1]
            part = sh.cond(both < cost, k, part)
            cost = sh.cond(both < cost, both, cost)
        least.append(cost)
        parts.append(part)
    is_leaf = first < 0
    whole = sh.cond(is_leaf, area, area + least[-1])
    shares = sh.Attrib1i(0)
    costs = [whole]
    for k, (cost, part) in enumerate(zip(least, parts, strict=True)):
        is_one = is_leaf | (whole < cost)
        shares = shares | sh.cond(is_one, 0, part << _BITS * k)
        costs.append(sh.cond(is_one, whole, cost))
    return Share(sh.Attrib4f(*costs[:HALF]), sh.Attrib4f(*costs[HALF:]), shares)


class Family(NamedTuple):
    """The children of a wide node, as nodes of the binary hierarchy; -1 fills the rest."""

    first: sh.Attrib4i
    second: sh.Attrib4i


@LateProgram
def family(node: sh.Attrib1i, rows: sh.Table[sh.Attrib4i]) -> Family:
    """Find the children of the wide node at `node`; a row holds a node's two children and its shares."""
    members, rooms = sh.Array(sh.Attrib1i, WIDTH), sh.Array(sh.Attrib1i, WIDTH)
    for k in range(WIDTH):
        members[k] = -1
    place = sh.Attrib1i(0)
    here = sh.Attrib1i(node)
    boxes = sh.Attrib1i(WIDTH)
    with SH_DO():
        row = rows[here]
        part = sh.cond(boxes > 1, (row.z >> _BITS * sh.max(boxes - 2, 0)) & (WIDTH - 1), 0)
        with SH_IF(part > 0):
            members[place + part] = row.y
            rooms[place + part] = boxes - part
            here[:] = row.x
            boxes[:] = part
        with SH_ELSE():
            members[place] = here
            place += boxes
            here[:] = members[sh.min(place, WIDTH - 1)]
            boxes[:] = rooms[sh.min(place, WIDTH - 1)]
        SH_UNTIL(place >= WIDTH)
    return Family(*(sh.Attrib4i(*(members[first + k] for k in range(HALF))) for first in (0, HALF)))
