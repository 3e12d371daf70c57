"""Constants of the IR: exact, keyed by bits.

Stage: represent. A float constant is kept as the bits of a binary64 whatever its type, so that a literal 0.1 keeps
its meaning until the working precision is chosen. 0.0 and -0.0 differ; every NaN is the same one.

>>> encode(vec(Base.F), [0.5])
(4602678819172646912,)
>>> decode(vec(Base.F), encode(vec(Base.F), [0.5]))
(0.5,)
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from shpy.ir.types import Base, Type, vec

__all__ = ["DTYPES", "Base", "decode", "dtypes_at", "encode", "from_array", "is_int", "to_array", "vec"]

DTYPES: dict[Base, Any] = {
    Base.F: np.float32,
    Base.D: np.float64,
    Base.H: np.float16,
    Base.I: np.int32,
    Base.U: np.uint32,
    Base.B: np.bool_,
}

_WORKING: dict[str, Any] = {"f16": np.float16, "f32": np.float32, "f64": np.float64}
_NAN_BITS = 0x7FF8000000000000


@cache
def dtypes_at(precision: str) -> Mapping[Base, Any]:
    """Return the dtype of each base at a working precision."""
    return {**DTYPES, Base.F: _WORKING[precision]}


def is_int(value: object) -> TypeGuard[int | np.integer[Any]]:
    """Return whether a value of the host is an int of Python or numpy; a bool is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def float_to_bits(value: float) -> int:
    """Return the bits of a binary64; one pattern for every NaN."""
    if value != value:
        return _NAN_BITS
    return int.from_bytes(struct.pack("<d", value), "little")


def bits_to_float(bits: int) -> float:
    """Return the binary64 with these bits."""
    value: float = struct.unpack("<d", bits.to_bytes(8, "little"))[0]
    return value


def encode(type: Type, components: Iterable[float | int | bool]) -> tuple[int, ...]:
    """Return the `attr` of a `const` of `type` with these components."""
    if type.is_float:
        return tuple(float_to_bits(float(c)) for c in components)
    return tuple(int(c) for c in components)


def decode(type: Type, attr: tuple[int, ...]) -> tuple[Any, ...]:
    """Return the components of a `const`: floats, ints or bools of Python."""
    if type.is_float:
        return tuple(bits_to_float(c) for c in attr)
    if type.is_bool:
        return tuple(bool(c) for c in attr)
    return tuple(attr)


def to_array(type: Type, attr: tuple[int, ...]) -> NDArray[Any]:
    """Return the constant as an array of shape () or (size,), rounded to its type's precision."""
    with np.errstate(over="ignore", under="ignore"):
        array = np.array(decode(type, attr), dtype=np.float64 if type.is_float else DTYPES[type.base])
        array = array.astype(DTYPES[type.base])
    return array if type.size > 1 else array.reshape(())


def from_array(type: Type, array: NDArray[Any]) -> tuple[int, ...]:
    """Return the `attr` of the constant that `array`, of shape () or (size,), holds."""
    return encode(type, np.atleast_1d(array).tolist())
