"""sh.scan: all prefixes of a stream, by an up-sweep and a down-sweep of the tree of sh.reduce.

Stage: run. The levels of the up-sweep are kept; the down-sweep computes the prefixes of a level from those of the level
above. Source: Brent and Kung, A regular layout for parallel adders, IEEE Trans. Comp. 31 (1982); Blelloch, Prefix
sums and their applications (1990).

    sh.scan(add, x)                      # running totals
    sh.scan(add, flags, exclusive=True)  # where each element goes in a compaction
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.backend.base import Tree
from shpy.collectives.chunks import scan_chunks
from shpy.collectives.programs import scanning, scanning_fours
from shpy.collectives.reducing import reduce
from shpy.collectives.trees import (
    arrays_of,
    combination,
    fold_parts,
    in_fours,
    memories_of,
    over_arrays,
    own_tree,
    retyped,
    run_level,
    run_pairs,
)
from shpy.ieee import in_ieee_arithmetic
from shpy.lang.data.hostdata import checked_bool
from shpy.lang.data.tables import Table
from shpy.lang.values.structure import is_lazy
from shpy.programs import Program
from shpy.streams.stream import Stream

Arrays = list[NDArray[Any]]


@in_ieee_arithmetic
def scan(program: Program, stream: Any, exclusive: bool = False) -> Any:
    """Return a Stream of all prefixes: element i combines the elements 0 to i, in C order, with a program(a, b) -> a.

    The order of evaluation is fixed. The elements 0 to i are cut into the largest blocks of a power of two elements
    that start at multiples of their size: one block for each bit of i + 1, the largest first. Each block is reduced by
    the tree of `sh.reduce`, and the blocks are combined from left to right: of 7 elements, the last prefix is
    p(p(B4, B2), B1) with B4 = p(p(x0, x1), p(x2, x3)), B2 = p(x4, x5) and B1 = x6. So the last prefix has the bits of
    `sh.reduce` if the number of elements is a power of two. The same bits come out on every backend in strict mode.

    With `exclusive`, element i combines the elements 0 to i - 1, and element 0 is zero in all of its components.
    The result has the shape of the stream, and is empty for an empty one. Of a Dask array of scalars or vectors it is a
    Dask array, for any chunks with the bits of one Stream. Raises ShpyTypeError for programs that do not
    combine two elements into one, and for an `exclusive` that is no bool.
    """
    prepared = stream._reductions.get("scan") if isinstance(stream, Stream) else None
    if prepared is not None and prepared[0][0] is program and prepared[0][1] is exclusive:
        return prepared[1]()
    exclusive = checked_bool(exclusive, "exclusive")
    if is_lazy(stream):
        return scan_chunks(reduce, _scan_block, program, stream, exclusive)
    key = program, exclusive
    program, element = combination(program, stream, "scan")
    if stream.size < 2:
        if not exclusive or not stream.size:
            return stream.copy()
        return Stream.empty(stream.shape, stream.type, *stream.place)
    own = own_tree(stream.place, program, element, element, None)
    if own is not None:
        return _prepared(own, stream, key)() if stream.size <= own.each(stream.size) else _by(own, stream, exclusive)
    flat = retyped(stream, element, (stream.size,))
    prefixes = (_on_host if stream.place.space.on_host else _on_device)(program, flat, exclusive)
    return retyped(prefixes, stream.type, stream.shape)


def _prepared(own: Tree, stream: Stream, key: tuple[Program, bool]) -> Callable[[], Stream]:
    """Prepare the scan of a stream that is one part; the stream keeps what its last scan has prepared.

    Microseconds of CPU for 10**4 numbers on one core with OpenCL, of which an empty launch takes 10: 33 for 42.
    """
    elements, type_, shape, place = memories_of(stream), stream.type, stream.shape, stream.place
    prefixes = own.scanning(elements, key[1])

    def run() -> Stream:
        return Stream.over(type_, shape, place, prefixes())

    stream._reductions["scan"] = key, run
    if memories_of(stream) != elements:  # another thread has replaced them
        stream._reductions.clear()
    return run


def _by(own: Tree, stream: Stream, exclusive: bool) -> Stream:
    """Scan by the device's own kernels; the prefixes at the ends of several parts are a scan of the parts' folds."""
    above = None
    if stream.size > own.each(stream.size):
        above = memories_of(_by(own, fold_parts(own, stream, stream.type), False))
    prefixes = Stream.fresh(stream.shape, stream.type, stream.place)
    own.scan(memories_of(stream), above, memories_of(prefixes), exclusive)
    return prefixes


def _on_device(program: Program, stream: Stream, exclusive: bool) -> Stream:
    """Scan on a device: four neighbours become one on the way up, and one prefix four on the way down."""
    levels = [stream]
    while levels[-1].size > 1:
        shape = (-(-levels[-1].size // 4),)
        levels.append(run_level(levels[-1], shape, program, stream.type, None, 4))
    above = levels.pop()
    while levels:
        above = _down_on_device(program, levels.pop(), above, exclusive and not levels)
    return above


def _down_on_device(program: Program, level: Stream, above: Stream, exclusive: bool) -> Stream:
    """Run a pass of the down-sweep; one element of the run computes four scalars if memory can be read as vectors."""
    prefixes: Stream
    fours = in_fours(level)
    if fours is None:
        down = scanning(program, level.type, exclusive).compile_for(level)
        prefixes = down(Table(level), Table(above), shape=level.shape)
        return prefixes
    down = scanning_fours(program, level.type, fours.type, exclusive).compile_for(level)
    prefixes = down(Table(level), Table(fours), Table(above), shape=(-(-level.size // 4),))
    leaf = prefixes.leaf_entries()[0]
    memory = level.place.space.view(leaf.memory, leaf.memory.type.scalar, level.size)
    assert memory is not None
    return Stream.over(level.type, level.shape, level.place, [memory])


def _scan_block(
    program: Program, stream: Stream, exclusive: bool, before: Stream | None, last: Stream | None
) -> NDArray[Any]:
    """Scan a block on the host as a part of a longer stream: see `_on_host`."""
    program, element = combination(program, stream, "scan")
    around = [None if s is None else arrays_of(retyped(s, element, (1,))) for s in (before, last)]
    prefixes = _on_host(program, retyped(stream, element, (stream.size,)), exclusive, *around)
    return np.asarray(retyped(prefixes, stream.type, stream.shape))


def _on_host(
    program: Program, stream: Stream, exclusive: bool, before: Arrays | None = None, last: Arrays | None = None
) -> Stream:
    """Scan on the host: two neighbours become one on the way up, and one prefix becomes two on the way down.

    A block of a longer stream continues from the prefix `before` it; `last` is the prefix at the end of a whole block.
    """
    levels = [arrays_of(stream)]
    while (n := levels[-1][0].shape[1]) > 1:
        whole = n // 2 * 2
        firsts, seconds = ([a[:, k:whole:2] for a in levels[-1]] for k in (0, 1))
        levels.append(run_pairs(program, firsts, seconds, stream.type, stream))
    top = levels.pop()
    above = last or (top if before is None else run_pairs(program, before, top, stream.type, stream))
    while levels:
        above = _down_on_host(program, levels.pop(), above, stream, before)
    if exclusive:
        firsts = [np.zeros_like(a[:, :1]) for a in above] if before is None else before
        above = [np.concatenate((first, a[:, :-1]), axis=1) for first, a in zip(firsts, above, strict=True)]
    return over_arrays(above, stream.type, stream)


def _down_on_host(program: Program, level: Arrays, above: Arrays, stream: Stream, before: Arrays | None) -> Arrays:
    n = level[0].shape[1]
    odd = run_pairs(program, [a[:, : (n - 1) // 2] for a in above], [a[:, 2::2] for a in level], stream.type, stream)
    prefixes = [np.empty_like(a) for a in level]
    starts = [a[:, :1] for a in level]
    if before is not None:
        starts = run_pairs(program, before, starts, stream.type, stream)
    for target, first, pair, rest in zip(prefixes, starts, above, odd, strict=True):
        target[:, 0] = first[:, 0]
        target[:, 1::2] = pair[:, : n // 2]
        target[:, 2::2] = rest
    return prefixes
