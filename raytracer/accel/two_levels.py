"""Two levels of hierarchies: one for each distinct part, and one over the boxes of the places where parts stand.

Stage: accelerate. Takes the corners of parts in coordinates of their own, and instances: a part and a matrix to the
scene's coordinates. Gives `TwoLevels`, which `kernels.instances` and `kernels.wide_instances` read. Instances that
move get another upper level, and the parts stay as they are.

>>> corner = np.eye(3)[None]
>>> there = np.eye(4)[:3] + np.array([0, 0, 0, 2.0])
>>> levels = TwoLevels.of([corner], [0, 0], np.stack([np.eye(4)[:3], there]), [0], [0, 1])
>>> len(levels.order), levels.top.high[0].round(3).tolist()
(1, [3.0, 3.0, 3.0])
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raytracer.accel.bvh import COUNT_BITS, END, Bvh, grown
from raytracer.accel.forest import put_part
from raytracer.accel.ploc import build_bvh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ROWS: Final = 10
"""Rows of an instance: three of its matrix, three of the matrix of normals, three of the inverse matrix, and one."""
BESIDE: Final = 1 / 3
"""The largest distance of corners from their triangle's plane: a rounding of the reach for each of two corners, of
which a bound takes 6 (`AheadBound`). The reach counts products 10 times, enough for the 8 roundings of the normal."""
_CUT: Final = 64
"""Boxes of a part that are placed to get the box of an instance, at most."""
_ROUNDINGS: Final = 2
"""Roundings of the `reach` by which boxes of instances grow: a kernel's corners have one."""


@dataclass(frozen=True, eq=False)
class TwoLevels:
    """The hierarchies of `parts`, I instances of them, and the hierarchy `top`, whose leaves are one instance each.

    `part_of` (I,) is the part of each instance. `rows` (10 I, 4) float32 are for each instance the matrix (3, 4) from
    the part's coordinates to the scene's; the matrix (3, 3) for normals, its largest entry 1, and the `reach`; the
    inverse of the first three columns; and the `BESIDE` part of the reach along the part's axes, as a normal sees it.
    The reach (3,) bounds the roundings of coordinates: the offset, which is added last, and 10 times the largest
    product of the matrix and a corner. It is 0 where the matrix is the identity, and only there. The last column of the
    inverse ends in -1 for a matrix that mirrors, otherwise 1. The last number is the factor of a plane's distance from
    0 beside the matrix for normals. `boxes` (I, 2, 3) are the corners of the instances' boxes.

    The triangles are numbered part by part. Triangle k of instance i has the number `order[k] + firsts[i]` among those
    of all instances; `order` (N,) and `firsts` (I,) are int32.
    """

    parts: Sequence[Bvh]
    part_of: Ints
    rows: NDArray[np.float32]
    boxes: NDArray[np.floating]
    top: Bvh
    order: NDArray[np.int32]
    firsts: NDArray[np.int32]

    @classmethod
    def of(
        cls,
        parts: Sequence[Floats],
        part_of: ArrayLike,
        matrices: Floats,
        order: ArrayLike,
        firsts: ArrayLike,
        backend: str = "numpy",
    ) -> TwoLevels:
        """Build the hierarchies of parts, each of corners (n, 3, 3), and the one over instances.

        `matrices` (I, 3, 4) take the instances to their places. They have inverses.
        """
        built = [build_bvh(corners, np.float32, backend) for corners in parts]
        chosen = np.asarray(part_of, np.int64)
        rows, boxes = _placed(built, chosen, matrices)
        numbers = (np.asarray(values, np.int32) for values in (order, firsts))
        return cls(built, chosen, rows, boxes, _over(boxes), *numbers)

    def moved(self, numbers: Ints, matrices: Floats) -> TwoLevels:
        """Return the levels after instances of these numbers (n,) have moved; `matrices` (n, 3, 4) as in `of`."""
        rows, boxes = self.rows.reshape(-1, ROWS, 4).copy(), self.boxes.copy()
        own_rows, boxes[numbers] = _placed(self.parts, self.part_of[numbers], matrices)
        rows[numbers] = own_rows.reshape(-1, ROWS, 4)
        return replace(self, rows=rows.reshape(-1, 4), boxes=boxes, top=_over(boxes))

    @property
    def starts(self) -> Ints:
        """The first triangle of each part, and the number of all."""
        return np.cumsum([0, *(len(part.items) for part in self.parts)])

    @property
    def roots(self) -> Ints:
        """The root of each part among the nodes of `bvh`, and the number of all."""
        return np.cumsum([len(self.top.low), *(len(part.low) for part in self.parts)])

    @property
    def top_links(self) -> NDArray[np.int32]:
        """The links of `top` (8, 2 I - 1, 2); that of a leaf, of no triangles, has the number of its instance."""
        links = self.top.links.copy()
        leaves = np.flatnonzero(links[0, :, 0] < 0)
        places = (-1 - links[0, leaves, 0]) >> COUNT_BITS
        links[:, leaves, 0] = -1 - (self.top.items[places] << COUNT_BITS)
        return links

    @cached_property
    def bvh(self) -> Bvh:
        """The nodes of both levels, those of `top` first."""
        starts, roots = self.starts, self.roots
        shape = int(roots[-1]), 3
        bvh = Bvh(
            np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.full((8, shape[0], 2), END, np.int32),
            np.concatenate([part.items + start for part, start in zip(self.parts, starts, strict=False)]),
        )  # fmt: skip
        put_part(bvh, replace(self.top, links=self.top_links), 0, 0, END)
        for part, root, start in zip(self.parts, roots, starts, strict=False):
            put_part(bvh, part, int(root), int(start), END)
        return replace(bvh, items=bvh.items.astype(np.int32))

    @property
    def bytes(self) -> int:
        """The size of all tables."""
        return self.bvh.bytes + sum(table.nbytes for table in (self.rows, self.order, self.firsts))


