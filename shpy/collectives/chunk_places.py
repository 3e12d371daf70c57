"""sh.gather, sh.compact and sh.scatter over Dask arrays, which move elements, with the same bits as over one stream.

Stage: run. Values keep their order, so the values for one place arrive in the same order as in one stream.
Nothing runs until the result is computed by Dask.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.collectives.chunk_sorting import place_type, scalar_of
from shpy.collectives.chunks import flattened
from shpy.collectives.trees import check_combination
from shpy.errors import ShpyTypeError
from shpy.ir.constants import dtypes_at
from shpy.ir.types import FLOATS, Base
from shpy.lang.data.hostdata import as_array
from shpy.lang.data.tables import element_class
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Leaf, is_lazy, is_struct
from shpy.lang.values.value import CLASSES
from shpy.programs import Program
from shpy.streams.elements import Shape, given_shape, shape_before_data
from shpy.streams.stream import Stream

_BLOCKS, _LARGE = 64, 1 << 20
"""A result has at most _BLOCKS blocks, unless they are as large as the chunks of the values, or as _LARGE."""
Piece = tuple[NDArray[np.int64], NDArray[Any]]
"""Values and their target places in a block of the result: (places, values)."""


def gather_chunks(table: Any, index: Any, type_: Any) -> Any:
    """Return the Dask array of the element of `table` at each index, of the shape of `index`; Dask moves the elements.

    `type_` is that of an element; None stands for numbers.
    """
    import dask.array as da

    for value in (table, index):
        if isinstance(value, Stream):
            raise ShpyTypeError(
                f"{value!r} lies on a device of this process, and sh.gather of a Dask array runs on others",
                loc=here(),
                cure="stream.numpy(), or a Dask array of it",
            )
    if is_struct(type_):
        raise ShpyTypeError(
            f"sh.gather of a Dask array reads numbers and vectors, not the struct {type_.__name__}",
            loc=here(),
            cure="sh.gather(array, index, sh.Point3f), say, for the array of each field",
        )
    whole, places = (
        value if is_lazy(value) else da.from_array(as_array(value, what))
        for value, what in ((table, "the table"), (index, "index"))
    )
    cls = CLASSES["Attrib", 1, _base_of(whole.dtype, "gather", None)] if type_ is None else element_class(type_)
    shape = shape_before_data("the table", cls, whole, dtypes_at("f32")[cls.base])
    if places.dtype.kind not in "iu" and places.size:
        raise ShpyTypeError(f"index takes ints, not {places.dtype}", loc=here(), cure="index.astype(np.int64)")
    index_shape = shape_before_data("index", scalar_of(np.dtype(np.int32), "gather"), places, np.int32)
    if not math.prod(shape):
        raise ShpyTypeError("gather from an array without elements", loc=here(), cure="an array of one element or more")
    meta = np.empty((0,) * (1 + (cls.size > 1)), dtypes_at("f32")[cls.base])
    flat = flattened(whole, len(shape)).rechunk({1: -1} if cls.size > 1 else {})
    flat = flat.map_blocks(_converted, dtype=meta.dtype, meta=meta, packed=pickle.dumps(cls))
    if not places.size:
        return da.zeros((*index_shape, *flat.shape[1:]), meta.dtype)
    at = flattened(places, len(index_shape)).map_blocks(_nearest, dtype=np.int64, last=len(flat) - 1)
    return flat[at].reshape((*index_shape, *flat.shape[1:]))


def compact_chunks(array: Any, mask: Any) -> tuple[Any, Any]:
    """Return the Dask arrays of the elements for which the mask holds, and of their indices.

    Their chunks have unknown sizes until the mask is computed.
    """
    import dask.array as da

    array, mask, cls, shape = _beside(array, mask, "mask", "b", "compact")
    flat = flattened(array, len(shape)).rechunk({1: -1} if array.ndim > len(shape) else {})
    meta = np.empty((0,) * flat.ndim, dtypes_at("f32")[cls.base])
    flat = flat.map_blocks(_converted, dtype=meta.dtype, meta=meta, packed=pickle.dumps(cls))
    marks = flattened(mask, mask.ndim).rechunk({0: flat.chunks[0]})
    indices = da.arange(mask.size, chunks=(flat.chunks[0],), dtype=place_type(mask.size))
    return flat[marks], indices[marks]


def scatter_chunks(
    scatter: Callable[..., Any], values: Any, index: Any, shape: Any, combine: Program | None, out: Any
) -> Any:
    """Return the Dask array of `shape` with each value at its place; `scatter` makes one block of the result."""
    import dask
    import dask.array as da

    if out is not None or shape is None:
        raise ShpyTypeError(
            "scatter of a Dask array makes a new one of a shape", loc=here(), cure="sh.scatter(values, index, shape)"
        )
    values, index, cls, inner = _beside(values, index, "index", "iu", "scatter", combine)
    tail, target_shape, dtype = values.shape[len(inner) :], given_shape(shape), dtypes_at("f32")[cls.base]
    if combine is not None:
        check_combination(combine, Stream(np.zeros((1, *tail), dtype), cls, "numpy"), "scatter")
    flat = flattened(values, len(inner)).rechunk({1: -1} if tail else {})
    places = flattened(index, index.ndim).rechunk({0: flat.chunks[0]})
    length = math.prod(target_shape)
    size = max(*flat.chunks[0], min(-(-length // _BLOCKS), _LARGE), 1)
    if not length:
        return da.zeros((*target_shape, *tail), dtype)
    bounds = [*range(0, length, size), length]
    split = dask.delayed(_split, pure=True, nout=len(bounds) - 1)
    pieces = [
        split(block, where, bounds)
        for block, where in zip(flat.to_delayed().ravel(), places.to_delayed().ravel(), strict=True)
    ]
    put, packed = dask.delayed(_put, pure=True), pickle.dumps((cls, combine))
    blocks = [
        da.from_delayed(
            put([piece[k] for piece in pieces], past - first, scatter, packed), shape=(past - first, *tail), dtype=dtype
        )
        for k, (first, past) in enumerate(pairwise(bounds))
    ]
    return da.concatenate(blocks).reshape((*target_shape, *tail))


def _beside(
    array: Any, other: Any, what: str, kinds: str, name: str, combine: Any = None
) -> tuple[Any, Any, Any, Shape]:
    """Return an array and `other`, its mask or index, as Dask arrays, with the type of an element and the shape.

    `kinds` are the kinds of numpy's dtypes that `other` may have. Raises ShpyTypeError for others, and for shapes
    that do not fit.
    """
    import dask.array as da

    pairs = ((array, "the array"), (other, what))
    array, other = (whole if is_lazy(whole) else da.from_array(as_array(whole, label)) for whole, label in pairs)
    if other.dtype.kind not in kinds:
        kind = "bools" if kinds == "b" else "ints"
        raise ShpyTypeError(f"{what} takes {kind}, not {other.dtype}", loc=here(), cure=f"{what} as {kind}")
    base = _base_of(array.dtype, name, combine)
    for part, label in ((array, "the array"), (other, what)):
        scalar = scalar_of(part.dtype, name)
        shape_before_data(label, scalar, part, dtypes_at("f32")[scalar.base])
    if other.shape not in (array.shape, array.shape[:-1]):
        raise ShpyTypeError(
            f"{what} has the shape {other.shape}, and the array {array.shape}",
            loc=here(),
            cure=f"an array ({what} for each element), or of elements with components on one axis more",
        )
    size = 1 if other.shape == array.shape else array.shape[-1]
    cls = CLASSES.get(("Attrib", size, base))
    if cls is None or (size == 1 and other.shape != array.shape):
        raise ShpyTypeError(
            f"sh.{name} over a Dask array takes scalars and vectors, not {size} components",
            loc=here(),
            cure="components on the last axis, 2 to 4",
        )
    return array, other, cls, other.shape


def _base_of(dtype: np.dtype[Any], name: str, combine: Any) -> Base:
    """Return the base of elements of a dtype; floats are those that `combine` takes, as in `sh.reduce`."""
    base: Base = scalar_of(dtype, name).base
    first = next(iter(combine.recorded.inputs.values()), None) if isinstance(combine, Program) else None
    input_base: Base = first.cls.base if isinstance(first, Leaf) else base
    return input_base if {base, input_base} <= FLOATS else base


def _converted(block: NDArray[Any], packed: bytes) -> NDArray[Any]:
    """Return the elements of a block as a stream holds them; ShpyTypeError for numbers that it does not hold."""
    elements: NDArray[Any] = Stream(block, pickle.loads(packed), "numpy").numpy()
    return elements


def _nearest(index: NDArray[Any], last: int) -> NDArray[np.int64]:
    """Return the indices, those out of range as the first or the last element."""
    inside: NDArray[Any] = np.clip(index, 0, min(last, np.iinfo(index.dtype).max))
    return inside.astype(np.int64)


def _split(values: NDArray[Any], index: NDArray[Any], bounds: list[int]) -> tuple[Piece, ...]:
    """Return the values of a block, in order, split by the blocks of the result that they go to."""
    home = np.searchsorted(bounds, index, side="right") - 1
    positions = [np.flatnonzero(home == k) for k in range(len(bounds) - 1)]
    return tuple((index[at].astype(np.int64) - first, values[at]) for at, first in zip(positions, bounds, strict=False))


def _put(pieces: list[Piece], length: int, scatter: Callable[..., Any], packed: bytes) -> NDArray[Any]:
    """Return a block of the result, with the values of all pieces at their places."""
    cls, combine = pickle.loads(packed)
    places, values = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    place = "numpy" if combine is None else None  # the default backend may have no float64
    block: NDArray[Any] = scatter(Stream(values, cls, place), places, (length,), combine).numpy()
    return block
