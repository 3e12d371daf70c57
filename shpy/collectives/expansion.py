"""Expansion: each element of a stream as often as a count says.

Stage: run.

    rays = sh.expand(surfaces, counts)      # counts[i] copies of surfaces[i], one after the other
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final, NamedTuple

from shpy.collectives.arguments import check_stream, indices_at, shaped
from shpy.collectives.leaves import Leaves
from shpy.collectives.programs import annotated
from shpy.collectives.scanning import scan
from shpy.collectives.trees import memories_of
from shpy.errors import ShpyTypeError
from shpy.ieee import in_ieee_arithmetic
from shpy.lang.data.tables import Table, TableType
from shpy.lang.programs.control import SH_ELSE, SH_IF, SH_WHILE
from shpy.lang.recording.location import here
from shpy.lang.values.builtins import cond, grid_index, max as larger
from shpy.lang.values.types import Attrib1i
from shpy.programs import Program
from shpy.streams.stream import Stream

_MOST: Final = 2**31 - 1


class Expansion(NamedTuple):
    """The result of `sh.expand`: the elements, (n,), and the index of the element that each is a copy of, (n,) ints."""

    elements: Any
    indices: Any


@in_ieee_arithmetic
def expand(stream: Stream, counts: Any) -> Expansion:
    """Return element i of a stream counts[i] times, in the order of the elements, and the index of each: np.repeat.

    `counts`: an int for each element, a Stream of Attrib1i or Attrib1u or an array; a negative one counts as 0.
    Elements of several axes are taken in C order. Both results have the shape (n,) for n, the sum of the counts, and
    the call waits for the device to know n; the elements stay there. Raises ShpyTypeError for counts of another type,
    shape or device, and for a sum of 2**31 - 1 or more.
    """
    elements = check_stream(stream, "expand")
    memory, shape = indices_at(elements.place, counts, "counts")
    if shape != elements.shape:
        cure = "an int for each element"
        raise ShpyTypeError(f"counts has the shape {shape}, and the stream {elements.shape}", loc=here(), cure=cure)
    leaves = Leaves(elements.place)
    ends, total = _ends(elements, memory)
    index = Stream.empty((0,), Attrib1i, *elements.place)
    if total:
        index = _owners().compile_for(ends)(Table(ends), shape=(total,))
    source = index.leaf_entries()[0].memory
    memories = leaves.take_each(memories_of(elements), source)
    return Expansion(shaped(elements, memories, (total,)), index)


def _ends(elements: Stream, memory: Any) -> tuple[Stream, int]:
    """Return where the copies of each element end, and the number of all."""
    numbers = Stream.over(Attrib1i, (elements.size,), elements.place, [memory])
    if not elements.size:
        return numbers, 0
    ends = scan(_joined(), _kept().compile_for(numbers)(numbers))
    total = int(ends[-1])
    if total == _MOST:
        raise ShpyTypeError("the counts of sh.expand add up to 2**31 - 1 or more", loc=here(), cure="several streams")
    return ends, total


@lru_cache(maxsize=1)
def _kept() -> Program:
    """Record the program that counts a negative number as 0."""

    def kept(n: Any) -> Any:
        return larger(n, 0)

    return annotated(kept, n=Attrib1i, out=Attrib1i)


@lru_cache(maxsize=1)
def _joined() -> Program:
    """Record the sum of two counts that ends at the largest int; it is associative, as counts are not negative."""

    def joined(a: Any, b: Any) -> Any:
        total = a + b
        return cond(total < 0, _MOST, total)

    return annotated(joined, a=Attrib1i, b=Attrib1i, out=Attrib1i)


@lru_cache(maxsize=1)
def _owners() -> Program:
    """Record the program that finds the element of a copy: the first whose copies end behind it, by halves."""

    def owner(ends: Any) -> Any:
        place = grid_index(1)
        low, high = Attrib1i(0), Attrib1i(ends.shape[0] - 1)
        with SH_WHILE(lambda: low < high):
            middle = low + ((high - low) >> 1)
            with SH_IF(ends[middle] > place):
                high[:] = middle
            with SH_ELSE():
                low[:] = middle + 1
        return low

    return annotated(owner, ends=TableType(Attrib1i, 1), out=Attrib1i)
