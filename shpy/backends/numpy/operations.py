"""How each operation is written for numpy.

Stage: emit. Part of the numpy printer. Takes an operation, its operands as expressions and their types; gives an
expression. Where numpy's own function means exactly what the op table says it stands for the operation; where it does
not, the function of `shpy.ir.meaning` does. Every vector operation works component by component on (size, lanes), so a
splat beside a true vector is left to numpy's broadcasting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from shpy.backends.numpy.expressions import (
    Expr,
    Level,
    call,
    comparison,
    infix,
    item,
    method,
    negation,
    prefix,
    ternary,
)
from shpy.ir import meaning
from shpy.ir.constants import DTYPES, to_array
from shpy.ir.ops import COMPOSITES, OPS
from shpy.ir.types import Base, Type

__all__ = ["INFIX", "MEANINGS", "SHIFTS", "Imports", "constant", "dtype", "operation", "picked", "zeros"]

INFIX: Final = {
    "add": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "and": "&",
    "or": "|",
    "xor": "^",
    "eq": "==",
    "ne": "!=",
    "lt": "<",
    "le": "<=",
    "gt": ">",
    "ge": ">=",
}
"""Operations that are operators of Python."""
_NUMPY: Final = {"abs": "abs"} | {
    row.name: row.function.__name__ for row in OPS.values() if isinstance(row.function, np.ufunc) and row.name != "abs"
}
"""The function of numpy that is the table's meaning of an operation."""
_MEANING: Final = {
    row.name: row.function.__name__ for row in OPS.values() if row.function.__module__ == meaning.__name__
}
"""The function of `shpy.ir.meaning` that is."""
MEANINGS: Final = frozenset(_MEANING.values()) | {"convert"}
"""The functions of `shpy.ir.meaning` that text may import."""
_GEOMETRY: Final = frozenset(name for name in COMPOSITES if not OPS[name].componentwise)
SHIFTS: Final = {"shl": "<<", "shr": ">>"}
"""What Python's operators do too, by less than 32."""
_LITERALS_WELCOME: Final = frozenset({"min", "max", "clamp", "mod", "atan2"})
"""Functions that give a literal the type of the other operand."""


class Imports:
    """What the emitted text imports: asked for by name, in order of the alphabet when printed."""

    def __init__(self) -> None:
        self.meaning: set[str] = set()
        self.lanes: set[str] = set()

    def from_meaning(self, function: str) -> str:
        """A function of `shpy.ir.meaning`."""
        self.meaning.add(function)
        return function

    def from_lanes(self, function: str) -> str:
        """A function of `shpy.backends.numpy.lanes`."""
        self.lanes.add(function)
        return function


def dtype(type: Type) -> str:
    """`np.float32`."""
    return f"np.{np.dtype(DTYPES[type.base]).name}" if not type.is_bool else "np.bool_"


def zeros(type: Type, lanes: str, length: int | None = None) -> str:
    """An array of zeros for a slot; `lanes` is '' for a uniform one."""
    extents = [str(length)] if length is not None else []
    if type.size > 1:
        extents.append(str(type.size))
    if extents or lanes:
        extents.append(lanes or "1")
        shape = extents[0] if len(extents) == 1 else f"({', '.join(extents)})"
        return f"np.zeros({shape}, {dtype(type)})"
    return f"{dtype(type)}({'False' if type.is_bool else '0'})"


def _number(type: Type, value: Any) -> str:
    """The shortest literal that means `value` at the type's precision."""
    if not type.is_float:
        return repr(value)
    if value != value:
        return "np.nan"
    if value in (float("inf"), float("-inf")):
        return "np.inf" if value > 0 else "-np.inf"
    rounded = DTYPES[type.base](value)
    short = repr(rounded.item() if type.base is Base.D else float(str(rounded)))
    return short if DTYPES[type.base](float(short)) == rounded else repr(rounded.item())


def constant(type: Type, attr: tuple[int, ...]) -> Expr:
    """A constant: a literal, or a vector written out."""
    with np.errstate(all="ignore"):
        exact = to_array(type, attr)
    if type.size == 1:
        text = _number(type, exact.item())
        level = Level.UNARY if text.startswith("-") else Level.POSTFIX
        return Expr(text, level, literal=True, typed=f"{dtype(type)}({text})")
    if len(set(attr)) == 1:
        one = constant(type.scalar, attr[:1])
        return Expr(f"np.full(({type.size}, 1), {one.typed})", splat=one)
    rows = ", ".join(f"[{_number(type, c)}]" for c in exact.tolist())
    return Expr(f"{dtype(type)}([{rows}])")


def operation(op: str, args: Sequence[Expr], types: Sequence[Type], type: Type, varies: bool, use: Imports) -> Expr:
    """An operation of the table, or one of the structural ones that name nothing."""
    match op:
        case "construct":
            function = "vector" if all(t.size == 1 for t in types) else "joined"
            return call(use.from_lanes(function), *(a.own() for a in args))
        case "splat":
            return _splat(args[0], type.size, use)
        case "component":
            return call(use.from_lanes("component"), *(a.own() for a in args))
        case "any" | "all":
            return call(f"np.{op}", args[0], "axis=0") if types[0].size > 1 else args[0]
        case "convert":
            return _convert(args[0].own(), types[0], type, use)
        case "lane_any":
            return call("np.any", args[0]) if args[0].level < Level.POSTFIX else method(args[0], "any")
        case "half":
            return call(use.from_lanes("half"), args[0].own())
        case _ if op in _GEOMETRY:
            return _geometry(op, args, types, use)
    return _componentwise(op, args, types, type, varies, use)


