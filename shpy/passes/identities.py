"""Algebraic identities that hold bit for bit in IEEE arithmetic.

Stage: improve; the scalar rules of `fold`. Each identity holds for every value, including infinity, NaN and -0.0 (but
for the sign and payload of a NaN). So `x * 0.0`, `x + 0.0` and `x - x` stay as they are:

    x * 1, 1 * x, x / 1       -> x          -(-x), ~~x, abs(abs(x))   -> x, x, abs(x)
    x - 0.0, x + -0.0         -> x          min(x, x), cond(c, x, x)  -> x
    pow(x, 2) (f32)           -> x * x      ~(a == b)                 -> a != b
    f(i) * 2**m * 2**n        -> f(i) * 2**(m + n), for an int i
    i + 0, i * 0, i & 0, ...  -> i, 0, 0    ~(i < j) (ints)           -> i >= j
"""

from __future__ import annotations

import math
from typing import Protocol

from shpy.ir.constants import decode, encode
from shpy.ir.nodes import Attr, Let
from shpy.ir.ops import COMMUTATIVE
from shpy.ir.types import Base, Type


class Facts(Protocol):
    """The facts that a rule may use: how a value was made, its constant components, its type."""

    lets: dict[int, Let]
    types: dict[int, Type]
    fixed: bool

    def constant(self, value: int) -> tuple[int, ...] | None:
        """Return the components of a constant."""

    def make(self, op: str, *args: int, type: Type, attr: Attr = None) -> int:
        """Return a new value."""


Found = int | Let | None
"""The id of an equal value, an equivalent operation, or None."""

_INVERSE = {"eq": "ne", "ne": "eq"}
_INVERSE_INT = {"lt": "ge", "ge": "lt", "gt": "le", "le": "gt"}

_RIGHT_NEUTRAL: dict[str, tuple[float | None, int | None]] = {
    "add": (-0.0, 0),
    "sub": (0.0, 0),
    "mul": (1.0, 1),
    "div": (1.0, None),
    "floordiv": (None, 1),
    "or": (None, 0),
    "xor": (None, 0),
    "and": (None, -1),
    "shl": (None, 0),
    "shr": (None, 0),
    "pow": (1.0, None),
    "ldexp": (None, 0),
}
"""The neutral right operand of an operation, which leaves the left one unchanged: as a float, as an int."""

_ABSORBING: dict[str, int] = {"mul": 0, "and": 0, "or": -1}
"""The absorbing int or bool of an operation: if one operand is this, so is the result."""


def simplify(context: Facts, let: Let) -> Found:
    """Return a simpler equivalent of the operation, or None."""
    match let.op, let.args:
        case "neg" | "not" | "abs" | "half" | "convert", (x,):
            return _unary(context, let, x)
        case "min" | "max", (a, b) if a == b:
            return a
        case "and" | "or", (a, b) if a == b:
            return a
        case "cond", (c, a, b):
            return _cond(context, let, c, a, b)
        case "pow", (x, y) if context.fixed and _is(context, y, 2.0) and let.value.type.base is Base.F:
            return Let(let.value, "mul", (x, x))
        case "floormod", (_, b) if _is(context, b, 1):
            return Let(let.value, "const", (), (0,) * let.value.type.size)
        case op, (a, b) if op in _RIGHT_NEUTRAL:
            simpler = _neutral(context, let, a, b)
            return _scaled(context, let, a, b) if simpler is None and op == "mul" else simpler
    return None


def _unary(context: Facts, let: Let, x: int) -> Found:
    inner = context.lets.get(x)
    if inner is None:
        return None
    match let.op, inner.op:
        case ("neg", "neg") | ("not", "not"):
            return inner.args[0]
        case ("abs", "abs") | ("half", "half"):
            return x
        case "abs", "neg" if let.value.type.base is not Base.U:  # of uints -x is 2**32 - x
            return Let(let.value, "abs", inner.args)
        case "not", "eq" | "ne":
            return Let(let.value, _INVERSE[inner.op], inner.args)
        case "not", "lt" | "le" | "gt" | "ge" if context.types[inner.args[0]].is_int:
            return Let(let.value, _INVERSE_INT[inner.op], inner.args)
    return None


def _cond(context: Facts, let: Let, c: int, a: int, b: int) -> Found:
    if a == b:
        return a
    chosen = context.constant(c)
    if chosen is not None and len(set(chosen)) == 1:
        return a if chosen[0] else b
    if let.value.type.is_bool and _is(context, a, 1) and _is(context, b, 0):
        return c
    if let.value.type.is_bool and _is(context, a, 0) and _is(context, b, 1):
        return Let(let.value, "not", (c,))
    return None


def _neutral(context: Facts, let: Let, a: int, b: int) -> Found:
    op, type = let.op, let.value.type
    number = _RIGHT_NEUTRAL[op][context.types[b].is_float is False]
    if number is not None and _is(context, b, number):
        return a
    if number is not None and op in COMMUTATIVE and _is(context, a, number):
        return b
    if not type.is_float and op in _ABSORBING:
        for side in (a, b):
            if _is(context, side, _ABSORBING[op]):
                return side
    return None


def _scaled(context: Facts, let: Let, a: int, b: int) -> Found:
    """Return x * 2**(m + n) for x * 2**m * 2**n where x was an int: no product overflows, and none is denormal."""
    inner, n = context.lets.get(a), _exponent(context, b)
    if n is None or inner is None or inner.op != "mul" or not context.fixed or let.value.type.base is Base.H:
        return None
    x, m = context.lets.get(inner.args[0]), _exponent(context, inner.args[1])
    if m is None or x is None or x.op != "convert" or not context.types[x.args[0]].is_int:
        return None
    type = context.types[b]
    scale = context.make("const", type=type, attr=encode(type, [2.0 ** (m + n)] * type.size))
    return Let(let.value, "mul", (x.value.id, scale))


def _exponent(context: Facts, value: int) -> int | None:
    """Return n if a value is 2**n in every component, and n is from -32 to 32."""
    components, type = context.constant(value), context.types[value]
    if components is None or not type.is_float:
        return None
    fraction, n = math.frexp(decode(type, components)[0])
    return n - 1 if fraction == 0.5 and abs(n - 1) <= 32 and len(set(components)) == 1 else None


def _is(context: Facts, value: int, number: float) -> bool:
    """Return whether a value is this constant in every component; -1 stands for all bits."""
    components = context.constant(value)
    if components is None:
        return False
    type = context.types[value]
    if type.is_float:
        expected = encode(type.scalar, [number])[0]
    elif number == -1:
        expected = {Base.B: 1, Base.U: 0xFFFFFFFF, Base.I: -1}[type.base]
    else:
        expected = int(number)
    return all(c == expected for c in components)
