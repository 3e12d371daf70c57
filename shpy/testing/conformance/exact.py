"""The exact result on every target: the table's meaning, or the formula of strict mode for a transcendental.

exact("sin")(x)        # sin_strict, operation by operation, on arrays
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from shpy.backend.base import Array
from shpy.ir.constants import DTYPES, to_array
from shpy.ir.meaning import convert
from shpy.ir.nodes import Function, If, Let, Region, Store, Value
from shpy.ir.ops import OPS, TRANSCENDENTALS
from shpy.ir.types import Base, vec
from shpy.passes.formulas.strict.halves import CORRECTED
from shpy.passes.library import PARTS, definition


def exact(name: str) -> Callable[..., Array]:
    """Return the function on arrays of one shape: componentwise where it is a transcendental."""
    return functools.partial(_strict, name) if name in TRANSCENDENTALS else OPS[name].meaning


def _strict(name: str, *arrays: Array) -> Array:
    operands = np.broadcast_arrays(*arrays)
    base = next(b for b, t in DTYPES.items() if np.dtype(t) == operands[0].dtype)
    if base is not Base.H:
        return apply(definition(name, (vec(base),) * len(operands)), *operands)
    if len(operands) == 1 or name in CORRECTED:
        return np.asarray(OPS[name].meaning(*operands))
    formula = definition(name, (vec("f"),) * len(operands), "portable")
    return apply(formula, *(a.astype(np.float32) for a in operands)).astype(np.float16)


def apply(function: Function, *arrays: Array) -> Array:
    """Return a pure function of scalars, applied to each element of arrays of one shape."""
    values: dict[int, Any] = {}
    slots: dict[int, Any] = {}
    for port, array in zip(function.inputs, arrays, strict=True):
        assert isinstance(port, Value)
        values[port.id] = np.array(array, DTYPES[port.type.base])
    with np.errstate(all="ignore"):
        _run(function.body, values, slots)
    return np.asarray(slots[function.outputs[0].id])


def _run(region: Region, values: dict[int, Any], slots: dict[int, Any]) -> None:
    for s in region:
        if isinstance(s, Store):
            slots[s.variable] = values[s.value]
        elif isinstance(s, If):
            if values[s.condition]:
                _run(s.then, values, slots)
        else:
            assert isinstance(s, Let)
            values[s.value.id] = (
                slots[int(str(s.attr))] if s.op == "load" else _computed(s, [values[a] for a in s.args])
            )


def _computed(let: Let, args: list[Array]) -> Array:
    if let.op == "const":
        assert isinstance(let.attr, tuple)
        return to_array(let.value.type, let.attr)
    if let.op == "convert":
        return convert(args[0], DTYPES[let.value.type.base])
    if let.op == "any_lane":
        return np.asarray(np.any(args[0]))
    if let.op == "construct":
        return np.stack(args)
    if let.op == "swizzle":
        assert isinstance(let.attr, tuple)
        return np.asarray(args[0][let.attr[0]])
    if let.op in PARTS:
        return apply(definition(let.op, (vec(let.value.type.base),)), *args)
    return np.asarray(OPS[let.op].meaning(*args))
