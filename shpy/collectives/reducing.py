"""sh.reduce, and the reductions of streams: sums, means, extremes and their indices, logic.

Stage: run.

    sh.reduce(longest, words)        # a program(a, b) -> a over all elements
    x.sum(method="exact"), x.argmax(axis=0)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shpy.backend.base import overlap
from shpy.collectives.chunks import reduce_chunks
from shpy.collectives.exact import exact_sums, sums_of_blocks
from shpy.collectives.programs import (
    BLOCK,
    WORDS,
    Reduction,
    accumulating,
    conversion,
    counts,
    extremes,
    logic,
    places,
    quotient,
    sums,
    wide_sums,
)
from shpy.collectives.trees import combination, fold, fold_to_host, memories_of, own_tree, retyped
from shpy.errors import ShpyTypeError
from shpy.ieee import in_ieee_arithmetic
from shpy.ir.constants import dtypes_at, is_int
from shpy.ir.types import FLOATS, Base
from shpy.lang.data.tables import Table
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Leaf, is_lazy, layout_of
from shpy.lang.values.types import Attrib1f
from shpy.lang.values.value import CLASSES
from shpy.programs import Program
from shpy.streams.stream import Place, Stream

_METHODS = ("pairwise", "compensated", "exact")


@in_ieee_arithmetic
def reduce(program: Program, stream: Any, axis: int | None = None) -> Any:
    """Combine all elements of a Stream, in C order, or those along an axis, with a program(a, b) -> a.

    The order is that of a balanced binary tree of neighbours: level after level, out[i] = program(in[2 i],
    in[2 i + 1]), and an odd last element passes unchanged, until one is left. So `a` always stands before `b`, and the
    program need not be commutative, nor associative: the same bits come out on every backend and device in strict mode.
    Elements may be scalars, vectors, matrices or structs.

    Without an axis, the call waits for the device, and returns a numpy scalar, an array of the element's shape, or a
    named tuple of these for a struct. Along an axis it returns a Stream of the shape without that axis. Of a Dask array
    of scalars or vectors it returns a Dask array, for any chunks with the bits of one Stream.
    Raises ShpyTypeError for no elements along the axis, and for programs that do not combine two elements into one.
    """
    if is_lazy(stream):
        return reduce_chunks(reduce, program, stream, axis)
    program, element = combination(program, stream, "reduce")
    rows = _rows(stream, axis, element)
    if not rows.shape[len(rows.shape) // 2]:
        raise _empty("sh.reduce", "an element that changes nothing, before the others")
    return _result(_folded(rows, axis, program), stream, axis, stream.type)


def _sum(stream: Stream, axis: int | None, method: str, *, key: str) -> Any:
    if method not in _METHODS:
        cure = " or ".join(f'method="{m}"' for m in _METHODS)
        raise ShpyTypeError(f"method={method!r} of a sum", loc=here(), cure=cure)
    size, base = _element(stream, "sum")
    if method == "exact" and base in FLOATS:
        return _exact(stream, axis, size)
    kind = method if base in FLOATS else "pairwise"
    if stream.leaf_entries()[0].memory.dtype == np.float16:
        wide = _widened(stream, size)
        return _narrowed(_reduced(wide, axis, wide_sums(size, kind), _float(size), 0, key), stream, axis)
    return _reduced(stream, axis, sums(size, base, kind), _same_kind(stream, base), 0, key)


def _widened(stream: Stream, size: int) -> Stream:
    """Return a stream of binary16 as one of type h, whose kernels compute in binary32."""
    if _element(stream, "sum")[1] is Base.F and stream.size:
        stream = _finished(conversion(size, Base.F, Base.H), stream)
    return _half(stream, size, stream.place._replace(precision="f32"))


def _half(stream: Stream, size: int, place: Place) -> Stream:
    """Return a stream of type h at a place of another precision, over the same memory."""
    memories = [leaf.memory for leaf in stream.leaf_entries()]
    return Stream.over(CLASSES["Attrib", size, Base.H], stream.shape, place, memories)


def _float(size: int) -> Any:
    return CLASSES["Attrib", size, Base.F]


def _narrowed(results: Any, stream: Stream, axis: int | None) -> Any:
    """Return results in binary32, of a stream of binary16, rounded to binary16."""
    if axis is None:
        with np.errstate(over="ignore"):
            return results.astype(np.float16)
    size, base = _element(stream, "sum")
    halves = _half(_finished(conversion(size, Base.F, Base.H), results), size, stream.place)
    return halves if base is Base.H else _finished(conversion(size, Base.H, Base.F), halves)


def _mean(stream: Stream, axis: int | None, *, key: str) -> Any:
    size, base = _element(stream, "mean")
    if base not in FLOATS:
        raise ShpyTypeError(
            f"the mean of {stream!r} is no number of its type",
            loc=here(),
            cure="np.mean(stream), on the host; or a stream of floats",
        )
    rows = _rows(stream, axis)
    count = rows.shape[len(rows.shape) // 2]
    if not count:
        return _filled(stream, axis, stream.type, math.nan)
    if rows.leaf_entries()[0].memory.dtype == np.float16:
        return _narrowed(_wide_mean(stream, axis, size, count), stream, axis)
    total = _folded(rows, axis, sums(size, base, "pairwise").combine)
    if not _holds(total.leaf_entries()[0].memory.dtype, count):
        return _result(_divided_on_host(total, count), stream, axis, stream.type)
    return _result(_finished(quotient(size, base), total, float(count)), stream, axis, stream.type)


def _wide_mean(stream: Stream, axis: int | None, size: int, count: int) -> Any:
    """Return the mean of binary16 in binary32."""
    kind, rows = wide_sums(size, "pairwise"), _rows(_widened(stream, size), axis)
    total = _folded(rows, axis, kind.combine, kind.value_type, kind.lift)
    if not _holds(np.dtype(np.float32), count):
        return _result(_divided_on_host(total, count), stream, axis, total.type)
    return _result(_finished(quotient(size, Base.F), total, float(count)), stream, axis, total.type)


def _holds(dtype: np.dtype[Any], count: int) -> bool:
    """Return whether a dtype of floats holds the number of elements: one of 16 bits ends at 65,504."""
    with np.errstate(over="ignore"):
        return float(dtype.type(count)) == count


def _divided_on_host(total: Stream, count: int) -> Stream:
    """Return the sums divided by a number that their dtype does not hold: quotients of 64 bits, rounded to it."""
    sums = total.numpy()
    with np.errstate(all="ignore"):
        return Stream((sums.astype(np.float64) / count).astype(sums.dtype), total.type, *total.place)


def _exact(stream: Stream, axis: int | None, size: int) -> Any:
    """Return the exact sum. The host completes it, since Python has integers of any size."""
    rows = _rows(stream, axis)
    shape = (1, *rows.shape, 1) if axis is None else rows.shape
    before, _, after = shape
    memory = stream.leaf_entries()[0].memory
    if size == 1 and memory.dtype == np.float32 and rows.size and not stream.place.space.on_host:
        words = _sums_on_device(rows).reshape(before, -1, after, WORDS + 1)
        exact = sums_of_blocks(np.moveaxis(words, 1, 2).reshape(before * after, -1, WORDS + 1))
    else:
        array = memory.read().reshape(*shape, size)
        exact = exact_sums(np.moveaxis(array, 1, -1).reshape(before * after * size, shape[1]))
    kept = (before * after, size) if size > 1 else (before * after,)
    result = Stream(exact.reshape(kept), stream.type, *stream.place)
    return _result(result, stream, axis, stream.type)


def _sums_on_device(rows: Stream) -> NDArray[Any]:
    """Return the words of the exact sums of blocks along the middle axis."""
    axis = len(rows.shape) // 2
    shape = (*rows.shape[:axis], -(-rows.shape[axis] // BLOCK), *rows.shape[axis + 1 :])
    data = Table(retyped(rows, Attrib1f, rows.shape))
    words = accumulating(len(rows.shape)).compile_for(rows)(data, shape=shape)
    return np.concatenate([leaf.memory.read() for leaf in words.leaf_entries()], axis=-1)


def _extreme(stream: Stream, axis: int | None, *, key: str) -> Any:
    size, base = _element(stream, key)
    least = key == "min"
    kind = logic(size, least) if base is Base.B else extremes(size, base, least, _by_bits(stream, base))
    return _reduced(stream, axis, kind, stream.type, None, key)


def _place(stream: Stream, axis: int | None, *, key: str) -> Any:
    size, base = _element(stream, key)
    kind = places(size, base, key == "argmin", _by_bits(stream, base))
    return _reduced(stream, axis, kind, CLASSES["Attrib", size, Base.I], None, key)


def _logic(stream: Stream, axis: int | None, *, key: str) -> Any:
    size, base = _element(stream, key)
    kind = logic(size, key == "all", _by_bits(stream, base))
    return _reduced(stream, axis, kind, CLASSES["Attrib", size, Base.B], key == "all", key)


def _count(stream: Stream, axis: int | None, *, key: str) -> Any:
    size, base = _element(stream, "count")
    return _reduced(stream, axis, counts(size, _by_bits(stream, base)), CLASSES["Attrib", size, Base.I], 0, key)


def _by_bits(stream: Stream, base: Base) -> bool:
    """Return whether elements are compared by their bits, since the device takes denormals of 32 bits for zeros."""
    return base is Base.F and stream.precision == "f32" and stream.place.space.flushes


METHODS: Final[dict[str, Callable[..., Any]]] = {
    "sum": _sum,
    "mean": _mean,
    "min": _extreme,
    "max": _extreme,
    "argmin": _place,
    "argmax": _place,
    "any": _logic,
    "all": _logic,
    "count": _count,
}
"""The reductions that streams have as methods (`streams/methods`)."""


def _element(stream: Stream, name: str) -> tuple[int, Base]:
    """Return the size and the base of an element that is a scalar or a vector."""
    layout = layout_of(stream.type, "an element")
    if not isinstance(layout, Leaf):
        raise ShpyTypeError(
            f"{name} takes scalars and vectors, and {stream!r} has others",
            loc=here(),
            cure="sh.reduce(program, stream), with a program of two elements",
        )
    return layout.cls.size, layout.cls.base


def _same_kind(stream: Stream, base: Base) -> Any:
    return CLASSES["Attrib", _element(stream, "sum")[0], Base.I] if base is Base.B else stream.type


def _rows(stream: Stream, axis: Any, element: Any = None) -> Stream:
    """Return the stream as (n,), or as (a, n, b) with the elements along the axis in the middle."""
    type_ = stream.type if element is None else element
    if axis is None:
        return retyped(stream, type_, (stream.size,))
    rank = len(stream.shape)
    if not is_int(axis) or not -rank <= axis < rank:
        raise ShpyTypeError(
            f"axis={axis!r} of {stream!r}, which has {rank} axes",
            loc=here(),
            cure=f"axis={' or axis='.join(map(str, range(rank)))}" if rank else "axis=None, all elements",
        )
    k = int(axis) % rank
    return retyped(stream, type_, (math.prod(stream.shape[:k]), stream.shape[k], math.prod(stream.shape[k + 1 :])))


def _left(stream: Stream, axis: int | None) -> tuple[int, ...]:
    """Return the shape of the result of a reduction along the axis."""
    if axis is None:
        return ()
    k = axis % len(stream.shape)
    return stream.shape[:k] + stream.shape[k + 1 :]


def _empty(name: str, cure: str) -> ShpyTypeError:
    return ShpyTypeError(f"{name} of no elements has no result", loc=here(), cure=cure)


def _reduced(stream: Stream, axis: int | None, kind: Reduction, value_type: Any, empty: Any, key: str) -> Any:
    """Run a reduction; without elements return `empty`, or raise ShpyTypeError if that is None.

    What a device has prepared for all elements is kept with the stream under its `key`, the name of the method.
    """
    if axis is None and kind.finish is None and stream.size and not stream.place.space.on_host:
        own = own_tree(stream.place, kind.combine, stream.type, kind.value_type, kind.lift)
        if own is not None:
            elements, leaf = memories_of(stream), kind.leaf or 0
            reduced = own.reducing(elements)
            stream._reductions[key] = elements, lambda: reduced()[leaf][0]
            if memories_of(stream) != elements:  # another thread has replaced them
                stream._reductions.clear()
            return reduced()[leaf][0]
    rows = _rows(stream, axis)
    if not rows.shape[len(rows.shape) // 2]:
        if empty is None:
            raise _empty(key, "a stream with elements")
        return _filled(stream, axis, value_type, empty)
    if not rows.size:  # another axis has no elements
        return _filled(stream, axis, value_type, 0)
    results = _folded(rows, axis, kind.combine, kind.value_type, kind.lift)
    if kind.leaf is not None:
        results = Stream.over(value_type, results.shape, results.place, [results.leaf_entries()[kind.leaf].memory])
    if kind.finish is not None:
        results = _finished(kind.finish, results)
    return _result(results, stream, axis, value_type)


def _folded(rows: Stream, axis: int | None, *how: Any) -> Stream:
    """Fold along an axis. For a single result (`axis` None) the host does the last steps, since that is faster."""
    return fold_to_host(rows, *how) if axis is None else fold(rows, *how)


def _finished(program: Program, results: Stream, *others: Any) -> Stream:
    """Run the finishing program over the results."""
    finished: Stream = program.compile_for(results)(results, *others)
    return finished


def _filled(stream: Stream, axis: int | None, value_type: Any, value: Any) -> Any:
    shape = _left(stream, axis) + ((value_type.size,) if value_type.size > 1 else ())
    array = np.full(shape, value, dtypes_at(stream.precision)[value_type.base])
    return array[()] if axis is None else Stream(array, value_type, *stream.place)


def _result(results: Stream, stream: Stream, axis: int | None, value_type: Any) -> Any:
    """Return the host's result for all elements, or a stream along an axis that shares no memory with the input."""
    result = retyped(results, value_type, _left(stream, axis))
    if axis is None:
        return result[()]
    pairs = itertools.product(result.leaf_entries(), stream.leaf_entries())
    return result.copy() if any(overlap(output.memory, source.memory) for output, source in pairs) else result
