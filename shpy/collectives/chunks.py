"""sh.reduce over Dask arrays: a block of a power of two elements is a subtree of the tree, so the bits are the same.

Stage: run. The elements are put into such blocks whatever the chunks are, and workers reduce one block each. Their
results are elements again, until one is left. Nothing runs before Dask is asked for the result.
"""

from __future__ import annotations

import functools
import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.collectives.trees import check_combination
from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Leaf
from shpy.program import Program
from shpy.streams.elements import InputLeaf, dtypes_at, element_shape
from shpy.streams.stream import Stream

_FEWEST, _MOST = 1 << 12, 1 << 20
"""The least and the largest size of a block, of which the result does not depend."""

Reduce = Callable[..., Any]


def reduce_chunks(reduce: Reduce, program: Program, array: Any, axis: int | None) -> Any:
    """Return the Dask array of the reduced elements, which `reduce` gives for the stream of a block."""
    import dask.array as da

    cls = _element(program)
    shape = element_shape("the array", cls, array.shape)
    tail = array.ndim - len(shape)
    InputLeaf("the array", cls, np.empty((0,) * len(shape) + array.shape[len(shape) :], array.dtype), np.float32)
    check_combination(program, Stream(np.zeros((1, cls.size)[: 1 + tail]), cls, "numpy"), "reduce")
    if not math.prod(shape):
        raise ShpyTypeError("sh.reduce of no elements has no result", loc=here(), cure="an array with elements")
    if axis is None:
        array, axis = array.reshape((math.prod(shape), *array.shape[len(shape) :])), 0
    elif not isinstance(axis, int) or isinstance(axis, bool) or not -len(shape) <= axis < len(shape):
        cure = f"axis={' or axis='.join(map(str, range(len(shape))))}"
        raise ShpyTypeError(f"axis={axis!r} of an array of {len(shape)} axes of elements", loc=here(), cure=cure)
    axis %= array.ndim - tail
    packed, labels = pickle.dumps(program), tuple(range(array.ndim))
    meta = np.empty((0,) * array.ndim, dtypes_at("f32")[cls.base])
    longest = max(array.chunks[axis])
    size = min(max(1 << max(longest.bit_length() - 1, 0), _FEWEST), _MOST)
    while array.shape[axis] > 1 or array.dtype != meta.dtype:
        blocks = array.rechunk({axis: size} | ({-1: -1} if tail else {}))
        ones = {axis: (1,) * blocks.numblocks[axis]}
        array = da.blockwise(
            _block, labels, blocks, labels, dtype=meta.dtype, meta=meta, adjust_chunks=ones,
            reduce=reduce, packed=packed, axis=axis,
        )  # fmt: skip
    return array.squeeze(axis)


def _element(program: Any) -> Any:
    """Return the type of an element; ShpyTypeError for structs, which are several arrays."""
    types = list(program.recorded.inputs.values()) if isinstance(program, Program) else []
    if types and isinstance(types[0], Leaf):
        return types[0].cls
    raise ShpyTypeError(
        f"sh.reduce over a Dask array takes a program of two scalars or vectors, not {program!r}",
        loc=here(),
        cure="add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f, with @sh.program before it",
    )


def _block(block: NDArray[Any], reduce: Reduce, packed: bytes, axis: int) -> NDArray[Any]:
    """Reduce a block along an axis, which stays with one element."""
    program = _program(packed)
    stream = Stream(block, _element(program))
    return np.expand_dims(np.asarray(reduce(program, stream, axis=axis)), axis)


@functools.lru_cache(maxsize=64)
def _program(packed: bytes) -> Program:
    program: Program = pickle.loads(packed)
    return program
