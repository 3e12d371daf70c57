"""Elements of streams on the host: their dtypes, their shapes, and the checks of a user's arrays.

Stage: run.

    InputLeaf("x", sh.Attrib3f, array, np.float32).shape      # (4,) for an array (4, 3)
"""

from __future__ import annotations

import math
import reprlib
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir.constants import is_int
from shpy.lang.data.hostdata import as_base, working
from shpy.lang.recording.location import here
from shpy.lang.values.coerce import sequence
from shpy.lang.values.value import Value, with_article

Shape = tuple[int, ...]


class InputLeaf:
    """One leaf of an input: its array (*shape, size), (*shape,) for a scalar, and the shape of its elements."""

    def __init__(self, name: str, cls: type[Value], data: Any, dtype: Any) -> None:
        self.name = name
        self.type = cls.type
        self.size = cls.size
        array = as_base(data, cls.base, name)
        self.shape = element_shape(name, cls, array.shape)
        self.array: NDArray[Any] = working(array, cls.base, np.dtype(dtype), name) if array.dtype.kind == "f" else array

    def flat(self, shape: Shape) -> NDArray[Any]:
        """Return the elements in C order: (n[, size]), or 1 for n where all are the same."""
        tail = (self.size,) if self.size > 1 else ()
        if math.prod(self.shape) == 1:
            return np.ascontiguousarray(self.array.reshape((1, *tail)))
        whole = np.broadcast_to(self.array, shape + tail)
        return np.ascontiguousarray(whole).reshape((-1, *tail))


def element_shape(name: str, cls: type[Value], shape: Shape) -> Shape:
    """Return the shape S of the elements of an array (*S, N); ShpyTypeError for another last axis."""
    if cls.size > 1 and (not shape or shape[-1] != cls.size):
        raise ShpyTypeError(
            f"{name} is {with_article(cls)} and takes an array (*S, {cls.size}), not {shape}",
            loc=here(),
            cure=_trailing(name, shape, cls.size, is_color=cls.kind == "Color"),
        )
    return shape[:-1] if cls.size > 1 else shape


def shape_before_data(name: str, cls: type[Value], array: Any, dtype: Any) -> Shape:
    """Return the shape of the elements of an array of Dask; ShpyTypeError as for its data, and for unknown extents."""
    shape = element_shape(name, cls, array.shape)
    InputLeaf(name, cls, np.empty((0, *array.shape[len(shape) :]), array.dtype), dtype)
    if any(math.isnan(n) for n in array.shape):
        cure = f"{name.removeprefix('the ')}.compute_chunk_sizes()"
        raise ShpyTypeError(f"{name} has chunks of unknown sizes", loc=here(), cure=cure)
    return shape


def _trailing(name: str, shape: Shape, size: int, *, is_color: bool) -> str:
    """Return the advice on giving an array a last axis of `size`, which never changes the order of its numbers."""
    name = name if " " not in name else "array"  # "a stream" is not an identifier
    if len(shape) == 2 and shape[0] == size and shape[1] > 4:
        return f"{name}.T"
    if is_color and len(shape) in (2, 3) and size == 3 and (shape[-1] < 3 if len(shape) == 3 else shape[-1] > 4):
        grey = name if len(shape) == 2 else f"{name}[..., 0]"
        return f"np.stack([{grey}] * 3, axis=-1), a picture of grey"
    if len(shape) > 1 and shape[-1] > size:
        dropped = " which drops the alpha channel" if (shape[-1], size) == (4, 3) else ""
        return f"{name}[..., :{size}]{',' * bool(dropped)}{dropped}"
    if len(shape) > 1 and shape[0] == size:
        return f"np.moveaxis({name}, 0, -1)"
    if len(shape) == 1 and shape[0] % size == 0:
        return f"np.asarray({name}).reshape(-1, {size})"
    return f"an array whose last axis has {size} components"


def completed(shape: Any, size: int) -> Any:
    """Return a shape of `size` elements with -1, if it is one extent of several, replaced; any other as it is."""
    extents = [shape] if is_int(shape) else list(sequence(shape) or ())
    others = [n for n in extents if n != -1]
    if len(others) != len(extents) - 1 or not all(is_int(n) and n > 0 for n in others) or size % math.prod(others):
        return shape
    return tuple(size // math.prod(others) if n == -1 else n for n in extents)


def given_shape(shape: Any) -> Shape:
    """Return the argument `shape`: an int, or ints in a tuple, a list or an array of one axis."""
    single = is_int(shape)
    extents = [shape] if single else sequence(shape)
    if extents is None or not all(is_int(n) for n in extents):
        raise ShpyTypeError(
            f"shape={_spoken(shape)} is neither an int nor a tuple of ints", loc=here(), cure="shape=(h, w)"
        )
    result = tuple(int(n) for n in extents)
    if any(n < 0 for n in result):
        raise ShpyTypeError(f"shape={_spoken(shape)} has a negative extent", loc=here(), cure="shape=(h, w)")
    if any(n > sys.maxsize for n in result):
        raise ShpyTypeError(f"shape={_spoken(shape)} is more than any memory holds", loc=here(), cure="shape=(h, w)")
    return result


def _spoken(value: Any) -> str:
    """Return a value in a message: its text, cut where it is long."""
    return reprlib.repr(value)
