"""Gather and scatter: elements read from places, and written to places, that an index names.

Stage: run. An index counts the elements of a stream in C order, whatever its axes are.

    moved = sh.gather(particles, order)
    cells = sh.scatter(masses, cell, (64, 64), combine=add)
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any

import numpy as np

from shpy.backend.base import FoldPlaces, Memory, overlap
from shpy.collectives.arguments import check_place, check_stream, indices_at, shaped
from shpy.collectives.chunk_places import gather_chunks, scatter_chunks
from shpy.collectives.leaves import Leaves, element_class, first_not_below, over_leaf, run_over
from shpy.collectives.programs import annotated, store
from shpy.collectives.trees import check_combination, memories_of, retyped
from shpy.errors import ShpyTypeError
from shpy.ieee import in_ieee_arithmetic
from shpy.ir.types import Base
from shpy.lang.data.tables import TableType
from shpy.lang.programs.control import SH_BREAK, SH_DISCARD, SH_FOR, SH_IF
from shpy.lang.recording.location import here
from shpy.lang.values.builtins import cond, grid_index
from shpy.lang.values.structure import build_values, is_lazy, layout_of, leaves, spoken_type
from shpy.lang.values.types import Attrib1i, Attrib1u
from shpy.programs import Program
from shpy.streams.elements import given_shape
from shpy.streams.stream import Place, Stream

_AT_ONCE = 1 << 14
"""The most values of a place that one run combines, since a driver may end longer loops."""


@in_ieee_arithmetic
def gather(stream: Any, index: Any, type: Any = None) -> Any:
    """Return the element at each index; the result has the shape of `index`.

    `index`: ints, a Stream of Attrib1i or Attrib1u or an array. They count the elements in C order. An index out of
    range reads the nearest element, the first or the last, as a Table of one axis does.
    Where one of the two is a Dask array, the other is one or an array of numpy, and so is the result: Dask's indexing
    moves the elements, and no process holds the whole table. `type` is then that of an element, such as `sh.Point3f`
    with the components on the last axis; without it the elements are numbers.
    Raises ShpyTypeError for an index of another type or device, for elements of another type, for a stream without
    elements, and for a `type` beside a stream, which has its own.
    """
    if is_lazy(stream) or is_lazy(index):
        return gather_chunks(stream, index, type)
    if isinstance(stream, dict) and any(map(is_lazy, stream.values())):
        field = next(iter(stream))
        raise ShpyTypeError(
            "gather takes one Dask array, not a dict of them", loc=here(), cure=f'sh.gather(table["{field}"], index)'
        )
    elements = check_stream(stream, "gather")
    if type is not None:
        raise ShpyTypeError(
            f"type= beside {elements!r}, which has its own", loc=here(), cure="sh.gather(stream, index)"
        )
    memory, shape = indices_at(elements.place, index, "index")
    if memory.count and not elements.size:
        raise ShpyTypeError("gather from a stream without elements", loc=here(), cure="a stream of one element or more")
    leaves_at = Leaves(elements.place)
    return shaped(elements, leaves_at.take_each(memories_of(elements), memory), shape)


@in_ieee_arithmetic
def scatter(
    values: Any, index: Any, shape: Any = None, combine: Program | None = None, out: Stream | None = None
) -> Any:
    """Write each value to the place that its index names, in a new stream of `shape` or in `out`; return that stream.

    `index`: an int for each value, a Stream of Attrib1i or Attrib1u or an array. It counts the places in C order. A
    value whose index is out of range is dropped. Places without a value hold zeros, or keep the values of `out`. Of
    several values for a place the last one stays: that with the largest position, in C order, among the values.
    `combine`, a program (a, b) -> a, combines them instead: first with second, the result with the third, and so on in
    the order of their positions, a left fold. The previous values of `out` are not combined. On GLSL
    the values of one place take a loop, so a place with many values takes long. Of a Dask array of scalars or vectors,
    with an index that is one or an array of numpy, and a shape, it returns a Dask array, for any chunks with the bits
    of one Stream. A worker holds all values that go to a block of it. Raises ShpyTypeError for an index of another
    type, shape or device, a program of other types, and for an `out` of another type, shape or device.
    """
    if is_lazy(values) or is_lazy(index):
        return scatter_chunks(scatter, values, index, shape, combine, out)
    elements = check_stream(values, "scatter")
    memory, index_shape = indices_at(elements.place, index, "index")
    if index_shape != elements.shape:
        raise ShpyTypeError(
            f"index has the shape {index_shape}, and the values {elements.shape}", loc=here(), cure="an index a value"
        )
    if combine is not None:
        check_combination(combine, elements, "scatter")
    target = _target(elements, shape, out)
    if combine is None or elements.size == 0 or target.size == 0:
        leaves_at = Leaves(elements.place)
        for entry, value in zip(target.leaf_entries(), elements.leaf_entries(), strict=True):
            put = leaves_at.put(value.memory, memory, entry.memory)
            if put is not entry.memory:
                entry.replace(put)
    else:
        _fold(elements, memory, target, combine)
    return target


def _target(values: Stream, shape: Any, out: Stream | None) -> Stream:
    if out is None:
        if shape is None:
            raise ShpyTypeError("scatter needs a shape", loc=here(), cure="sh.scatter(values, index, shape), or out=")
        return Stream.empty(given_shape(shape), values.type, *values.place)
    check_place(check_stream(out, "out"), values.place, "out")
    if out.type is not values.type or (shape is not None and given_shape(shape) != out.shape):
        expected = out.shape if shape is None else given_shape(shape)
        raise ShpyTypeError(
            f"out is {out!r}, not {values.type.__name__} of shape {expected}",
            loc=here(),
            cure=f"sh.Stream.empty({expected}, {spoken_type(values.type)}, {values.backend!r})",
        )
    return out


def _fold(values: Stream, index: Memory, target: Stream, combine: Program) -> None:
    """Combine the values for each element of `target`, in their order, by the device itself or by programs."""
    own = _own_fold(values.place, combine)
    if own is None:
        _fold_by_programs(values, index, target, combine)
        return
    targets = memories_of(target)
    memories = [_apart(memory, targets, values.place) for memory in (index, *memories_of(values))]
    own(memories[1:], memories[0], targets)


def _fold_by_programs(values: Stream, index: Memory, target: Stream, combine: Program) -> None:
    """Combine the values by programs: a stable sort by index makes the values of an element adjacent."""
    place, leaves_at = values.place, Leaves(values.place)
    keys = run_over(place, _unsigned(element_class(index)), values.size, index=over_leaf(place, index))
    (unordered,) = memories_of(keys)
    order = leaves_at.order(unordered, descending=False)
    inputs = {"keys": over_leaf(place, leaves_at.take(unordered, order))}
    for k, memory in enumerate(leaves_at.take_each(memories_of(values), order)):
        inputs[f"given{k}"] = over_leaf(place, memory)
    out = retyped(target, target.type, (target.size,))
    program = _folding(combine, values.type)
    for first in range(0, values.size, _AT_ONCE):
        result = run_over(place, program, out.size, out, before=out, first=np.array([first], np.int32), **inputs)
        if not result.count:
            break
    for now, then in zip(out.leaf_entries(), target.leaf_entries(), strict=True):
        if now.memory is not then.memory:
            then.replace(now.memory)


@lru_cache(maxsize=256)
def _own_fold(place: Place, combine: Program) -> FoldPlaces | None:
    """Return the device's own fold by place with a program; None if it has none."""
    fold_places = place.space.collectives.fold_places
    return None if fold_places is None else fold_places(combine.ir, place.precision)


