"""sh.sort over Dask arrays: blocks are sorted, and a network of merges brings each element to its block.

Stage: run. A merge takes two blocks and gives the lesser and the greater half, so a worker holds two blocks at a time,
and the chunks of the result are known before anything runs. Elements are ordered by key and then by their first place,
so the order does not depend on the network. Source: Batcher, Sorting networks and their applications (1968).
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.collectives.leaves import mapping
from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Leaf
from shpy.lang.values.types import Attrib1b, Attrib1f, Attrib1i, Attrib1u
from shpy.program import Program
from shpy.streams.elements import dtypes_at, shape_before_data
from shpy.streams.stream import Stream

Part = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]
"""Keys as unsigned ints, first places, and elements of a block."""
_TYPES = {"f": Attrib1f, "i": Attrib1i, "u": Attrib1u, "b": Attrib1b}


def sort_chunks(keys_of: Callable[..., Any], array: Any, key: Program | None, descending: bool) -> Any:
    """Return the Dask array of the elements in order; `keys_of` gives the memory of the keys of a stream."""
    import dask
    import dask.array as da

    cls = _element(array, key)
    dtype = dtypes_at("f32")[cls.base]
    shape = shape_before_data("the array", cls, array, dtype)
    tail = array.shape[len(shape) :]
    keys_of(Stream(np.zeros((1, *tail), dtype), cls, "numpy"), key, "sort")
    flat = array.reshape((math.prod(shape), *tail))
    flat = flat.rechunk({0: max(1, *flat.chunks[0]), **({1: -1} if tail else {})})
    starts = np.cumsum((0, *flat.chunks[0])).tolist()
    packed = pickle.dumps((cls, key))
    parts = [
        dask.delayed(_sorted, pure=True)(block, start, keys_of, packed, descending)
        for block, start in zip(flat.to_delayed().ravel(), starts[:-1], strict=True)
    ]
    for low, high in network(len(parts)):
        parts[low], parts[high] = dask.delayed(_merged, pure=True, nout=2)(parts[low], parts[high])
    made = [
        da.from_delayed(part[2], shape=(n, *tail), dtype=dtype) for part, n in zip(parts, flat.chunks[0], strict=True)
    ]
    return da.concatenate(made)


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


def _element(array: Any, key: Any) -> Any:
    """Return the type of an element: that of the key's input, or one of the array's dtype."""
    if key is None:
        if array.dtype.kind not in _TYPES:
            raise ShpyTypeError(f"sh.sort takes numbers, not {array.dtype}", loc=here(), cure="an array of numbers")
        return _TYPES[array.dtype.kind]
    types = list(key.recorded.inputs.values()) if isinstance(key, Program) else []
    if len(types) == 1 and isinstance(types[0], Leaf):
        return types[0].cls
    raise ShpyTypeError(
        f"sh.sort over a Dask array takes a program of one scalar or vector as key, not {key!r}",
        loc=here(),
        cure="@sh.program of one sh.Attrib3f that gives one number",
    )


def _sorted(block: Any, start: int, keys_of: Callable[..., Any], packed: bytes, descending: bool) -> Part:
    cls, key = pickle.loads(packed)
    stream = Stream(block, cls)
    keys = _unsigned(np.asarray(keys_of(stream, key, "sort").read()).reshape(-1))
    keys = ~keys if descending else keys
    order = np.argsort(keys, kind="stable")
    return keys[order], order + start, stream.numpy()[order]


def _merged(low: Part, high: Part) -> tuple[Part, Part]:
    keys, places, elements = (np.concatenate(pair) for pair in zip(low, high, strict=True))
    order, n = np.lexsort((places, keys)), len(low[0])
    first, second = order[:n], order[n:]
    return (keys[first], places[first], elements[first]), (keys[second], places[second], elements[second])


def _unsigned(keys: NDArray[Any]) -> NDArray[np.uint32]:
    """Return unsigned ints in the order of sh.sort."""
    if keys.dtype.kind == "f":
        return np.asarray(mapping().compile("numpy")(keys))
    if keys.dtype.kind == "i":
        return keys.astype(np.int32).view(np.uint32) ^ np.uint32(1 << 31)
    return keys.astype(np.uint32)
