"""sh.sort and sh.argsort over Dask arrays: blocks are sorted, and a network of merges moves each element to its block.

Stage: run. A merge takes two blocks and returns the lesser and the greater half, so a worker holds two blocks at a
time, and the chunks of the result are known before anything runs. Elements are ordered by key and then by original
index, so the order does not depend on the network. Source: Batcher, Sorting networks and their applications (1968).
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.collectives.arguments import element_of
from shpy.collectives.chunks import flattened
from shpy.errors import ShpyTypeError
from shpy.ir.constants import dtypes_at
from shpy.lang.recording.location import here
from shpy.lang.values.types import Attrib1b, Attrib1d, Attrib1f, Attrib1h, Attrib1i, Attrib1u
from shpy.programs import Program
from shpy.streams.elements import shape_before_data
from shpy.streams.stream import Stream

Part = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]
"""Keys as unsigned ints, original indices, and elements of a block; `argsort` leaves out the elements."""
Keys = Callable[[Stream], NDArray[Any]]
"""Returns the keys of a stream, (n,)."""
_TYPES = {"f2": Attrib1h, "f8": Attrib1d, "f": Attrib1f, "i": Attrib1i, "u": Attrib1u, "b": Attrib1b}
"""The types of scalars by numpy's dtypes, or by their kinds."""


def sort_chunks(keys_of: Keys, array: Any, key: Program | None, descending: bool) -> Any:
    """Return the Dask array of the sorted elements; `keys_of` returns the keys of a stream."""
    cls = _element(array, key, "sort")
    dtype = dtypes_at("f32")[cls.base]
    parts, tail = _ordered(keys_of, array, cls, key, descending, keeps=True)
    return _joined(((part[2], n) for part, n in parts), tail, dtype)


def argsort_chunks(keys_of: Keys, array: Any, key: Program | None, descending: bool) -> Any:
    """Return the Dask array of the original indices of the sorted elements."""
    parts, _ = _ordered(keys_of, array, _element(array, key, "argsort"), key, descending, keeps=False)
    return _joined(((part[1], n) for part, n in parts), (), np.dtype(np.int64)).astype(place_type(array.size))


def scalar_of(dtype: np.dtype[Any], name: str) -> Any:
    """Return the type of the scalars that hold the numbers of a dtype; ShpyTypeError if it has none."""
    scalar = _TYPES.get(dtype.str[1:]) or _TYPES.get(dtype.kind)
    if scalar is None:
        raise ShpyTypeError(f"sh.{name} takes numbers, not {dtype}", loc=here(), cure="an array of numbers")
    return scalar


def place_type(count: int) -> type[np.signedinteger[Any]]:
    """Return the dtype of indices of `count` elements: int32, as in streams, if it can hold all of them."""
    return np.int32 if count <= 1 << 31 else np.int64


def _joined(blocks: Iterable[tuple[Any, int]], tail: tuple[int, ...], dtype: np.dtype[Any]) -> Any:
    """Return the Dask array of blocks, each with its number of elements."""
    import dask.array as da

    return da.concatenate([da.from_delayed(block, shape=(n, *tail), dtype=dtype) for block, n in blocks])


def _ordered(
    keys_of: Keys, array: Any, cls: Any, key: Program | None, descending: bool, *, keeps: bool
) -> tuple[list[tuple[Any, int]], tuple[int, ...]]:
    """Return the sorted parts, each with its number of elements, and the extents of the components' axes.

    With `keeps` the parts hold the elements, too.
    """
    import dask

    dtype = dtypes_at("f32")[cls.base]
    shape = shape_before_data("the array", cls, array, dtype)
    tail = array.shape[len(shape) :]
    keys_of(Stream(np.zeros((1, *tail), dtype), cls, "numpy"))
    flat = flattened(array, len(shape))
    flat = flat.rechunk({0: max(1, *flat.chunks[0]), **({1: -1} if tail else {})})
    starts = np.cumsum((0, *flat.chunks[0])).tolist()
    place = "numpy" if key is None else None  # the default backend may have no float64
    packed = pickle.dumps((cls, keys_of, place))
    parts = [
        dask.delayed(_sorted, pure=True)(block, start, packed, descending, keeps)
        for block, start in zip(flat.to_delayed().ravel(), starts[:-1], strict=True)
    ]
    for low, high in network(len(parts)):
        parts[low], parts[high] = dask.delayed(_merged, pure=True, nout=2)(parts[low], parts[high])
    return list(zip(parts, flat.chunks[0], strict=True)), tail


def network(count: int) -> Iterator[tuple[int, int]]:
    """Yield the pairs (low, high) of Batcher's odd-even merge sort, in order."""
    p = 1
    while p < count:
        k = p
        while k >= 1:
            for j in range(k % p, count - k, 2 * k):
                for i in range(min(k, count - j - k)):
                    if (i + j) // (2 * p) == (i + j + k) // (2 * p):
                        yield i + j, i + j + k
            k //= 2
        p *= 2


def _element(array: Any, key: Any, name: str) -> Any:
    """Return the type of an element: the type of the key's input, or the scalar type that holds the array's numbers."""
    if key is None:
        return scalar_of(array.dtype, name)
    message = f"sh.{name} over a Dask array takes a program of one scalar or vector as key"
    return element_of(key, message, "@sh.program of one sh.Attrib3f that gives one number")


def _sorted(block: Any, start: int, packed: bytes, descending: bool, keeps: bool) -> Part:
    from shpy.backend.numpy.device.collective import words_in_order  # importing shpy loads no backend

    cls, keys_of, place = pickle.loads(packed)
    stream = Stream(block, cls, place)
    keys = words_in_order(keys_of(stream), descending)
    order = np.argsort(keys, kind="stable")
    return keys[order], order + start, stream.numpy()[order] if keeps else np.empty((len(order), 0))


def _merged(low: Part, high: Part) -> tuple[Part, Part]:
    keys, places, elements = (np.concatenate(pair) for pair in zip(low, high, strict=True))
    order, n = np.lexsort((places, keys)), len(low[0])
    first, second = order[:n], order[n:]
    return (keys[first], places[first], elements[first]), (keys[second], places[second], elements[second])
