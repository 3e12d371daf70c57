"""Operations on single leaves, of which collective operations consist, by the device itself or by programs.

Stage: run. A device with its own implementation of an operation (`base.Collectives`) uses it. The programs here run on
any device. They read but never write by index, since fragment shaders cannot: they merge and search instead.

    index = Leaves(place).select(mask)
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from shpy.backend.base import Collectives, Memory, overlap
from shpy.collectives.programs import annotated, mapped
from shpy.ir.types import Base
from shpy.lang.data.tables import Table, TableType
from shpy.lang.programs.control import SH_BREAK, SH_ELSE, SH_FOR, SH_IF
from shpy.lang.values.builtins import clamp, cond, grid_index, isnan, max as largest, min as least
from shpy.lang.values.types import Attrib1f, Attrib1i, Attrib1u
from shpy.lang.values.value import CLASSES
from shpy.programs import Program
from shpy.streams.stream import Place, Stream

_TILE = 16
"""The number of elements that are counted together, at each level of a tree of counts."""
_BITS = 32
"""The limit of iterations of a binary search: more than an index has bits."""


class Leaves:
    """The operations at a place. Memories hold scalars unless stated otherwise; indices and counts are ints."""

    def __init__(self, place: Place, own: Collectives | None = None) -> None:
        self._place = place
        self._own = place.space.collectives if own is None else own

    def select(self, mask: Memory) -> Memory:
        """Return the indices of the elements that are true, in ascending order."""
        if not mask.count:
            return self._ints(0)
        if self._own.select is not None:
            return self._own.select(mask)  # type: ignore[no-any-return]
        levels = [self._stream(mask)]
        while len(levels) == 1 or len(levels[-1]) > 1:
            program = _counting(levels[-1].type)
            levels.append(self._run(program, -(-len(levels[-1]) // _TILE), level=levels[-1]))
        total = int(levels[-1].numpy()[0])
        if not total:
            return self._ints(0)
        # Each element of the result descends from the root of the tree of counts.
        rest = self._run(_numbering(), total)
        cell = Stream.empty(total, Attrib1i, *self._place)
        for level in reversed(levels[:-1]):
            cell, rest = self._run(_descending(level.type), total, cell=cell, rest=rest, level=level)
        return _memory(cell)

    def take(self, source: Memory, index: Memory) -> Memory:
        """Return the element of a scalar or vector leaf at each index; an index out of range reads the nearest one."""
        return self.take_each([source], index)[0]

    def take_each(self, sources: Sequence[Memory], index: Memory) -> list[Memory]:
        """Return the elements of several leaves of a stream at each index, as `take` does."""
        if not index.count:
            return [self._place.space.allocate(0, source.type, source.dtype) for source in sources]
        if self._own.take is not None:
            return self._own.take(sources, index)
        at = self._stream(index)
        programs = [_taking(element_class(source), element_class(index)) for source in sources]
        return [
            _memory(self._run(program, index.count, index=at, source=self._stream(source)))
            for program, source in zip(programs, sources, strict=True)
        ]

    def put(self, values: Memory, index: Memory, target: Memory) -> Memory:
        """Return memory, possibly the target, with each value at its index; the last of several values stays.

        Scalars and vectors; elements whose index is out of range are dropped, and other places keep their values.
        """
        if not (values.count and target.count):
            return target
        values, index = (_memory(self._stream(m).copy()) if overlap(m, target) else m for m in (values, index))
        if self._own.put is not None:
            self._own.put(values, index, target)
            return target
        keys, order = self._in_order(index, False)
        program = _putting(element_class(target), element_class(index))
        old, source = self._stream(target), self._stream(values)
        return _memory(self._run(program, target.count, old=old, keys=keys, order=order, given=source))

    def sort(self, keys: Memory, descending: bool) -> Memory:
        """Return the elements in order."""
        if keys.count and self._own.sort is not None:
            return self._own.sort(keys, descending)  # type: ignore[no-any-return]
        now, order = self._in_order(keys, descending)
        return _memory(now) if now.type.base is keys.type.base else self.take(keys, _memory(order))

    def order(self, keys: Memory, descending: bool, below: int | None = None) -> Memory:
        """Return the indices that sort the elements; int keys are clamped to [0, below) if `below` is given."""
        if not keys.count:
            return self._ints(0)
        if self._own.order is not None:
            return self._own.order(keys, descending, below)  # type: ignore[no-any-return]
        if below is not None:
            stream, last = self._stream(keys), np.array([below - 1], keys.dtype)
            keys = _memory(self._run(_clamping(stream.type), keys.count, key=stream, last=last))
        return _memory(self._in_order(keys, descending)[1])

    def tally(self, numbers: Memory, bins: int) -> Memory:
        """Count the occurrences of each number from 0 to bins - 1."""
        if not numbers.count:
            return _memory(Stream.empty(bins, Attrib1i, *self._place))
        if self._own.tally is not None:
            return self._own.tally(numbers, bins)  # type: ignore[no-any-return]
        keys, _ = self._in_order(numbers, False)
        return _memory(self._run(_tallying(keys.type), bins, keys=keys))

    def _in_order(self, keys: Memory, descending: bool) -> tuple[Stream, Stream]:
        """Return the sorted keys and their original indices, by merges of two sorted parts at a time.

        Each element of the result finds its source in the two parts by binary search. This takes log2(n) runs, and on
        llvmpipe a third of the time of a bitonic network, which takes log2(n)**2 / 2 runs.
        """
        now = self._stream(keys)
        if keys.count < 2:
            return now.copy(), Stream.empty(keys.count, Attrib1i, *self._place)
        if is_mapped(self._place, now.type):
            now = self._run(mapping(), keys.count, x=now)
        order = self._run(_numbering(), keys.count)
        program = _merging(now.type, descending)
        length = 1
        while length < keys.count:
            now, order = self._run(program, keys.count, length=np.array([length], np.int32), keys=now, order=order)
            length *= 2
        return now, order

    def _stream(self, memory: Memory) -> Stream:
        return over_leaf(self._place, memory)

    def _run(self, program: Program, count: int, **inputs: Any) -> Any:
        return run_over(self._place, program, count, **inputs)

    def _ints(self, count: int) -> Memory:
        return self._place.space.allocate(count, Attrib1i.type, np.dtype(np.int32))


def run_over(place: Place, program: Program, count: int, out: Any = None, **inputs: Any) -> Any:
    """Run a program over `count` elements at a place; a stream given for a Table is read as a Table.

    Returns the outputs; with `out`, into which they are written, the Result of the run.
    """
    kernel = program.compile_at(place)
    arguments = {n: Table(s) if isinstance(program.inputs[n], TableType) else s for n, s in inputs.items()}
    if out is not None:
        return kernel.run(**arguments, out=out, shape=(count,))
    if inputs:
        return kernel(**arguments, shape=(count,))
    (result,) = program.outputs.values()
    return kernel.run(out=Stream.fresh((count,), result, place)).outputs


def _memory(stream: Stream) -> Memory:
    return stream.leaf_entries()[0].memory


def over_leaf(place: Place, memory: Memory) -> Stream:
    """Return a stream (n,) over the memory of a leaf."""
    return Stream.over(element_class(memory), (memory.count,), place, [memory])


def element_class(memory: Memory) -> Any:
    """Return the class of a leaf's elements, of the kind Attrib."""
    return CLASSES["Attrib", memory.type.size, memory.type.base]


