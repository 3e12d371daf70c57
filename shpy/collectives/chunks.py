"""sh.reduce and sh.scan over Dask arrays: a block of 2**k elements is a subtree of the tree, so the bits are the same.

Stage: run. The elements are put into such blocks whatever the chunks are, and each worker reduces a block. The results
are reduced in the same way until one is left. A scan continues in each block from the prefix before it. Nothing runs
until Dask computes the result.
"""

from __future__ import annotations

import functools
import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.collectives.arguments import element_of
from shpy.collectives.trees import check_combination
from shpy.errors import ShpyTypeError
from shpy.ir.constants import dtypes_at, is_int
from shpy.lang.recording.location import here
from shpy.programs import Program
from shpy.streams.elements import Shape, shape_before_data
from shpy.streams.stream import Stream

_FEWEST, _MOST = 1 << 12, 1 << 20
"""The least and the largest size of a block. The result does not depend on it."""

Reduce = Callable[..., Any]


def flattened(array: Any, axes: int) -> Any:
    """Return a Dask array with its first axes as one. Empty chunks go: Dask's reshape does not take them."""
    shape = array.shape
    kept = [
        (n,) if 0 in shape else tuple(c for c in chunks if c) for n, chunks in zip(shape, array.chunks, strict=True)
    ]
    return array.rechunk(tuple(kept)).reshape((math.prod(shape[:axes]), *shape[axes:]))


def reduce_chunks(reduce: Reduce, program: Program, array: Any, axis: int | None) -> Any:
    """Return the Dask array of the reduced elements; `reduce` reduces the stream of a block."""
    cls, shape, tail = _checked(program, array, "reduce")
    if not math.prod(shape):
        raise ShpyTypeError("sh.reduce of no elements has no result", loc=here(), cure="an array with elements")
    if axis is None:
        array, axis = flattened(array, len(shape)), 0
    elif not is_int(axis) or not -len(shape) <= axis < len(shape):
        cure = f"axis={' or axis='.join(map(str, range(len(shape))))}" if shape else "axis=None, all elements"
        raise ShpyTypeError(
            f"axis={axis!r} of an array of {len(shape)} axes of elements is not an axis", loc=here(), cure=cure
        )
    axis %= array.ndim - tail
    dtype, size, packed = dtypes_at("f32")[cls.base], _size(array, axis), pickle.dumps((program, cls))
    while array.shape[axis] > 1 or array.dtype != dtype:
        array = _level(reduce, packed, dtype, _in_blocks(array, axis, size, tail), axis)
    return array.squeeze(axis)


def scan_chunks(reduce: Reduce, scan: Callable[..., Any], program: Program, array: Any, exclusive: bool) -> Any:
    """Return the Dask array of all prefixes. `scan` scans a block from the prefix before it to the one that ends it."""
    import dask.array as da

    cls, shape, tail = _checked(program, array, "scan")
    dtype = dtypes_at("f32")[cls.base]
    if not math.prod(shape):
        return array.astype(dtype)
    flat = flattened(array, len(shape))
    size, packed = _size(flat, 0), pickle.dumps((program, cls))
    blocks = _in_blocks(flat, 0, size, tail)
    labels = tuple(range(flat.ndim))
    totals = _level(reduce, packed, dtype, blocks, 0)
    options = {"dtype": dtype, "meta": totals._meta, "scan": scan, "packed": packed}
    ends = da.blockwise(_scanned, labels, totals.rechunk(-1), labels, exclusive=False, **options).rechunk({0: 1})
    before = da.concatenate((ends[:1], ends[:-1]))
    prefixes = da.blockwise(
        _scanned, labels, blocks, labels, before, labels, ends, labels, da.arange(len(ends), chunks=1), (0,),
        align_arrays=False, adjust_chunks={0: blocks.chunks[0]}, exclusive=exclusive,
        size=size, **options,
    )  # fmt: skip
    return prefixes.reshape(array.shape)


def _scanned(
    block: NDArray[Any],
    before: Any = None,
    last: Any = None,
    place: Any = 0,
    *,
    scan: Callable[..., Any],
    packed: bytes,
    exclusive: bool,
    size: int | None = None,
) -> NDArray[Any]:
    """Scan a block. The first block has no prefix before it; a shorter last block does not end a node of the tree."""
    program, cls = _unpacked(packed)
    around = [
        None if a is None else Stream(a, cls, "numpy")
        for a in (before if np.any(place) else None, last if len(block) == size else None)
    ]
    prefixes: NDArray[Any] = scan(program, Stream(block, cls, "numpy"), exclusive, *around)
    return prefixes


def _checked(program: Any, array: Any, name: str) -> tuple[Any, Shape, int]:
    """Return the type and the shape of the elements and the number of axes of components.

    Raises ShpyTypeError if the program does not fit the array, and for structs, which are several arrays.
    """
    message = f"sh.{name} over a Dask array takes a program of two scalars or vectors"
    cls = element_of(program, message, "add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f, with @sh.program before it")
    shape = shape_before_data("the array", cls, array, dtypes_at("f32")[cls.base])
    tail = array.ndim - len(shape)
    check_combination(program, Stream(np.zeros((1, cls.size)[: 1 + tail], array.dtype), cls, "numpy"), name)
    return cls, shape, tail


def _size(array: Any, axis: int) -> int:
    longest: int = max(array.chunks[axis])
    return min(max(1 << max(longest.bit_length() - 1, 0), _FEWEST), _MOST)


def _in_blocks(array: Any, axis: int, size: int, tail: int) -> Any:
    return array.rechunk({axis: size} | ({-1: -1} if tail else {}))


def _level(reduce: Reduce, packed: bytes, dtype: Any, blocks: Any, axis: int) -> Any:
    """Return one element for each block along an axis."""
    import dask.array as da

    labels = tuple(range(blocks.ndim))
    meta = np.empty((0,) * blocks.ndim, dtype)
    return da.blockwise(
        _block, labels, blocks, labels, dtype=dtype, meta=meta,
        adjust_chunks={axis: (1,) * blocks.numblocks[axis]}, reduce=reduce, packed=packed, axis=axis,
    )  # fmt: skip


def _block(block: NDArray[Any], reduce: Reduce, packed: bytes, axis: int) -> NDArray[Any]:
    """Reduce a block along an axis, which keeps an extent of one."""
    program, cls = _unpacked(packed)
    return np.expand_dims(np.asarray(reduce(program, Stream(block, cls), axis=axis)), axis)


@functools.lru_cache(maxsize=64)
def _unpacked(packed: bytes) -> tuple[Program, Any]:
    """Unpickle a program and the type of an element. A worker keeps them, so that all blocks use the same program."""
    program, cls = pickle.loads(packed)
    return program, cls
