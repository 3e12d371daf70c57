"""Data that emitted code reads by index: tables, and the place of a tile in the grid.

Stage: run. Indices are clamped on every axis, so no index raises an error.

>>> table = TableView(np.float32([10, 20, 30]), 1)
>>> table.gather(np.int32([-5, 1, 9]))
array([10., 20., 30.], dtype=float32)
>>> table.neighbour(Place(0, 3, (3,)), 1)
array([20., 30., 30.], dtype=float32)
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.backend.numpy.lanes import clamp_index
from shpy.ir.meaning import floor_mod_int

Array = NDArray[Any]
Range = tuple[int, int]

_FARTHEST = 2**30
_LINES = (1, 2)
"""The number of lines that may be kept above and below a tile, for reads beyond the border of a table."""
_COLUMNS = (1, 4, 16)
"""The number of columns on both sides of it: the fewer, the less is copied."""
_MANY_PIECES = 128
"""From this many elements beyond the border on, they are gathered one by one."""
_KEPT_READS = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """The elements of a tile: from `start` to `stop` in C order, in a grid of this shape; a `block` has whole rows."""

    start: int
    stop: int
    shape: tuple[int, ...]
    block: bool = False

    part: slice = field(init=False)
    extents: tuple[int, ...] = field(init=False)
    lines: tuple[int, int] = field(init=False)
    columns: tuple[int, int] = field(init=False)
    skipped: int = field(init=False)
    lanes: Any = field(init=False)
    """The shape of a tile's arrays: a number of lanes, or the extents of a block."""

    def __post_init__(self) -> None:
        """Derive the `extents`, the shape (lanes,) or (rows, columns) of the tile's varying values, and its place.

        The place are the lines and columns that the tile touches, and the number of their elements before the tile.
        """
        row, lanes = self.shape[-1] if self.shape else 1, self.stop - self.start
        top, bottom = (0, 0) if len(self.shape) < 2 else (self.start // row, (self.stop - 1) // row)
        left, right = (self.start - top * row, self.stop - bottom * row) if top == bottom else (0, row)
        object.__setattr__(self, "part", slice(self.start, self.stop))
        object.__setattr__(self, "extents", (lanes // row, row) if self.block else (lanes,))
        object.__setattr__(self, "lanes", self.extents if self.block else lanes)
        object.__setattr__(self, "lines", (top, bottom + 1))
        object.__setattr__(self, "columns", (left, right))
        object.__setattr__(self, "skipped", 0 if top == bottom else self.start - top * row)

    @property
    def index(self) -> Any:
        """Return the places of the elements: (lanes,) in one axis, else (axes, lanes); of a block, by axis."""
        if self.block:
            axes = np.empty(2, object)  # its components are read like those of any vector
            axes[0] = np.arange(*self.lines, dtype=np.int32)[:, None]
            axes[1] = np.arange(*self.columns, dtype=np.int32)[None]
            return axes
        every = np.unravel_index(np.arange(self.start, self.stop), self.shape)
        return np.array(every[0] if len(every) == 1 else every, np.int32)

    def moved(self, *offsets: int) -> Any:
        """Return the index plus an offset on each axis; sums wrap around as ints do."""
        index = (self.index,) if len(offsets) == 1 else self.index
        moved = [axis + np.array(offset, np.int32) for axis, offset in zip(index, offsets, strict=True)]
        return moved[0] if len(offsets) == 1 else moved


@lru_cache(maxsize=16)
def places_of(shape: tuple[int, ...], tile: int, *, grid: bool, first: int | None = None) -> tuple[Place, ...]:
    """Return the tiles of a grid, each of at most `tile` elements; blocks if `grid` and whole rows fit.

    The first tile has about `first` elements, and each has up to four times as many as the one before.
    """
    block = grid and len(shape) == 2 and 0 < shape[1] <= tile
    count, unit = math.prod(shape), shape[1] if block else 1
    places, start, step = [], 0, max(unit, (first or tile) // unit * unit)
    while start < count:
        places.append(Place(start, min(start + step, count), shape, block))
        start, step = start + step, min(4 * step, tile // unit * unit)
    return tuple(places)


@dataclass(frozen=True, slots=True, eq=False)
class ElementList(Place):
    """Elements anywhere in a grid, by their numbers in C order."""

    elements: Array = field(kw_only=True)

    @classmethod
    def of(cls, elements: Array, shape: tuple[int, ...]) -> ElementList:
        """Return these elements as a tile."""
        return cls(0, len(elements), shape, elements=elements)

    @property
    def index(self) -> Any:
        """The index of each element in the grid: (lanes,) for one axis, else (axes, lanes)."""
        every = np.unravel_index(self.elements, self.shape)
        return np.array(every[0] if len(every) == 1 else every, np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class _Rectangle:
    """A rectangle of a table, part of it beyond the border: the parts to copy, each with its place in the array."""

    shape: tuple[int, ...]
    copies: tuple[tuple[tuple[slice, slice], Array], ...]

    def array(self) -> Array:
        """Copy the parts of the block into a new array."""
        array = np.empty(self.shape, self.copies[0][1].dtype)
        for into, part in self.copies:
            array[into] = part
        return array


class TableView:
    """A table as emitted code reads it.

    `at` a uniform index, by a `gather` with one for each lane, or as a `neighbour` of a tile's own place. It looks into
    the array; after a change of that it is told to `renew` what it has copied.
    """

    def __init__(self, array: Array, rank: int) -> None:
        extents = array.shape[:rank]
        self._extents = extents
        self._vectors = array.ndim > rank
        self._rows = np.ascontiguousarray(array).reshape(-1, *array.shape[rank:])
        self._columns = self._rows[..., None] if self._vectors else self._rows
        self._plane = self._rows.reshape(-1, extents[-1], *self._rows.shape[1:])
        self._beyond = 0, 0
        self._blocks: dict[tuple[Any, ...], _Rectangle] = {}
        self._reads: dict[tuple[Any, ...], tuple[_Rectangle | None, Any]] = {}
        self._wide: tuple[_Rectangle | None, Array] = None, self._plane
        self.size: Array = np.array(extents, np.int32).reshape(() if rank == 1 else (rank, 1))[()]
        """Its shape, as a uniform."""

    def looks_into(self, array: Array) -> bool:
        """Return whether it reads this array itself, and no copy of it."""
        return np.may_share_memory(self._rows, array)

    def renew(self) -> None:
        """Drop the copies, since the array has changed."""
        self._wide = None, self._plane

    def at(self, index: Array) -> Array:
        """Return the element at a uniform index, clamped on every axis."""
        if len(self._extents) == 1:
            only: Array = self._columns[min(max(index.item(), 0), self._extents[0] - 1)]
            return only
        flat = 0
        for i, extent in zip(np.ravel(index).tolist(), self._extents, strict=True):
            flat = flat * extent + min(max(i, 0), extent - 1)
        element: Array = self._columns[flat]
        return element

    def gather(self, index: Any) -> Array:
        """Return the elements at the lanes' indices, an array for each axis, clamped on every axis."""
        if len(self._extents) > 1:
            index = self._flat(index)
        elif index.ndim == 0:
            return self.at(index)  # a function may be called with what is the same for every lane
        return self._components_first(self._rows.take(index, axis=0, mode="clip"))

    def _components_first(self, elements: Array) -> Array:
        if not self._vectors:
            return elements
        axes = range(elements.ndim - 1)
        return np.ascontiguousarray(elements.transpose(elements.ndim - 1, *axes))

    def neighbour(self, place: Place, *offsets: Any) -> Array:
        """Return the elements at the tile's own indices, moved by an offset on each axis, clamped; it may be a view.

        The offsets may be followed by as many moduli: each index is taken modulo its own before it is clamped.
        """
        distances = tuple([o if type(o) is int else int(o.item()) for o in offsets])
        entry = self._reads.get((place, distances))
        if entry is None:
            entry = self._read(place, distances)
        if entry is None:
            return self._gathered(place, distances)
        block, at = entry
        elements: Array = at if block is None else block.array() if at is ... else self._copied(block)[at]
        if not place.block:
            elements = elements.reshape(-1, *self._rows.shape[1:])[
                place.skipped : place.skipped + place.stop - place.start
            ]
        return self._components_first(elements) if self._vectors else elements

    def _split(self, distances: tuple[int, ...]) -> tuple[tuple[int, int], tuple[int, int] | None]:
        """Return the distances down and across, and the moduli of both."""
        rank = len(self._extents)
        by = (0, *distances[:rank])[-2:]
        if len(distances) == rank:
            return (by[0], by[1]), None
        moduli = distances[-2] if rank > 1 else 1, distances[-1]
        if _is_near(by):
            by = tuple(map(_least_offset, by, moduli))
        return (by[0], by[1]), moduli

    def _gathered(self, place: Place, distances: tuple[int, ...]) -> Array:
        """Return the elements at offsets from the place; each is gathered by its own index."""
        by, moduli = self._split(distances)
        rank = len(self._extents)
        moved = place.moved(*by[-rank:])
        return self.gather(moved if moduli is None else _modulo(moved, moduli[-rank:]))

    def _read(self, place: Place, distances: tuple[int, ...]) -> tuple[_Rectangle | None, Any] | None:
        """Return a view of the table, or a block and what of it is read; None where there is no such thing.

        A block has a margin that serves for other reads too.
        """
        (down, across), moduli = self._split(distances)
        read: tuple[_Rectangle | None, Any]
        if isinstance(place, ElementList) or not _is_near((down, across)):
            return None
        lines, columns = _widened(place.lines, -down, down), _widened(place.columns, -across, across)
        height, width = self._plane.shape[:2]
        if moduli is not None:
            height, width = min(height, moduli[0]), min(width, moduli[1])
        if 0 <= columns[0] and columns[1] <= width and 0 <= lines[0] and lines[1] <= height:
            read = None, self._plane[slice(*lines), slice(*columns)]
        else:
            far = abs(down) > _LINES[-1] or abs(across) > _COLUMNS[-1]
            above, beside = (0, 0) if far else self._margin(abs(down), abs(across))
            if not far:
                lines, columns = _widened(place.lines, above, above), _widened(place.columns, beside, beside)
            block = self._block(lines, columns, moduli)
            if block is None:
                return None
            top, left = above + down, beside + across
            height, width = place.lines[1] - place.lines[0], place.columns[1] - place.columns[0]
            read = block, ... if far else (slice(top, top + height), slice(left, left + width))
        if len(self._reads) >= _KEPT_READS:
            self._reads.clear()
        self._reads[place, distances] = read
        return read

    def _margin(self, down: int, across: int) -> tuple[int, int]:
        """Return the lines and columns that blocks have around a tile: as many as any read has asked for so far."""
        lines, columns = self._beyond
        if down > lines or across > columns:
            lines = next(n for n in (0, *_LINES) if n >= max(down, lines))
            columns = next(n for n in (0, *_COLUMNS) if n >= max(across, columns))
            self._beyond = lines, columns
            self._reads.clear()
        return lines, columns

    def _copied(self, block: _Rectangle) -> Array:
        """Return the array of a block; the array of the block that was asked for last is kept."""
        last, wide = self._wide
        if last is not block:
            wide = block.array()
            self._wide = block, wide
        return wide

    def _block(self, lines: Range, columns: Range, moduli: tuple[int, int] | None) -> _Rectangle | None:
        """Return these lines and columns; those that lie outside as the nearest, or modulo as much as there is.

        None if they lie in many pieces.
        """
        block = self._blocks.get((lines, columns, moduli))
        if block is None:
            height, width = self._plane.shape[:2]
            down, across = moduli or (None, None)
            rows, places = _pieces(lines, down, height), _pieces(columns, across, width)
            if len(rows) * len(places) > _MANY_PIECES:
                return None
            copies = tuple(((into, beside), self._plane[row, place]) for into, row in rows for beside, place in places)
            block = _Rectangle((lines[1] - lines[0], columns[1] - columns[0], *self._plane.shape[2:]), copies)
            if len(self._blocks) >= _KEPT_READS:
                self._blocks.clear()
            self._blocks[lines, columns, moduli] = block
        return block

    def _flat(self, index: Any) -> Array:
        """Return the number of the element in memory, from its clamped index on each axis."""
        if len(self._rows) >= 2**31:
            return np.asarray(np.ravel_multi_index(tuple(index), self._extents, mode="clip"))
        flat = clamp_index(index[0], self._extents[0])
        for axis, extent in zip(index[1:], self._extents[1:], strict=True):
            flat = flat * flat.dtype.type(extent) + clamp_index(axis, extent)
        return flat


@lru_cache(maxsize=256)
def _pieces(some: Range, modulus: int | None, extent: int) -> tuple[tuple[slice, slice], ...]:
    """Return the indices of a range, modulo a number and clamped, in pieces.

    Each is where it lies in the range, and the elements that it takes: some that follow each other, or one for all.
    """
    places = np.arange(*some)
    if modulus is not None:
        places = floor_mod_int(places, np.array(modulus))
    places = np.clip(places, 0, extent - 1)
    steps = np.diff(places)
    ends = {step: [*np.flatnonzero(steps != step).tolist(), len(steps)] for step in (0, 1)}
    pieces, at = [], 0
    while at < len(places):
        step = int(steps[at]) if at < len(steps) else 0
        stop = at + 1
        if step in ends:
            stop = ends[step][bisect_left(ends[step], at)] + 1
        pieces.append((slice(at, stop), slice(int(places[at]), int(places[stop - 1]) + 1)))
        at = stop
    return tuple(pieces)


def _widened(some: Range, before: int, after: int) -> Range:
    return some[0] - before, some[1] + after


def _is_near(by: tuple[int, ...]) -> bool:
    return all(-_FARTHEST < n < _FARTHEST for n in by)


def _least_offset(offset: int, modulus: int) -> int:
    """Return the least offset, in size, that leads to the same place modulo a number: -1 for n - 1 modulo n."""
    return offset if modulus <= 0 else (offset + modulus // 2) % modulus - modulus // 2


def _modulo(index: Any, moduli: tuple[int, ...]) -> Any:
    """Return an index modulo one number for each axis."""
    if len(moduli) == 1:
        return floor_mod_int(index, np.array(moduli[0], np.int32))
    return [floor_mod_int(axis, np.array(n, np.int32)) for axis, n in zip(index, moduli, strict=True)]