def _apart(memory: Memory, targets: list[Memory], place: Place) -> Memory:
    """Return the memory, or a copy of it where it overlaps a target."""
    if not any(overlap(memory, target) for target in targets):
        return memory
    return over_leaf(place, memory).copy().leaf_entries()[0].memory


@cache
def _unsigned(index: Any) -> Program:
    """Record the program that converts indices to sort keys; negative ones come last."""

    def key(index: Any) -> Any:
        return cond(index < 0, Attrib1u(0xFFFFFFFF), Attrib1u(index)) if index.base is Base.I else index

    return annotated(key, index=index, out=Attrib1u)


@lru_cache(maxsize=256)
def _folding(combine: Program, element: Any) -> Program:
    """Record the program that combines up to _AT_ONCE values of each place, from the one numbered `first`.

    The values of a place stand in `tables`, those of the leaves, where its number stands in `keys`.
    """
    layout = layout_of(element, "an element")
    inputs = {"before": element, "first": Attrib1i, "keys": TableType(Attrib1u, 1)}
    tables = {f"given{k}": TableType(cls, 1) for k, (_, _, cls) in enumerate(leaves(layout, ""))}

    def fold(before: Any, first: Any, keys: Any, **tables: Any) -> Any:
        place = Attrib1u(grid_index(1))
        begin, end = first_not_below(keys, place) + first, first_not_below(keys, place + 1)
        SH_DISCARD(begin >= end)
        with SH_IF(first == 0):
            store(before, build_values(layout, (table[begin] for table in tables.values())))
            begin += 1
        with SH_FOR(0, _AT_ONCE) as k:
            SH_BREAK(begin + k >= end)
            value = build_values(layout, (table[begin + k] for table in tables.values()))
            store(before, combine(before, value))
        return before

    return annotated(fold, **inputs, **tables, out=element)