def _over(boxes: NDArray[np.floating]) -> Bvh:
    """Return the hierarchy over the boxes (I, 2, 3) of instances."""
    return build_bvh(boxes[:, [0, 1, 0]], leaf=1)


def _placed(parts: Sequence[Bvh], part_of: Ints, matrices: Floats) -> tuple[NDArray[np.float32], NDArray[np.floating]]:
    """Return the rows (10 n, 4) and the boxes (n, 2, 3) of instances; see `TwoLevels`."""
    largest = np.zeros((len(part_of), 3))
    boxes = np.empty((len(part_of), 2, 3))
    numbers = np.unique(part_of)
    for number in numbers:
        root = parts[number]
        largest[part_of == number] = np.maximum(-root.low[0], root.high[0])
    rows, reach = _rows(matrices, largest)
    placed = rows.reshape(-1, ROWS, 4)[:, :3].astype(np.float64)
    for number in numbers:
        own = part_of == number
        boxes[own, 0], boxes[own, 1] = _boxes(placed[own], *_cut(parts[number]))
    beside = _ROUNDINGS * 2.0**-24 * reach
    grown_boxes = grown(boxes[:, 0] - beside, boxes[:, 1] + beside, np.dtype(np.float32))
    return rows, np.stack(grown_boxes, axis=1)


def _rows(matrices: Floats, largest: Floats) -> tuple[NDArray[np.float32], Floats]:
    """Return the rows (10 I, 4) of instances, and the reach of each, (I, 3); see `TwoLevels`.

    `largest` (I, 3) are the largest coordinates of the instances' parts.
    """
    placed = matrices.astype(np.float32).astype(np.float64)
    turn, offset = placed[:, :, :3], placed[:, :, 3]
    size = np.abs(turn).max(axis=(1, 2))[:, None, None]
    x, y, z = (turn / size).swapaxes(0, 1)
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    volume = np.einsum("ij,ij->i", x, cofactors[:, 0])[:, None, None]
    most = np.abs(cofactors).max(axis=(1, 2))[:, None, None]
    same = (placed == np.eye(4)[:3]).all(axis=(1, 2))
    reach = np.abs(offset) + 10 * np.einsum("ijk,ik->ij", np.abs(turn), largest)
    reach[same] = 0
    rows = np.zeros((len(placed), ROWS, 4))
    rows[:, :3] = placed
    across = np.sign(volume) * cofactors / most
    rows[:, 3:6, :3] = across
    rows[:, 3:6, 3] = reach
    rows[:, 6:9, :3] = cofactors.swapaxes(1, 2) / (volume * size)
    rows[:, 8, 3] = np.sign(volume[:, 0, 0])
    rows[:, 9, :3] = BESIDE * np.einsum("ikj,ik->ij", np.abs(across), reach)
    rows[:, 9, 3] = (np.abs(volume) * size / most)[:, 0, 0]
    return rows.reshape(-1, 4).astype(np.float32), reach


def _cut(bvh: Bvh) -> tuple[Floats, Floats]:
    """Return the boxes (n, 3) of some nodes that hold all triangles: the smaller they are, the tighter they fit."""
    first, past = bvh.links[0].T
    nodes = np.zeros(1, np.int64)
    while True:
        inner = first[nodes] >= 0
        if not inner.any() or len(nodes) + np.count_nonzero(inner) > _CUT:
            return bvh.low[nodes].astype(np.float64), bvh.high[nodes].astype(np.float64)
        children = first[nodes[inner]]
        nodes = np.concatenate([nodes[~inner], children, past[children]])


def _boxes(matrices: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return the boxes (I, 3) round boxes (n, 3) at the places that matrices (I, 3, 4) give them."""
    turn, offset = matrices[:, :, :3], matrices[:, :, 3]
    lowest, highest = np.full(offset.shape, np.inf), np.full(offset.shape, -np.inf)
    for middle, around in zip((low + high) / 2, (high - low) / 2, strict=True):
        place, size = turn @ middle + offset, np.abs(turn) @ around
        np.minimum(lowest, place - size, out=lowest)
        np.maximum(highest, place + size, out=highest)
    return lowest, highest
