"""Two levels of hierarchies: one for each distinct part, and one over the boxes of the places where parts stand.

Stage: accelerate. Takes the corners of parts in coordinates of their own, and instances: a part and a matrix to the
scene's coordinates. Gives one `Bvh` for both levels, and the table of instances, which `kernels.instances` reads. Node
0 is the root of the upper level. A leaf there is one instance: its link is that of a leaf of no triangles, and has the
number of the instance in the place of the first triangle.

>>> corner = np.eye(3)[None]
>>> there = np.eye(4)[:3] + np.array([0, 0, 0, 2.0])
>>> levels = build_two_levels([corner], [0, 0], np.stack([np.eye(4)[:3], there]))
>>> len(levels.bvh.items), levels.bvh.high[0].round(3).tolist()
(1, [3.0, 3.0, 3.0])
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raytracer.accel.bvh import COUNT_BITS, END, Bvh, grown
from raytracer.accel.forest import put_part
from raytracer.accel.ploc import build_bvh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ROWS: Final = 9
"""Rows of an instance: three of its matrix, three of the matrix of normals, three of the inverse matrix."""
_CUT: Final = 64
"""Boxes of a part that are placed to get the box of an instance, at most."""
_ROUNDINGS: Final = 2
"""Roundings of the `reach` by which boxes of instances grow: a kernel's corners have one."""


@dataclass(frozen=True, slots=True, eq=False)
class TwoLevels:
    """The nodes of both levels, and I instances of the parts.

    `rows` (9 I, 4) float32 are for each instance the matrix (3, 4) from the part's coordinates to the scene's; the
    matrix (3, 3) for normals, its largest entry 1, and the `reach`; and the inverse of the first three columns. The
    reach (3,) bounds the roundings of coordinates: the offset, which is added last, and 8 times the largest product of
    the matrix and a corner. It is 0 where the matrix is the identity. The last column of the inverse has the factor of
    a plane's distance from 0 beside the matrix for normals; 1 for the identity, otherwise 0; and -1 for a matrix that
    mirrors, otherwise 1. `numbers` (I, 2) int32 are the root of the instance's part, and its first triangle in the
    order of all instances, less the part's first one. `boxes` (I, 2, 3) are the corners of the instances' boxes.
    """

    bvh: Bvh
    rows: NDArray[np.float32]
    numbers: NDArray[np.int32]
    boxes: NDArray[np.floating]

    @property
    def bytes(self) -> int:
        """The size of all tables."""
        return self.bvh.bytes + self.rows.nbytes + self.numbers.nbytes


def build_two_levels(
    parts: Sequence[Floats], part_of: ArrayLike, matrices: Floats, backend: str = "numpy"
) -> TwoLevels:
    """Build the hierarchies of parts, each of corners (n, 3, 3), and the one over instances.

    `part_of` (I,) is the part of each instance, `matrices` (I, 3, 4) take it to its place. They have inverses. The
    triangles are numbered part by part.
    """
    chosen = np.asarray(part_of, np.int64)
    built = [build_bvh(corners, np.float32, backend) for corners in parts]
    sizes = np.array([len(corners) for corners in parts])
    largest = np.stack([np.maximum(-bvh.low[0], bvh.high[0]) for bvh in built]).astype(np.float64)
    rows, reach = _rows(matrices, largest[chosen])
    placed = rows.reshape(-1, ROWS, 4)[:, :3].astype(np.float64)
    low, high = (np.empty((len(chosen), 3)) for _ in range(2))
    for number, bvh in enumerate(built):
        own = chosen == number
        low[own], high[own] = _boxes(placed[own], *_cut(bvh))
    beside = _ROUNDINGS * 2.0**-24 * reach
    lower, upper = grown(low - beside, high + beside, np.dtype(np.float32))
    top = _one_instance_a_leaf(build_bvh(np.stack([lower, upper, lower], axis=1)), lower, upper)
    counts = [len(bvh.low) for bvh in built]
    roots = len(top.low) + np.cumsum([0, *counts])
    firsts = np.cumsum([0, *sizes])
    shape = int(roots[-1]), 3
    bvh = Bvh(
        np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.full((8, shape[0], 2), END, np.int32),
        np.concatenate([part.items + first for part, first in zip(built, firsts, strict=False)]).astype(np.int32),
    )  # fmt: skip
    put_part(bvh, top, 0, 0, END)
    for part, root, first in zip(built, roots, firsts, strict=False):
        put_part(bvh, part, int(root), int(first), END)
    own_sizes = sizes[chosen]
    shifts = np.cumsum(own_sizes) - own_sizes - firsts[chosen]
    numbers = np.stack([roots[chosen], shifts], axis=1).astype(np.int32)
    return TwoLevels(bvh, rows, numbers, np.stack([lower, upper], axis=1))


def _rows(matrices: Floats, largest: Floats) -> tuple[NDArray[np.float32], Floats]:
    """Return the rows (9 I, 4) of instances, and the reach of each, (I, 3); see `TwoLevels`.

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
    reach = np.abs(offset) + 8 * np.einsum("ijk,ik->ij", np.abs(turn), largest)
    reach[same] = 0
    rows = np.zeros((len(placed), ROWS, 4))
    rows[:, :3] = placed
    rows[:, 3:6, :3] = np.sign(volume) * cofactors / most
    rows[:, 3:6, 3] = reach
    rows[:, 6:, :3] = cofactors.swapaxes(1, 2) / (volume * size)
    rows[:, 6, 3] = (np.abs(volume) * size / most)[:, 0, 0]
    rows[:, 7, 3], rows[:, 8, 3] = same, np.sign(volume[:, 0, 0])
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


def _one_instance_a_leaf(bvh: Bvh, low: NDArray[np.floating], high: NDArray[np.floating]) -> Bvh:
    """Return a hierarchy over boxes of instances in which each leaf is one: a leaf of several becomes their parent."""
    code = -1 - bvh.links[0, :, 0].astype(np.int64)
    leaves = np.flatnonzero(code >= 0)
    starts, counts = code[leaves] >> COUNT_BITS, code[leaves] & ((1 << COUNT_BITS) - 1)
    links = bvh.links.astype(np.int64)
    links[:, leaves, 0] = -1 - (bvh.items[starts] << COUNT_BITS)
    parents, starts, counts = (some[counts > 1] for some in (leaves, starts, counts))
    ends = np.cumsum(counts)
    within = np.arange(int(counts.sum())) - np.repeat(ends - counts, counts)
    instances = bvh.items[np.repeat(starts, counts) + within]
    nodes = len(bvh.low) + np.arange(len(instances))
    links[:, parents, 0] = len(bvh.low) + ends - counts
    below = np.empty((8, len(nodes), 2), np.int64)
    below[:, :, 0] = -1 - (instances << COUNT_BITS)
    below[:, :, 1] = nodes + 1
    below[:, ends - 1, 1] = links[:, parents, 1]
    return Bvh(
        np.concatenate([bvh.low, low[instances]]), np.concatenate([bvh.high, high[instances]]),
        np.concatenate([links, below], axis=1).astype(np.int32), np.zeros(0, np.int32),
    )  # fmt: skip
