"""What every target must give, to the bit: the table's meaning, or for a transcendental what strict mode makes of it.

exact("sin")(x)        # sin_strict, operation by operation, on arrays
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from shpy.backends.base import Array
from shpy.ir.constants import DTYPES, to_array
from shpy.ir.meaning import convert
from shpy.ir.nodes import Function, Let, Store, Value
from shpy.ir.ops import OPS, TRANSCENDENTALS
from shpy.ir.types import Base, vec
from shpy.passes.library import definition

FAR = 2.0**20
"""Sine, cosine and tangent promise nothing past it."""

TRIGONOMETRIC = ("sin", "cos", "tan")


def exact(name: str) -> Callable[..., Array]:
    """The function on arrays of one shape: componentwise where it is a transcendental."""
    meaning = OPS[name].meaning
    assert meaning is not None
    return functools.partial(_strict, name) if name in TRANSCENDENTALS else meaning


def _strict(name: str, *arrays: Array) -> Array:
    given = np.broadcast_arrays(*arrays)
    base = next(b for b, t in DTYPES.items() if np.dtype(t) == given[0].dtype)
    if base is Base.H:
        return _strict(name, *(a.astype(np.float32) for a in given)).astype(np.float16)
    return apply(definition(name, (vec(base),) * len(given)), *given)


def apply(function: Function, *arrays: Array) -> Array:
    """A pure function of scalars, applied to each element of arrays of one shape."""
    known: dict[int, Any] = {}
    for port, array in zip(function.inputs, arrays, strict=True):
        assert isinstance(port, Value)
        known[port.id] = np.array(array, DTYPES[port.type.base])
    with np.errstate(all="ignore"):
        for s in function.body:
            if isinstance(s, Store):
                return np.asarray(known[s.value])
            assert isinstance(s, Let)
            known[s.value.id] = _computed(s, [known[a] for a in s.args])
    raise AssertionError("a pure function stores its result")


def _computed(let: Let, args: list[Array]) -> Array:
    if let.op == "const":
        assert isinstance(let.attr, tuple)
        return to_array(let.value.type, let.attr)
    if let.op == "convert":
        return convert(args[0], DTYPES[let.value.type.base])
    meaning = OPS[let.op].meaning
    assert meaning is not None
    return np.asarray(meaning(*args))


def near(name: str, array: Array) -> Array:
    """The array without what is too far for a trigonometric function."""
    return array[(np.abs(array.astype(np.float64)) <= FAR) | ~np.isfinite(array)] if name in TRIGONOMETRIC else array
