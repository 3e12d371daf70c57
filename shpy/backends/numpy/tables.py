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

from shpy.ir.meaning import floor_mod_int

__all__ = ["Listed", "Place", "TableView"]

Array = NDArray[Any]
Range = tuple[int, int]

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
        """The elements at the tile's own indices, moved by an offset on each axis, clamped; it may be a view.

        As many moduli may follow the offsets: what an index is taken modulo before it is clamped.
        """
        given, rank = [o if type(o) is int else int(o.item()) for o in offsets], len(self._extents)
        down, across = (0, *given[:rank])[-2:]
        moduli = (given[-2] if rank > 1 else 1, given[-1]) if len(given) > rank else None
        near = -_FARTHEST < down < _FARTHEST and -_FARTHEST < across < _FARTHEST
        if near and moduli is not None:
            down, across = map(_least_offset, (down, across), moduli)
        if not near or isinstance(place, Listed):
            moved = place.moved(*(down, across)[-rank:])
            return self.gather(moved if moduli is None else _modulo(moved, moduli[-rank:]))
        found = self._moved(place.lines, place.columns, (down, across), moduli)
        if not place.block:
            found = found.reshape(-1, *self._rows.shape[1:])[place.skipped : place.skipped + place.stop - place.start]
        return self._components_first(found) if self._vectors else found

    def _moved(self, lines: Range, columns: Range, by: tuple[int, int], moduli: tuple[int, int] | None) -> Array:
        """What lies so far from these lines and columns; a margin is kept that serves for other reads too."""
        (down, across), (height, width) = by, self._plane.shape[:2]
        if moduli is not None:
            height, width = min(height, moduli[0]), min(width, moduli[1])
        begin, end = columns[0] + across, columns[1] + across
        if 0 <= begin and end <= width and 0 <= lines[0] + down and lines[1] + down <= height:
            return self._plane[lines[0] + down : lines[1] + down, begin:end]
        if not (-_MARGIN <= across <= _MARGIN and -_LINES <= down <= _LINES):
            return self._around((lines[0] + down, lines[1] + down), (begin, end), moduli)
        block, wide = self._wide
        if block != (lines, columns, moduli):
            beyond = _LINES if len(self._extents) > 1 else 0
            around = (lines[0] - beyond, lines[1] + beyond), (columns[0] - _MARGIN, columns[1] + _MARGIN)
            block, wide = (lines, columns, moduli), self._around(*around, moduli)
            self._wide = block, wide
        top = _LINES + down if len(self._extents) > 1 else 0
        left = _MARGIN + across
        return wide[top : top + lines[1] - lines[0], left : left + columns[1] - columns[0]]

    def _around(self, lines: Range, columns: Range, moduli: tuple[int, int] | None) -> Array:
        """These lines and columns; those that lie outside as the nearest, or modulo as much as there is."""
        if moduli is None:
            return self._clamped(lines, columns)
        rows, places = (
            np.clip(floor_mod_int(np.arange(*some), np.array(modulus)), 0, extent - 1)
            for some, modulus, extent in zip((lines, columns), moduli, self._plane.shape, strict=False)
        )
        taken = self._plane[rows]
        made = np.empty((len(rows), len(places), *taken.shape[2:]), taken.dtype)
        starts = [0, *(np.flatnonzero(np.diff(places) != 1) + 1).tolist()]  # of those that lie side by side
        for start, stop in zip(starts, [*starts[1:], len(places)], strict=True):
            made[:, start:stop] = taken[:, places[start] : places[start] + stop - start]
        return made

    def _clamped(self, lines: Range, columns: Range) -> Array:
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


def _least_offset(offset: int, modulus: int) -> int:
    """The least offset, in size, that leads to the same place modulo a number: -1 for n - 1 modulo n."""
    return offset if modulus <= 0 else (offset + modulus // 2) % modulus - modulus // 2


def _modulo(index: Any, moduli: tuple[int, ...]) -> Any:
    """An index modulo one number for each axis."""
    if len(moduli) == 1:
        return floor_mod_int(index, np.array(moduli[0], np.int32))
    return [floor_mod_int(axis, np.array(n, np.int32)) for axis, n in zip(index, moduli, strict=True)]
