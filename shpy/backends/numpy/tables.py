"""What emitted code reads by index: tables, and the place of a tile in the grid.

Stage: run. Indices are clamped on every axis: nothing here traps.

>>> table = TableView(np.float32([10, 20, 30]), 1)
>>> table.gather(np.int32([-5, 1, 9]))
array([10., 20., 30.], dtype=float32)
>>> table.neighbour(Place(0, 3, (3,)), 1)
array([20., 30., 30.], dtype=float32)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Place", "TableView"]

Array = NDArray[Any]

_FARTHEST = 2**30


@dataclass(frozen=True, slots=True)
class Place:
    """The elements of a tile: from `start` to `stop` in C order, in a grid of this shape."""

    start: int
    stop: int
    shape: tuple[int, ...]

    @property
    def index(self) -> Array:
        """Where each element is: (lanes,) in a grid of one axis, else (axes, lanes)."""
        axes = np.unravel_index(np.arange(self.start, self.stop), self.shape)
        return np.array(axes[0] if len(axes) == 1 else axes, np.int32)


class TableView:
    """A table as emitted code reads it.

    `at` a uniform index, by a `gather` with one for each lane, or as a `neighbour` of a tile's own place.
    """

    def __init__(self, array: Array, rank: int) -> None:
        extents = array.shape[:rank]
        self._extents = extents
        self._vectors = array.ndim > rank
        self._rows = np.ascontiguousarray(array).reshape(-1, *array.shape[rank:])
        self._columns = self._rows[..., None] if self._vectors else self._rows
        self.size: Array = np.array(extents, np.int32).reshape(() if rank == 1 else (rank, 1))[()]
        """Its shape, as a uniform."""

    def at(self, index: Array) -> Array:
        """The element at a uniform index, clamped on every axis."""
        if len(self._extents) == 1:
            only: Array = self._columns[min(max(index.item(), 0), self._extents[0] - 1)]
            return only
        flat = 0
        for i, extent in zip(np.ravel(index).tolist(), self._extents, strict=True):
            flat = flat * extent + min(max(i, 0), extent - 1)
        element: Array = self._columns[flat]
        return element

    def gather(self, index: Array) -> Array:
        """The elements at the lanes' indices, clamped on every axis."""
        if index.ndim == 0:
            return self.at(index)  # a function may be called with what is the same for every lane
        if len(self._extents) > 1:
            index = self._flat(index)
        found = self._rows.take(index, axis=0, mode="clip")
        return np.ascontiguousarray(found.T) if self._vectors else found

    def neighbour(self, place: Place, *offsets: Any) -> Array:
        """The elements at the tile's own indices, moved by an offset on each axis, clamped; it may be a view."""
        moved = [int(np.asarray(o).item()) for o in offsets]
        if any(abs(m) > _FARTHEST for m in moved):  # the index may wrap around, as that of an int does
            return self.gather(place.index + np.array(moved, np.int32).reshape(-1, *[1] * (len(moved) > 1)))
        first, last = place.start, place.stop - 1
        row = place.shape[-1]
        top, bottom = (0, 0) if len(moved) == 1 else (first // row, last // row)
        left, right = (first - top * row, last - bottom * row) if top == bottom else (0, row - 1)
        down, across = (0, *moved)[-2:]
        block = self._block((top + down, bottom + down + 1), (left + across, right + across + 1))
        start = 0 if top == bottom else first - top * row
        found = block.reshape(-1, *self._rows.shape[1:])[start : start + place.stop - place.start]
        return np.ascontiguousarray(found.T) if self._vectors else found

    def _block(self, lines: tuple[int, int], columns: tuple[int, int]) -> Array:
        """These lines and columns of a table of two axes at most, those that lie outside as the nearest."""
        height, width = (1, *self._extents)[-2:]
        whole = self._rows.reshape(height, width, *self._rows.shape[1:])
        if 0 <= lines[0] and lines[1] <= height:
            rows = whole[slice(*lines)]
        else:
            rows = whole[np.clip(np.arange(*lines), 0, height - 1)]
        low, high = columns
        if 0 <= low and high <= width:
            return np.asarray(rows[:, low:high])
        made = np.empty((len(rows), high - low, *rows.shape[2:]), rows.dtype)
        begin, end = (min(max(n, 0), high - low) for n in (-low, width - low))
        made[:, :begin] = rows[:, :1]
        made[:, begin:end] = rows[:, low + begin : low + end]
        made[:, end:] = rows[:, -1:]
        return made

    def _flat(self, index: Array) -> Array:
        """The number of the element in memory, from its clamped index on each axis."""
        if len(self._rows) >= 2**31:
            return np.asarray(np.ravel_multi_index(tuple(index), self._extents, mode="clip"))
        flat: Array = np.clip(index[0], 0, self._extents[0] - 1)
        for axis, extent in zip(index[1:], self._extents[1:], strict=True):
            flat *= flat.dtype.type(extent)
            flat += np.clip(axis, 0, extent - 1)
        return flat
