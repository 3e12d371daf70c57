"""The uniform grid: the triangles that touch each cell, as two tables that a kernel can walk.

Stage: accelerate. Takes corners (N, 3, 3), gives a `Grid`: `cells` says for every cell where its triangles stand in
`items`. A triangle is listed in every cell that it touches, grown by a margin for the rounding of the walk. The test
uses the bounding box, the plane, and the three edges in each of the three projections (Schwarz and Seidel 2010; these
are the axes of Akenine-Moller 2001). The few triangles far larger than the rest, a floor or a wall, stand outside the
grid at the head of `items`; every ray tests them first, and the cells stay as fine as the small triangles need.

>>> grid = build_grid(np.eye(3)[None])
>>> grid.items.tolist(), grid.outside
([0], 1)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

DENSITY = 5.0
"""Cells per triangle, roughly: more cost steps, fewer cost tests."""
MAX_CELLS = 1 << 21
MAX_PER_AXIS = 512
MAX_PER_SIDE = 128
"""Cells along each axis of a grid whose size is given: its cube is `MAX_CELLS`."""
MAX_OUTSIDE = 16
ROUNDINGS = 8 * float(np.finfo(np.float32).eps)
"""By how much the walk may misplace the side of a cell, as a part of its largest coordinate: that of the grid's corner,
of the cell's size and its multiple, of their sum, and of the place of the ray, each half an eps, and as much again."""
_PAIRS_AT_ONCE = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A grid of `shape` = (nx, ny, nz) cells of size `cell` (3,), whose lowest corner is `low` (3,).

    `cells` (nz, ny, nx, 2) int32 holds where a cell's triangles begin and end in `items` (M,) int32, each list in
    ascending order; `items[:outside]` are the triangles that lie in no cell and that every ray must test.
    """

    low: Floats
    cell: Floats
    shape: tuple[int, int, int]
    cells: NDArray[np.int32]
    items: NDArray[np.int32]
    outside: int

    @property
    def bytes(self) -> int:
        """The size of both tables."""
        return self.cells.nbytes + self.items.nbytes


def build_grid(corners: NDArray[np.floating], across: int | None = None) -> Grid:
    """Build the grid of triangles with `corners` (N, 3, 3): `across` cells an axis, or about `DENSITY` a triangle."""
    triangles = np.asarray(corners, dtype=np.float64).reshape(-1, 3, 3)
    large = far_larger(triangles)
    inside = np.flatnonzero(~large)
    small = triangles[inside]
    low, high = _bounds(small, triangles)
    shape = _resolution(high - low, len(small)) if across is None else (across, across, across)
    cell = (high - low) / shape
    owner, place = _touched(small, low, cell, shape)
    order = np.argsort(place, kind="stable")
    counts = np.bincount(place, minlength=math.prod(shape))
    outside = np.flatnonzero(large)
    ends = np.cumsum(counts) + len(outside)
    nx, ny, nz = shape
    cells = np.stack([ends - counts, ends], axis=-1).astype(np.int32).reshape(nz, ny, nx, 2)
    items = np.concatenate([outside, inside[owner[order]]]).astype(np.int32)
    return Grid(low, cell, shape, cells, items, len(outside))


def build_part(corners: NDArray[np.floating], numbers: Ints, across: int | None = None) -> Grid:
    """Build the grid of those triangles alone whose `numbers` are given; `items` has their numbers among all."""
    if not len(numbers):
        return Grid(np.zeros(3), np.ones(3), (1, 1, 1), np.zeros((1, 1, 1, 2), np.int32), np.zeros(1, np.int32), 0)
    grid = build_grid(corners[numbers].astype(np.float32), across)
    return replace(grid, items=numbers[grid.items].astype(np.int32))


def far_larger(triangles: Floats) -> NDArray[np.bool_]:
    """Return True for each triangle that spans over half of all, if few do; True for all if there are very few."""
    if len(triangles) <= MAX_OUTSIDE // 2:
        return np.ones(len(triangles), dtype=bool)
    spans = np.linalg.norm(triangles.max(axis=1) - triangles.min(axis=1), axis=1)
    whole = np.linalg.norm(triangles.max(axis=(0, 1)) - triangles.min(axis=(0, 1)))
    large = spans > whole / 2
    return large if large.sum() <= MAX_OUTSIDE else np.zeros_like(large)


def _bounds(small: Floats, triangles: Floats) -> tuple[Floats, Floats]:
    """Return a box round the triangles inside the grid, slightly larger than they are and flat along no axis.

    It also grows by the rounding errors of its own sides, which may exceed its size where it lies far from 0.
    """
    if not len(small):
        return np.zeros(3), np.ones(3)
    low, high = small.min(axis=(0, 1)), small.max(axis=(0, 1))
    size = max(float((high - low).max()), 1e-6 * float(np.abs(triangles).max()), 1e-30)
    margin = np.maximum(1e-3 * size, ROUNDINGS * np.maximum(np.abs(low), np.abs(high)))
    return low - margin, high + margin


def _resolution(size: Floats, count: int) -> tuple[int, int, int]:
    """Return the number of cells along each axis: nearly cubes, `DENSITY * count` in all, within the limits."""
    cells = min(max(DENSITY * count, 1.0), MAX_CELLS)
    edge = (float(np.prod(size)) / cells) ** (1 / 3)
    nx, ny, nz = np.clip(np.rint(size / edge), 1, MAX_PER_AXIS).astype(int).tolist()
    while nx * ny * nz > MAX_CELLS:
        nx, ny, nz = (max(1, n * 9 // 10) for n in (nx, ny, nz))
    return nx, ny, nz


def _touched(triangles: Floats, low: Floats, cell: Floats, shape: tuple[int, int, int]) -> tuple[Ints, Ints]:
    """Find all pairs (triangle, cell number) that touch, the triangles in ascending order."""
    local = (triangles - low) / cell  # in units of cells: every cell is now a unit cube
    # What the walk may be off by: f32 positions on coordinates of this size, and a thousandth of a cell.
    margin = 1e-3 + ROUNDINGS * np.abs(np.stack([low, low + cell * shape]) / cell).max(axis=0)
    last = np.array(shape) - 1
    first = np.clip(np.floor(local.min(axis=1) - margin), 0, last).astype(np.int64)
    extent = np.clip(np.floor(local.max(axis=1) + margin), 0, last).astype(np.int64) - first + 1
    counts = extent.prod(axis=1)
    owners, places = [], []
    for begin, end in _chunks(counts):
        part = slice(begin, end)
        owner = np.repeat(np.arange(begin, end), counts[part])
        within = np.arange(len(owner)) - np.repeat(np.cumsum(counts[part]) - counts[part], counts[part])
        ex, ey = extent[owner, 0], extent[owner, 1]
        where = first[owner] + np.stack([within % ex, within // ex % ey, within // (ex * ey)], axis=1)
        keep = counts[owner] == 1  # the only cell that its box reaches needs no more tests
        hard = np.flatnonzero(~keep)
        keep[hard] = _overlap(local[part], owner[hard] - begin, where[hard].astype(np.float64), margin)
        kept = where[keep]
        owners.append(owner[keep])
        places.append(kept[:, 0] + shape[0] * (kept[:, 1] + shape[1] * kept[:, 2]))
    return np.concatenate([np.zeros(0, np.int64), *owners]), np.concatenate([np.zeros(0, np.int64), *places])


def _chunks(counts: Ints) -> list[tuple[int, int]]:
    """Return ranges of triangles, each with about as many candidate pairs as fit in memory at once."""
    if not len(counts):
        return []
    run = np.cumsum(counts) // _PAIRS_AT_ONCE
    begins = np.flatnonzero(np.diff(run, prepend=-1))
    return list(zip(begins.tolist(), [*begins[1:].tolist(), len(counts)], strict=True))


def _overlap(triangles: Floats, owner: Ints, where: Floats, margin: Floats) -> NDArray[np.bool_]:
    """Return True where triangle `owner[k]` meets the unit cube at `where[k]` grown by `margin`; their boxes meet."""
    half = 0.5 + margin
    edges = np.roll(triangles, -1, axis=1) - triangles
    normal = np.cross(edges[:, 0], edges[:, 1])
    keep = np.ones(len(owner), dtype=bool)
    middle = where + 0.5
    # The plane: the cube's middle is no farther from it than the cube reaches along the normal.
    level = np.einsum("ni,ni->n", normal, triangles[:, 0])
    reach = np.abs(normal) @ half
    keep &= np.abs(np.einsum("ni,ni->n", normal[owner], middle) - level[owner]) <= reach[owner]
    # Each projection: the cube's middle is inside every edge, moved outward by the square's reach.
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        turn = np.where(normal[:, axis] < 0, -1.0, 1.0)
        for corner in range(3):
            na, nb = -edges[:, corner, b] * turn, edges[:, corner, a] * turn
            base = na * triangles[:, corner, a] + nb * triangles[:, corner, b]
            slack = np.abs(na) * half[a] + np.abs(nb) * half[b] - base
            keep &= na[owner] * middle[:, a] + nb[owner] * middle[:, b] + slack[owner] >= 0
    return keep
