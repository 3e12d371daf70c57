"""What emitted code reads by index: tables, and the place of a tile in the grid.

Stage: run. Indices are clamped on every axis: nothing here traps.

>>> table = TableView(np.float32([10, 20, 30]), 1)
>>> table.gather(np.int32([-5, 1, 9]))
array([10., 20., 30.], dtype=float32)
>>> table.neighbour(Place(0, 3, (3,)), 1)
array([20., 30., 30.], dtype=float32)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Listed", "Place", "TableView"]

Array = NDArray[Any]

_FARTHEST = 2**30
_MARGIN = 16
"""Columns that are kept on both sides of a tile, for reads beyond the border of a table."""
_LINES = 2
"""Lines that are kept above and below it."""


@dataclass(frozen=True, slots=True)
class Place:
    """The elements of a tile: from `start` to `stop` in C order, in a grid of this shape; a `block` has whole rows."""

    start: int
    stop: int
    shape: tuple[int, ...]
    block: bool = False

    lines: tuple[int, int] = field(init=False)
    columns: tuple[int, int] = field(init=False)
    skipped: int = field(init=False)

    def __post_init__(self) -> None:
        """The lines and columns that the tile has a part in, and how many elements of these come before it."""
        row = self.shape[-1] if self.shape else 1
        top, bottom = (0, 0) if len(self.shape) < 2 else (self.start // row, (self.stop - 1) // row)
        left, right = (self.start - top * row, self.stop - bottom * row) if top == bottom else (0, row)
        object.__setattr__(self, "lines", (top, bottom + 1))
        object.__setattr__(self, "columns", (left, right))
        object.__setattr__(self, "skipped", 0 if top == bottom else self.start - top * row)

    @property
    def extents(self) -> tuple[int, ...]:
        """The shape of what varies in the tile: (lanes,), or (rows, columns)."""
        lanes = self.stop - self.start
        return (lanes // self.shape[-1], self.shape[-1]) if self.block else (lanes,)

    @property
    def index(self) -> Any:
        """Where each element is: (lanes,) in a grid of one axis, else (axes, lanes); of a block, one for each axis."""
        if self.block:
            axes = np.empty(2, object)  # to be picked from like any other vector
            axes[0] = np.arange(*self.lines, dtype=np.int32)[:, None]
            axes[1] = np.arange(*self.columns, dtype=np.int32)[None]
            return axes
        every = np.unravel_index(np.arange(self.start, self.stop), self.shape)
        return np.array(every[0] if len(every) == 1 else every, np.int32)

    def moved(self, *offsets: int) -> Any:
        """The index moved by an offset on each axis, which may wrap around, as that of an int does."""
        index = (self.index,) if len(offsets) == 1 else self.index
        moved = [axis + np.array(offset, np.int32) for axis, offset in zip(index, offsets, strict=True)]
        return moved[0] if len(offsets) == 1 else moved


@dataclass(frozen=True, slots=True)
class Listed(Place):
    """Elements anywhere in a grid, by their numbers in C order."""

    elements: Array = field(kw_only=True)

    @classmethod
    def of(cls, elements: Array, shape: tuple[int, ...]) -> Listed:
        """These elements as a tile."""
        return cls(0, len(elements), shape, elements=elements)

    @property
    def index(self) -> Any:
        """The index of each element in the grid: (lanes,) for one axis, else (axes, lanes)."""
        every = np.unravel_index(self.elements, self.shape)
        return np.array(every[0] if len(every) == 1 else every, np.int32)


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
        self._plane = self._rows.reshape(-1, extents[-1], *self._rows.shape[1:])
        self._wide: tuple[object, Array] = None, self._plane
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

    def gather(self, index: Any) -> Array:
        """The elements at the lanes' indices, an array for each axis, clamped on every axis."""
        if len(self._extents) > 1:
            index = self._flat(index)
        elif index.ndim == 0:
            return self.at(index)  # a function may be called with what is the same for every lane
        return self._components_first(self._rows.take(index, axis=0, mode="clip"))

    def _components_first(self, found: Array) -> Array:
        if not self._vectors:
            return found
        axes = range(found.ndim - 1)
        return np.ascontiguousarray(found.transpose(found.ndim - 1, *axes))

    def neighbour(self, place: Place, *offsets: Any) -> Array:
        """The elements at the tile's own indices, moved by an offset on each axis, clamped; it may be a view."""
        down, across = (0, *(o if type(o) is int else int(o.item()) for o in offsets))[-2:]
        near = -_FARTHEST < down < _FARTHEST and -_FARTHEST < across < _FARTHEST
        if not near or isinstance(place, Listed):
            return self.gather(place.moved(*(down, across)[-len(offsets) :]))
        found = self._moved(place.lines, place.columns, down, across)
        if not place.block:
            found = found.reshape(-1, *self._rows.shape[1:])[place.skipped : place.skipped + place.stop - place.start]
        return self._components_first(found) if self._vectors else found

    def _moved(self, lines: tuple[int, int], columns: tuple[int, int], down: int, across: int) -> Array:
        """What lies so far from these lines and columns; a margin is kept that serves for other reads too."""
        begin, end = columns[0] + across, columns[1] + across
        if 0 <= begin and end <= self._extents[-1] and 0 <= lines[0] + down and lines[1] + down <= len(self._plane):
            return self._plane[lines[0] + down : lines[1] + down, begin:end]
        if not (-_MARGIN <= across <= _MARGIN and -_LINES <= down <= _LINES):
            return self._clamped((lines[0] + down, lines[1] + down), (begin, end))
        block, wide = self._wide
        if block != (lines, columns):
            beyond = _LINES if len(self._extents) > 1 else 0
            around = (lines[0] - beyond, lines[1] + beyond), (columns[0] - _MARGIN, columns[1] + _MARGIN)
            block, wide = (lines, columns), self._clamped(*around)
            self._wide = block, wide
        top = _LINES + down if len(self._extents) > 1 else 0
        left = _MARGIN + across
        return wide[top : top + lines[1] - lines[0], left : left + columns[1] - columns[0]]

    def _clamped(self, lines: tuple[int, int], columns: tuple[int, int]) -> Array:
        """These lines and columns, those that lie outside as the nearest."""
        (top, bottom), (low, high), (height, width) = lines, columns, self._plane.shape[:2]
        made = np.empty((bottom - top, high - low, *self._plane.shape[2:]), self._plane.dtype)
        first, last = (min(max(n, 0), bottom - top) for n in (-top, height - top))
        begin, end = (min(max(n, 0), high - low) for n in (-low, width - low))
        inside = made[first:last]
        rows = self._plane[top + first : top + last]
        inside[:, :begin] = rows[:, :1]
        inside[:, begin:end] = rows[:, low + begin : low + end]
        inside[:, end:] = rows[:, -1:]
        if first < last:
            made[:first], made[last:] = made[first], made[last - 1]
        else:
            made[...] = self._clamped((0, 1) if bottom <= 0 else (height - 1, height), columns)
        return made

    def _flat(self, index: Any) -> Array:
        """The number of the element in memory, from its clamped index on each axis."""
        if len(self._rows) >= 2**31:
            return np.asarray(np.ravel_multi_index(tuple(index), self._extents, mode="clip"))
        flat: Array = np.clip(index[0], 0, self._extents[0] - 1)
        for axis, extent in zip(index[1:], self._extents[1:], strict=True):
            flat = flat * flat.dtype.type(extent) + np.clip(axis, 0, extent - 1)
        return flat