@cache
def _counting(element: Any) -> Program:
    """Record the program that counts the marks of a tile, or adds its counts."""

    def count(level: Any) -> Any:
        first, n = grid_index(1) * _TILE, level.shape[0]
        found = Attrib1i(0)
        for k in range(_TILE):
            found += cond(first + k < n, Attrib1i(level[first + k]), 0)
        return found

    return annotated(count, level=TableType(element, 1), out=Attrib1i)


@cache
def _numbering() -> Program:
    return annotated(lambda: grid_index(1), out=Attrib1i)


@cache
def _descending(element: Any) -> Program:
    """Record the program that goes from a cell to the child with the marked element number `rest`, counted from 0."""

    def descend(cell: Any, rest: Any, level: Any) -> Any:
        cell *= _TILE
        with SH_FOR(0, _TILE - 1):
            count = Attrib1i(level[cell])
            SH_BREAK(rest < count)
            rest -= count
            cell += 1
        return cell, rest

    return annotated(descend, cell=Attrib1i, rest=Attrib1i, level=TableType(element, 1), out=tuple[Attrib1i, Attrib1i])


@cache
def _taking(element: Any, index: Any) -> Program:
    def take(index: Any, source: Any) -> Any:
        return source[Attrib1i(least(index, Attrib1u(source.shape[0] - 1))) if unsigned else index]

    unsigned = index.base is Base.U
    return annotated(take, index=index, source=TableType(element, 1), out=element)


