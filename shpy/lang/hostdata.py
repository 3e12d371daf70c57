"""Host data on its way in: what arrays, lists and numbers are accepted for a base.

Stage: record and run. float64 goes to f, integers to f or to i and u when in range, bools only to b.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir.constants import DTYPES
from shpy.ir.types import FLOATS, Base
from shpy.lang.location import here

_SPOKEN = {
    Base.F: "floats",
    Base.D: "floats",
    Base.H: "floats",
    Base.I: "ints",
    Base.U: "unsigned ints",
    Base.B: "bools",
}


def as_base(data: Any, base: Base, what: str) -> NDArray[Any]:
    """`data` as an array for `base`: floats keep the width they have, ints and bools get theirs.

    Raises ShpyTypeError naming `what` for complex numbers, objects, floats for ints, bools for numbers, ragged lists,
    and integers out of range.
    """
    try:
        array = np.asarray(data)
    except (ValueError, TypeError) as error:
        raise ShpyTypeError(
            f"{what} is not an array: {error}", loc=here(), cure="np.asarray(rows), all of one length"
        ) from error
    if isinstance(data, np.ma.MaskedArray) and np.ma.is_masked(data):
        raise ShpyTypeError(
            f"{what} is a masked array, and a kernel runs over every element",
            loc=here(),
            cure=f"{what}.filled(0), and the mask as an input of its own",
        )
    kind = array.dtype.kind
    if array.size == 0 and kind == "f" and not isinstance(data, np.ndarray):
        return np.zeros(array.shape, dtype=np.float32 if base in FLOATS else DTYPES[base])
    wanted = "fiu" if base in FLOATS else "b" if base is Base.B else "iu"
    if kind not in wanted:
        cure = {"f": "np.rint(x).astype(np.int32)", "b": "x.astype(np.float32)"}.get(kind, "an array of numbers")
        raise ShpyTypeError(f"{what} takes {_SPOKEN[base]}, not {array.dtype}", loc=here(), cure=cure)
    if base in FLOATS:
        return array if kind == "f" and array.dtype.itemsize <= 8 else array.astype(np.float64)
    if base is not Base.B and array.size:
        limits = np.iinfo(DTYPES[base])
        low, high = array.min(), array.max()
        if low < limits.min or high > limits.max:
            bad = low if low < limits.min else high
            raise ShpyTypeError(
                f"{what} holds {bad}, out of the range of {_SPOKEN[base]} of 32 bits",
                loc=here(),
                cure="np.clip(x, low, high), or floats",
            )
    return array.astype(DTYPES[base])