def _splat(scalar: Expr, size: int, use: Imports) -> Expr:
    whole = call(use.from_lanes("splat"), scalar.own(), str(size))
    return replace(whole, splat=scalar)


def _geometry(op: str, args: Sequence[Expr], types: Sequence[Type], use: Imports) -> Expr:
    owned = [a.own() for a in args]
    if op in ("dot", "normalize", "reflect") and types[0].size > 1:
        return call(use.from_lanes(op), *owned)
    function = use.from_meaning(op)
    if types[0].size > 1:
        return call(function, *owned)
    return call(use.from_lanes("on_components"), function, *owned)


def _componentwise(
    op: str, args: Sequence[Expr], types: Sequence[Type], type: Type, varies: bool, use: Imports
) -> Expr:
    """Work on the scalars of splats; where all operands are splats the result is one too."""
    if type.size > 1 and all(a.splat is not None for a in args):
        scalars = [a.splat for a in args if a.splat is not None]
        narrow = [t.scalar for t in types]
        return _splat(_elementwise(op, scalars, narrow, type.scalar, varies, use), type.size, use)
    return _elementwise(op, [a.splat if a.splat is not None else a for a in args], types, type, varies, use)


def _elementwise(op: str, args: list[Expr], types: Sequence[Type], type: Type, varies: bool, use: Imports) -> Expr:
    if all(a.literal for a in args):
        args = [a.own() for a in args]
    if op in ("eq", "ne", "lt", "le", "gt", "ge"):
        return comparison(INFIX[op], args[0], args[1], ordered=not types[0].is_float)
    if op in INFIX:
        return infix(INFIX[op], args[0], args[1])
    match op:
        case "neg":
            return prefix("-", args[0])
        case "not" if type.is_bool and not varies and type.size == 1:
            return negation(args[0])
        case "not":
            return prefix("~", args[0])
        case "cond" if not varies and types[0].size == 1:
            return ternary(args[0], args[1].own(), args[2].own())
        case "cond" if args[1].literal and args[2].literal:  # two literals would choose their own type, 64 bits wide
            return call(use.from_lanes("select"), args[0], args[1].own(), args[2])
        case "cond":
            return call(use.from_lanes("select"), *args)
        case "mad":
            return infix("+", infix("*", args[0].own(), args[1]), args[2])
        case "min" | "max" if type.is_int:
            return call(f"np.{op}imum", *args)
        case "min" | "max":
            return _extremum(op, args, use)
        case "clamp":
            return _extremum("min", [_extremum("max", args[:2], use), args[2]], use)
        case "float_from_bits":
            whole = method(args[0], "view", "np.float32")
            return whole if type.base is Base.F else method(whole, "astype", dtype(type))
        case "shl" | "shr" | "floordiv" | "floormod" if args[1].literal and _plain(op, args[1], type):
            symbols = {**SHIFTS, "floordiv": "//", "floormod": "%"}
            return infix(symbols[op], args[0], args[1])
    if op in _NUMPY:
        return call(f"np.{_NUMPY[op]}", *(args if op in _LITERALS_WELCOME else [a.own() for a in args]))
    function = use.from_meaning(_MEANING[op])
    return call(function, *(args if op in _LITERALS_WELCOME else [a.own() for a in args]))


def _extremum(op: str, args: list[Expr], use: Imports) -> Expr:
    """The min or max of floats: numpy's own but for NaN, and where both may be zeros of two signs."""
    literals = [a.text for a in args if a.literal]
    if args[0].literal and len(literals) == 1 and literals[0].lstrip("-") not in ("0.0", "np.nan"):
        args = args[::-1]  # these are the same in either order
    return call(use.from_lanes(f"{op}imum"), *(args if len(literals) < 2 else [args[0].own(), args[1]]))


def _plain(op: str, literal: Expr, type: Type) -> bool:
    """Whether Python's operator has no edge that this right operand could reach."""
    value = int(literal.text)
    return 0 <= value < 32 if op in ("shl", "shr") else value not in (0, -1)


def _convert(e: Expr, source: Type, target: Type, use: Imports) -> Expr:
    if target.is_bool:
        return infix("!=", e, Expr("0"))
    if source.is_bool:
        return call(dtype(target), e)
    if source.is_float and target.is_int:
        return call(use.from_meaning("convert"), e, dtype(target))
    return method(e, "astype", dtype(target))


def picked(e: Expr, components: tuple[int, ...]) -> Expr:
    """The components of a vector: one as a scalar, several in a row as a view, others as a copy."""
    if len(components) == 1:
        return item(e, str(components[0]))
    first, last = components[0], components[-1]
    if components == tuple(range(first, last + 1)):
        return item(e, f"{first or ''}:{last + 1}")
    return replace(item(e, str(list(components))), shared=False)
