"""The distinct elements of a stream, and its greatest ones: both follow from the stable order of sh.sort.

Stage: run.

    names, counts = sh.unique(cells)
    best, index = sh.top_k(scores, 10)
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from shpy.collectives.arguments import check_stream, indices_at, shaped
from shpy.collectives.leaves import Leaves, element_class, is_mapped, over_leaf, run_over
from shpy.collectives.programs import annotated, mapped
from shpy.collectives.sorting import keys_of
from shpy.collectives.trees import memories_of
from shpy.errors import ShpyTypeError
from shpy.ieee import in_ieee_arithmetic
from shpy.ir.constants import is_int
from shpy.ir.types import Base
from shpy.lang.data.tables import TableType
from shpy.lang.recording.location import here
from shpy.lang.values.builtins import cond, grid_index, isnan, max as larger
from shpy.lang.values.types import Attrib1b, Attrib1i
from shpy.programs import Program
from shpy.streams.stream import Stream


class Unique(NamedTuple):
    """The result of `sh.unique`: the distinct elements, (n,), and how often each occurs, (n,) ints."""

    elements: Stream
    counts: Stream


class TopK(NamedTuple):
    """The result of `sh.top_k`: the elements, (k,), and the index of each in the stream, (k,) ints."""

    elements: Stream
    indices: Stream


@in_ieee_arithmetic
def unique(stream: Stream) -> Unique:
    """Return the distinct elements in ascending order, and how often each occurs.

    Elements are equal as `sh.sort` has it: -0 and +0 are, and every NaN is equal to every other one and stands last.
    Of equal elements the first in the stream is returned, in C order. Both results have the shape (n,) for n distinct
    elements, and the call waits for the device to know n. Raises ShpyTypeError for elements of several components.
    """
    elements = check_stream(stream, "unique")
    (keys, *others) = [entry.memory for entry in elements.leaf_entries()]
    if others or keys.type.size != 1:
        raise ShpyTypeError(
            f"{elements!r} has elements of several components, which have no order",
            loc=here(),
            cure="sh.unique(number(stream)), where a program gives one number for an element",
        )
    place, leaves = elements.place, Leaves(elements.place)
    if not elements.size:
        return Unique(shaped(elements, [keys], (0,)).copy(), Stream.empty(0, Attrib1i, *elements.place))
    ordered = leaves.take(keys, leaves.order(keys, descending=False))
    element = element_class(ordered)
    marks = run_over(
        place, _starting(element, is_mapped(place, element)), elements.size, data=over_leaf(place, ordered)
    )
    index = leaves.select(marks.leaf_entries()[0].memory)
    total = np.array([elements.size], np.int32)
    counts = run_over(place, _extents(), index.count, start=over_leaf(place, index), total=total)
    return Unique(shaped(elements, [leaves.take(ordered, index)], (index.count,)), counts)


@in_ieee_arithmetic
def top_k(stream: Stream, k: int, key: Program | None = None) -> TopK:
    """Return the first k elements of `sh.sort(stream, key, descending=True)`, and the index of each in C order.

    Equal elements keep the order that they had, and a NaN is greater than every number. Raises ShpyTypeError as
    `sh.sort` does, and for a k that is no int from 0 to the number of elements.
    """
    elements = check_stream(stream, "top_k")
    if not is_int(k) or not 0 <= k <= elements.size:
        raise ShpyTypeError(f"top_k of {elements!r} with k={k!r}", loc=here(), cure=f"an int from 0 to {elements.size}")
    place, leaves = elements.place, Leaves(elements.place)
    order = leaves.order(keys_of(elements, key, "top_k"), descending=True)
    index = leaves.take(order, indices_at(place, np.arange(k, dtype=np.int32), "index")[0])
    memories = leaves.take_each(memories_of(elements), index)
    return TopK(shaped(elements, memories, (int(k),)), over_leaf(place, index))


@cache
def _starting(element: Any, by_bits: bool) -> Program:
    """Record the program that marks each element of a sorted table that differs from its predecessor."""

    def starts(data: Any) -> Any:
        i = grid_index(1)
        now, before = data[i], data[larger(i - 1, 0)]
        if by_bits:
            differs = mapped(now) != mapped(before)
        elif element.base in (Base.I, Base.U, Base.B):
            differs = now != before
        else:
            differs = (now != before) & ~(isnan(now) & isnan(before))
        return (i == 0) | differs

    return annotated(starts, data=TableType(element, 1), out=Attrib1b)


@cache
def _extents() -> Program:
    """Record the program that gives the number of elements from each start to the next one, or to the end."""

    def extent(start: Any, total: Any) -> Any:
        i = grid_index(1)
        return cond(i + 1 < start.shape[0], start[i + 1], total) - start[i]

    return annotated(extent, start=TableType(Attrib1i, 1), total=Attrib1i, out=Attrib1i)
