"""Compaction: the elements of a stream for which a mask holds.

Stage: run.

    kept, index = sh.compact(particles, alive)
"""

from __future__ import annotations

from typing import Any, NamedTuple

from shpy.collectives.arguments import check_stream, mask_at, shaped
from shpy.collectives.chunk_places import compact_chunks
from shpy.collectives.leaves import Leaves
from shpy.collectives.trees import memories_of
from shpy.ieee import in_ieee_arithmetic
from shpy.lang.values.structure import is_lazy
from shpy.lang.values.types import Attrib1i
from shpy.streams.stream import Stream


class Compaction(NamedTuple):
    """The result of `sh.compact`: the elements, (n,), and the former index of each, (n,) ints."""

    elements: Any
    indices: Any


@in_ieee_arithmetic
def compact(stream: Any, mask: Any) -> Compaction:
    """Return the elements for which the mask holds, in their order, and the indices that they had.

    `mask`: bools of the stream's shape, a Stream or an array. Elements of several axes are taken in C order, and an
    index is a position in that order: `sh.gather` takes it. Both results have the shape (n,) for n elements, and the
    call waits for the device to know n. Of a Dask array of scalars or vectors, with a mask of bools in chunks or not,
    both are Dask arrays, whose chunks have unknown sizes until they are computed.
    Raises ShpyTypeError for a mask of another type, shape or device.
    """
    if is_lazy(stream):
        return Compaction(*compact_chunks(stream, mask))
    elements = check_stream(stream, "compact")
    place = elements.place
    marks = mask_at(place, mask, elements.shape)
    leaves = Leaves(place)
    index = leaves.select(marks)
    memories = leaves.take_each(memories_of(elements), index)
    return Compaction(shaped(elements, memories, (index.count,)), Stream.over(Attrib1i, (index.count,), place, [index]))