@cache
def _clamping(element: Any) -> Program:
    return annotated(lambda key, last: clamp(key, 0, last), key=element, last=element, out=element)


def is_mapped(place: Place, element: Any) -> bool:
    """Return whether keys of a class are compared as ints, since a device may flush denormals of 32 bits to 0."""
    return element.base is Base.F and place.precision == "f32"


@cache
def mapping() -> Program:
    """Record `mapped` as a program."""
    return annotated(mapped, x=Attrib1f, out=Attrib1u)


@cache
def _merging(element: Any, descending: bool) -> Program:
    def precedes(a: Any, b: Any) -> Any:
        """Return whether a must precede b, whatever their original order is."""
        if descending:
            a, b = b, a
        if element.base in (Base.I, Base.U):
            return a < b
        if element.base is Base.B:
            return ~a & b
        return (a < b) | (~isnan(a) & isnan(b))

    def merge(length: Any, keys: Any, order: Any) -> Any:
        k, n = grid_index(1), keys.shape[0]
        start = k - k % (2 * length)
        middle, end = least(start + length, n), least(start + 2 * length, n)
        before = k - start
        # Search the number of elements before this one that come from the left part.
        low, high = largest(before - (end - middle), 0), least(before, middle - start)
        with SH_FOR(0, _BITS):
            SH_BREAK(low >= high)
            half = (low + high) >> 1
            with SH_IF(precedes(keys[middle + before - 1 - half], keys[start + half])):
                high[:] = half
            with SH_ELSE():
                low[:] = half + 1
        left, right = start + low, middle + before - low
        from_right = (left >= middle) | ((right < end) & precedes(keys[right], keys[left]))
        at = cond(from_right, right, left)
        return keys[at], order[at]

    tables = {"keys": TableType(element, 1), "order": TableType(Attrib1i, 1)}
    return annotated(merge, length=Attrib1i, **tables, out=tuple[element, Attrib1i])


def first_not_below(keys: Any, bound: Any) -> Any:
    """Return the index of the first key of a sorted Table that is at least the bound, or the size of the Table."""
    low, high = Attrib1i(0), Attrib1i(keys.shape[0])
    with SH_FOR(0, _BITS):
        SH_BREAK(low >= high)
        half = (low + high) >> 1
        with SH_IF(keys[half] < bound):
            low[:] = half + 1
        with SH_ELSE():
            high[:] = half
    return low


@cache
def _putting(element: Any, index: Any) -> Program:
    def put(old: Any, keys: Any, order: Any, given: Any) -> Any:
        place = index(grid_index(1))
        last = first_not_below(keys, place + 1) - 1
        return cond((last >= 0) & (keys[last] == place), given[order[last]], old)

    tables = {"keys": TableType(index, 1), "order": TableType(Attrib1i, 1), "given": TableType(element, 1)}
    return annotated(put, old=element, **tables, out=element)


@cache
def _tallying(number: Any) -> Program:
    def tally(keys: Any) -> Any:
        bin = number(grid_index(1))
        return first_not_below(keys, bin + 1) - first_not_below(keys, bin)

    return annotated(tally, keys=TableType(number, 1), out=Attrib1i)
