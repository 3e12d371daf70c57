"""Host data on its way in: the arrays, lists and numbers that each base accepts.

Stage: record and run. float64 goes to f, integers to f or to i and u when in range, bools only to b.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir.constants import DTYPES
from shpy.ir.types import FLOATS, Base
from shpy.lang.recording.location import here
from shpy.lang.values.structure import is_lazy

_SPOKEN = {
    Base.F: "floats",
    Base.D: "floats",
    Base.H: "floats",
    Base.I: "ints",
    Base.U: "unsigned ints",
    Base.B: "bools",
}


def as_base(data: Any, base: Base, what: str) -> NDArray[Any]:
    """Return `data` as an array for `base`: floats keep the width they have, ints and bools get theirs.

    The array may share the memory of `data`. Raises ShpyTypeError naming `what` for complex numbers, objects, floats
    for ints, bools for numbers, ragged lists, and integers out of range.
    """
    if is_lazy(data):
        raise ShpyTypeError(
            f"{what} is a Dask array, whose chunks may not fit into the memory of one process",
            loc=here(),
            cure="sh.map_blocks(kernel, x), or x.compute() where it fits",
        )
    array = as_array(data, what)
    refuse_masked(data, what)
    kind = array.dtype.kind
    if array.size == 0 and kind == "f" and not isinstance(data, np.ndarray):
        return np.zeros(array.shape, dtype=np.float32 if base in FLOATS else DTYPES[base])
    if kind == "O" and not hasattr(data, "dtype") and array.size and all(type(n) is int for n in array.flat):
        kind = "i"  # numpy makes objects of Python's ints beyond 64 bits
        if base in FLOATS:
            return _floats_of_long_ints(array, what)
    kinds = "fiu" if base in FLOATS else "b" if base is Base.B else "iu"
    if kind not in kinds:
        raise ShpyTypeError(f"{what} takes {_SPOKEN[base]}, not {array.dtype}", loc=here(), cure=_cure(kind, base))
    if base in FLOATS:
        return array if kind == "f" else _floats_of_ints(array)
    if base is not Base.B and array.size and array.dtype != DTYPES[base]:
        limits = np.iinfo(DTYPES[base])
        low, high = array.min(), array.max()
        if low < limits.min or high > limits.max:
            bad = low if low < limits.min else high
            raise ShpyTypeError(
                f"{what} holds {bad}, out of the range of {_SPOKEN[base]} of 32 bits",
                loc=here(),
                cure="np.clip(x, low, high), or floats",
            )
    return array.astype(DTYPES[base], copy=False)


def as_array(data: Any, what: str) -> NDArray[Any]:
    """Return `data` as an array of any dtype; ShpyTypeError naming `what` for ragged lists.

    Objects with `__dlpack__` alone are taken without a copy; ShpyTypeError where it does not lie in the host's memory.
    """
    if hasattr(data, "__dlpack__") and not hasattr(data, "__array__"):
        try:
            return np.from_dlpack(data)
        except (BufferError, RuntimeError, TypeError, ValueError) as error:
            raise ShpyTypeError(
                f"{what} is not an array that numpy can read: {error}",
                loc=here(),
                cure="an array in the memory of the host",
            ) from error
    try:
        return np.asarray(data)
    except (ValueError, TypeError) as error:
        raise ShpyTypeError(
            f"{what} is not an array: {error}", loc=here(), cure="np.asarray(rows), all of one length"
        ) from error


def _floats_of_ints(array: NDArray[Any]) -> NDArray[Any]:
    """Return ints as floats that hold each of them, where the machine has such: they are rounded once, later."""
    floats = array.astype(np.float64)
    beyond = array.dtype.itemsize == 8 and np.any(np.abs(floats) > 2.0**53)
    return array.astype(np.longdouble) if beyond else floats


def _floats_of_long_ints(array: NDArray[Any], what: str) -> NDArray[Any]:
    """Return ints of any length, in an array of objects, as float64; ShpyTypeError where float64 does not hold one."""
    try:
        return array.astype(np.float64)
    except OverflowError:
        raise ShpyTypeError(
            f"{what} holds an int out of the range of floats of 64 bits", loc=here(), cure="np.inf if infinity is meant"
        ) from None


def _cure(kind: str, base: Base) -> str:
    """Return how numbers of another kind become what `base` takes; each works for arrays, lists and numbers."""
    if kind not in "biuf":
        return "an array of bools" if base is Base.B else "an array of numbers"
    if base is Base.B:
        return "np.asarray(x) != 0"
    dtype = "float32" if base in FLOATS else np.dtype(DTYPES[base]).name
    return f"np.rint(x).astype(np.{dtype})" if kind == "f" else f"np.asarray(x, np.{dtype})"


def in_range(array: NDArray[Any], dtype: np.dtype[Any], what: str) -> NDArray[Any]:
    """Convert numbers to a dtype of floats, rounded; ShpyTypeError naming `what` for a number beyond all of them.

    The copy is skipped where the dtype is the array's own.
    """
    try:
        with np.errstate(all="ignore", over="raise"):
            return array.astype(dtype, copy=False)
    except FloatingPointError:
        with np.errstate(all="ignore"):
            converted = array.astype(dtype)
        lost = array[np.isinf(converted) & ~np.isinf(array)][0]
        spoken = lost if np.isfinite(float(lost)) else str(lost)  # a longdouble may be beyond Python's float
        raise ShpyTypeError(
            f"{what} holds {spoken}, out of the range of floats of {8 * dtype.itemsize} bits",
            loc=here(),
            cure="np.clip(x, low, high), np.inf if infinity is meant, or a wider precision",
        ) from None


def refuse_masked(data: Any, what: str) -> None:
    """Raise ShpyTypeError naming `what` for a masked array with a masked element."""
    # numpy imports np.ma when it is first named, which takes 12 ms: plain arrays and lists need not wait for it.
    extended = isinstance(data, np.ndarray) and type(data) is not np.ndarray
    if extended and isinstance(data, np.ma.MaskedArray) and np.ma.is_masked(data):
        raise ShpyTypeError(
            f"{what} is a masked array, and a kernel runs over every element",
            loc=here(),
            cure=f"{what if what.isidentifier() else 'array'}.filled(0), and the mask as an input of its own",
        )


def working(array: NDArray[Any], base: Base, dtype: np.dtype[Any], what: str) -> NDArray[Any]:
    """Convert floats to the dtype that a kernel has for a base; ShpyTypeError for a number that the base does not hold.

    The working float holds all numbers of 32 bits. A kernel at f16 rounds it as its results, large numbers to infinity.
    """
    if base is Base.F and dtype == np.float16:
        in_range(array, np.dtype(np.float32), what)
        with np.errstate(over="ignore", under="ignore"):
            return array.astype(np.float16)  # directly: a conversion through 32 bits would round twice
    return in_range(array, dtype, what)


def checked_bool(value: Any, what: str) -> bool:
    """Return an option that is a bool of Python or numpy; ShpyTypeError naming `what` for anything else."""
    if not isinstance(value, bool | np.bool_):
        raise ShpyTypeError(f"{what}={value!r} is neither True nor False", loc=here(), cure=f"{what}=True")
    return bool(value)
