"""Operations on values: operands in, one typed operation out.

Stage: record. Types the operands by the rules in `coerce.py`, converts and broadcasts them, emits the operation of the
table, and wraps the result as a new value of the right kind. Works on constants too, outside a recording.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np

from shpy.errors import ShpyTypeError
from shpy.ir.constants import encode
from shpy.ir.types import FLOATS, SIZES, WIDEST_PORT, Base, Type, vec
from shpy.lang.mistakes.expressions import parenthesized
from shpy.lang.recording.emit import DEFERRED, HOST, Emitter, Handle
from shpy.lang.recording.location import here, on_one_line
from shpy.lang.recording.recorder import Frame, current_frame, need_frame
from shpy.lang.recording.symbolic import Symbolic
from shpy.lang.values.abstract import CLASSES, AbstractValue
from shpy.lang.values.coerce import (
    Literal,
    cast_literal,
    common_base,
    common_kind,
    common_size,
    literal,
    merge,
    sequence,
    sum_kind,
)
from shpy.lang.values.dependent import follower

Operand = Any  # a Value or a Literal

_OPERANDS = "a value of the language, a number, or a tuple, list or 1-D array of up to four"


def emitter_of(*operands: Any) -> Emitter:
    """Return the emitter: the recording under way, else the host, or an expression if an operand is a uniform."""
    frame = current_frame()
    if frame is not None:
        return frame
    emitter: Emitter = HOST
    for x in operands:
        if isinstance(x, AbstractValue):
            if x._frame is not None:
                x._check(None)
            if x._uniform:
                emitter = DEFERRED
    return emitter


def is_operand(x: Any) -> bool:
    """Return whether `x` may stand beside an operator."""
    return isinstance(x, AbstractValue) or literal(x) is not None or sequence(x) is not None


def refuse_operand(x: Any, what: str) -> None:
    """Raise ShpyTypeError unless an operator takes the object; those of other classes may define operators."""
    cure = _OPERANDS
    if isinstance(x, np.ndarray):
        cure = "sh.Table(array, type) to look numbers up in, an input for one number an element, or sh.Matrix3f(array)"
    elif isinstance(x, Fraction | Decimal):
        cure = "float(…), the nearest number that Python's float has"
    elif not (x is None or isinstance(x, str | bytes | complex | dict | set)):
        return
    spoken = f"an array of shape {x.shape}" if isinstance(x, np.ndarray) else type(x).__name__
    raise ShpyTypeError(f"{what} cannot take {spoken}", loc=here(), cure=cure)


def operand(x: Any, what: str) -> Operand:
    """Return `x` as a Value or Literal; tuples, lists and 1-D arrays become vectors."""
    if isinstance(x, AbstractValue | Literal):
        return x
    single = literal(x)
    if single is not None:
        return single
    entries = sequence(x)
    if entries is None or len(entries) not in SIZES:
        spoken = f"{len(entries)} numbers" if entries is not None else type(x).__name__
        cure = _OPERANDS
        if isinstance(x, Symbolic):
            cure = "its rows, fields or elements, one at a time"
        elif isinstance(x, slice):
            cure = "[a[k] for k in range(…)], or SH_FOR for many"
        raise ShpyTypeError(f"{what} cannot take {spoken}", loc=here(), cure=cure)
    single_parts = [operand(e, what) for e in entries]
    literals = [p for p in single_parts if isinstance(p, Literal)]
    if len(literals) == len(single_parts):
        return merge(literals)
    base = base_of(single_parts, what)
    return CLASSES["Attrib", len(entries), base](*entries)


def base_of(operands: Sequence[Operand], what: str) -> Base:
    """Return the base in which the operands meet."""
    strong = [o.base for o in operands if not isinstance(o, Literal)]
    return common_base(strong, [o.weak for o in operands if isinstance(o, Literal)], what)


def make_value(kind: str, type: Type, emitter: Emitter, handle: Handle) -> Any:
    """Make a new value of this kind and type that holds the handle."""
    cls = CLASSES[kind if type.is_float and type.size <= WIDEST_PORT else "Attrib", type.size, type.base]
    value = object.__new__(follower(cls) if emitter is DEFERRED else cls)  # type: ignore[arg-type]
    value._become(current_frame() if emitter is not HOST else None, emitter, handle)
    return value


def read(emitter: Emitter, x: Operand, type: Type) -> Handle:
    """Return the operand as a handle of `type`: converted to its base, splatted to its size."""
    if isinstance(x, Literal):
        numbers = cast_literal(x, type.base)
        return emitter.const(type, encode(type, numbers if x.size == type.size else numbers * type.size))
    handle = x._read(emitter)
    if x.base is not type.base:
        handle = emitter.let("convert", (handle,), x.type.based(type.base))
    return handle if x.size == type.size else emitter.let("splat", (handle,), type)


@on_one_line
def elementwise(op: str, args: Sequence[Any], what: str, *, floats: bool = False, kind: str | None = None) -> Any:
    """Apply a component-wise operation to operands that meet in one type; `floats` widens ints to f first."""
    operands = [operand(a, what) for a in args]
    base = base_of(operands, what)
    if op in ("and", "or", "xor") and base in FLOATS and any(isinstance(o, Literal) for o in operands):
        power = what == "^"
        raise ShpyTypeError(
            f"{what} takes bools or ints, not a number and a float"
            + ("" if power else "; it binds tighter than < and =="),
            loc=here(),
            cure="x ** 2 for a power, sh.Attrib1i(x) ^ 2 for bits"
            if power
            else parenthesized(here()) or f"parentheses, (x > 0) {what} (y < 1)",
        )
    if floats and base in (Base.I, Base.U):
        base = Base.F
    type = vec(base, common_size([o.size for o in operands], what))
    emitter = emitter_of(*operands)
    handles = tuple((read(emitter, o, type), type) for o in operands)
    return emit(emitter, op, handles, kind or common_kind([getattr(o, "kind", "Attrib") for o in operands]), what)


def emit(emitter: Emitter, op: str, handles: tuple[tuple[Handle, Type], ...], kind: str, what: str) -> Any:
    """Apply an operation to handles that are typed already; the table's TypeError becomes the user's."""
    try:
        handle, type = emitter.op(op, handles)
    except TypeError as error:
        types = ", ".join(repr(t) for _, t in handles)
        raise ShpyTypeError(f"{what} does not take {types}", loc=here(), cure=_cure(op, handles)) from error
    return make_value(kind, type, emitter, handle)


def _cure(op: str, handles: tuple[tuple[Handle, Type], ...]) -> str:
    bases = {t.base for _, t in handles}
    if op in ("and", "or", "xor", "not") and bases <= {Base.F, Base.D, Base.H}:
        return (op in ("and", "or") and parenthesized(here())) or (
            "sh.dot(a, b) for a product of vectors, a > 0 for a condition, (a > 0) & (b > 0) for two, "
            "sh.Attrib1i(a) for bits"
        )
    if Base.B in bases:
        return "sh.cond(c, 1.0, 0.0) makes a number of a bool"
    return "operands as docs/numerics.md lists them for this operation"


def binary(op: str, a: Any, b: Any, what: str) -> Any:
    """Apply a binary operator of Python."""
    left, right = operand(a, what), operand(b, what)
    if op == "div":
        return elementwise("div", (left, right), what, floats=True)
    if op in ("floordiv", "floormod") and base_of((left, right), what) not in (Base.I, Base.U):
        if op == "floormod":
            return elementwise("mod", (left, right), what)
        return _floor_quotient(left, right, what)
    if op == "pow":
        return _power(left, right, what)
    if op in ("shl", "shr", "rotl", "rotr"):
        return _shift(op, left, right, what)
    if op in ("add", "sub"):
        kind = sum_kind(op, getattr(left, "kind", "Attrib"), getattr(right, "kind", "Attrib"))
        return elementwise(op, (left, right), what, kind=kind)
    return elementwise(op, (left, right), what)


def _floor_quotient(left: Operand, right: Operand, what: str) -> Any:
    """Return `floor(x / y)`; -1 where the quotient is negative and so small that it is flushed to zero."""

    def compare(op: str, a: Any, b: Any) -> Any:
        return elementwise(op, (a, b), what)

    quotient = elementwise("floor", (elementwise("div", (left, right), what),), what)
    below = compare("and", compare("eq", quotient, 0), compare("ne", left, 0))
    opposite = compare("ne", compare("lt", left, 0), compare("lt", right, 0))
    finite = elementwise("not", (elementwise("isinf", (right,), what, floats=True),), what)
    return select(compare("and", compare("and", below, opposite), finite), -1, quotient)


def _power(left: Operand, right: Operand, what: str) -> Any:
    """Return `x ** 2` and `x ** 3` as products, other powers as pow."""
    if isinstance(right, Literal) and right.weak == "int" and right.size == 1 and right.components[0] in (2, 3):
        square = elementwise("mul", (left, left), what)
        return square if right.components[0] == 2 else elementwise("mul", (square, left), what)
    return elementwise("pow", (left, right), what, floats=True)


def _shift(op: str, left: Operand, right: Operand, what: str) -> Any:
    if isinstance(right, Literal) and right.weak != "int":
        shown = ", ".join(map(str, right.components))
        raise ShpyTypeError(f"{what} takes an int as the count of bits, not {shown}", loc=here(), cure="int(n)")
    if not isinstance(right, Literal) and not right.type.is_int:
        raise ShpyTypeError(
            f"{what} takes a count of type i or u, not {right.type!r}", loc=here(), cure="sh.Attrib1i(n)"
        )
    if (isinstance(left, Literal) and left.weak == "float") or (not isinstance(left, Literal) and left.type.is_float):
        shown = ", ".join(map(str, left.components)) if isinstance(left, Literal) else repr(left.type)
        raise ShpyTypeError(
            f"{what} takes the bits of an int, not {shown}",
            loc=here(),
            cure="sh.Attrib1i(x), which truncates; sh.bits_from_float(x) for the bits of a float",
        )
    left_base = base_of((left, right) if isinstance(left, Literal) else (left,), what)
    size = common_size([left.size, right.size], what)
    type = vec(left_base, size)
    count = type.based(base_of((right,), what))
    emitter = emitter_of(left, right)
    return emit(emitter, op, ((read(emitter, left, type), type), (read(emitter, right, count), count)), "Attrib", what)


def check_index(i: Operand) -> None:
    """Raise ShpyTypeError for an index that is not one int."""
    if i.size != 1 or not (i.weak == "int" if isinstance(i, Literal) else i.type.is_int):
        cure = "sh.Attrib1i(x) makes an int of a float" if i.size == 1 else "one component of a vector of ints"
        raise ShpyTypeError("an index is one int", loc=here(), cure=cure)


def index(emitter: Emitter, i: AbstractValue) -> Handle:
    """Return an int value as an index of type i: an unsigned one beyond i's range becomes its largest."""
    handle = i._read(emitter)
    if i.base is not Base.U:
        return handle
    largest = emitter.const(i.type, encode(i.type, [2**31 - 1] * i.size))
    smaller, _ = emitter.op("min", ((handle, i.type), (largest, i.type)))
    return emitter.let("convert", (smaller,), i.type.based(Base.I))


@on_one_line
def select(c: Any, a: Any, b: Any) -> Any:
    """Return `a` where `c` holds, else `b`, component by component; both are evaluated."""
    chosen = operand(c, "sh.cond")
    if base_of((chosen,), "sh.cond") is not Base.B:
        raise ShpyTypeError("the condition of sh.cond is a bool", loc=here(), cure="sh.cond(x > 0, a, b)")
    operands = [operand(a, "sh.cond"), operand(b, "sh.cond")]
    size = common_size([chosen.size, *(o.size for o in operands)], "sh.cond")
    type = vec(base_of(operands, "sh.cond"), size)
    emitter = emitter_of(chosen, *operands)
    condition = type.based(Base.B)
    handles = ((read(emitter, chosen, condition), condition), *((read(emitter, o, type), type) for o in operands))
    return emit(emitter, "cond", handles, common_kind([getattr(o, "kind", "Attrib") for o in operands]), "sh.cond")


def condition(c: Any, what: str) -> int:
    """Return the id of one bool, or of a callable's result; errors for anything else."""
    frame = need_frame(what)
    if callable(c) and not isinstance(c, AbstractValue):
        if not _takes_nothing(c):
            raise ShpyTypeError(f"{what} calls its condition without arguments", loc=here(), cure=f"{what}(lambda: …)")
        c = c()
    holds = operand(c, what)
    if isinstance(holds, Literal):
        if holds.weak != "bool" or holds.size != 1:
            raise ShpyTypeError(f"{what} takes one bool, not {c!r}", loc=here(), cure=f"{what}(x > 0)")
    elif holds.base is not Base.B:
        raise ShpyTypeError(
            f"{what} takes one bool, not {type(c).__name__}",
            loc=here(),
            cure=f"{what}(x > 0), a comparison" if holds.size == 1 else f"{what}(sh.any(x > 0)), of a comparison",
        )
    elif holds.size != 1:
        raise ShpyTypeError(
            f"{what} takes one bool, not {holds.size}", loc=here(), cure=f"{what}(sh.any(c)) or {what}(sh.all(c))"
        )
    return int(read(frame, holds, vec(Base.B)))


def _takes_nothing(function: Callable[..., Any]) -> bool:
    """Return whether a function can be called without arguments; True where Python does not know what it takes."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:
        return True
    return all(p.default is not p.empty or p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD) for p in parameters)


def convert(frame: Frame, x: Any, type: Type, what: str) -> Handle:
    """Return `x` as a value of `type` for a store: widens and splats, never narrows."""
    value = operand(x, what)
    check_width(value, type, what)
    if value.size not in (1, type.size):
        if type.size == 1:
            amount, cure = "one component", "pick one, as in v.x"
        else:
            amount = f"{type.size} components or one"
            cure = "pick components, as in v.xyz, or build the vector, as in sh.Attrib3f(p.xy, 0)"
        raise ShpyTypeError(f"{what} takes {amount}, not {value.size}", loc=here(), cure=cure)
    return read(frame, value, type)


def check_width(value: Operand, type: Type, what: str) -> None:
    """Raise ShpyTypeError for an operand that a store into this type would narrow."""
    if isinstance(value, Literal):
        narrow = (value.weak == "float" and not type.is_float) or (value.weak == "bool") != type.is_bool
    else:
        narrow = value.base is not type.base and common_base([value.base, type.base], [], what) is not type.base
    if narrow:
        source = value.weak if isinstance(value, Literal) else repr(value.type)
        raise ShpyTypeError(
            f"{what} of type {type!r} would narrow {source}",
            loc=here(),
            cure=f"the conversion written out, sh.Attrib{type.size}{type.base.value}(…)",
        )


# What constructors do


def parts(cls: type[AbstractValue], x: Any) -> list[Operand]:
    """Return one argument of a constructor as operands."""
    if isinstance(x, AbstractValue):
        return [x]
    single = literal(x)
    if single is not None:
        return [single]
    entries = sequence(x)
    if entries is None:
        raise ShpyTypeError(
            f"{cls.__name__} takes numbers and values, not {type(x).__name__}",
            loc=here(),
            cure=f"sh.{cls.__name__}({', '.join('0' * cls.size)})",
        )
    return [p for e in entries for p in parts(cls, e)]


def constant(type_: Type, literals: Sequence[Literal], cls: type[AbstractValue]) -> tuple[int, ...]:
    """Return the constant that a constructor of `cls` makes of host numbers."""
    numbers = [c for part in literals for c in part.components]
    if len(numbers) not in (1, type_.size):
        raise count_error(cls, len(numbers))
    if type_.is_int:
        numbers = [int(c) if isinstance(c, float) and abs(c) < 2**40 else c for c in numbers]
    cast = cast_literal(Literal("float" if type_.is_float else "int", tuple(numbers)), type_.base)
    return encode(type_, cast if len(cast) == type_.size else cast * type_.size)


def count_error(cls: type[AbstractValue], count: int) -> ShpyTypeError:
    """Return the error for a constructor that was given too few or too many components."""
    amount = f"exactly {cls.size} components or one scalar" if cls.size > 1 else "one component"
    example = {1: "x", 2: "x, y", 3: "p.xy, 0", 4: "p.xyz, 1", 8: "v, w"}[cls.size]
    return ShpyTypeError(
        f"{cls.__name__} takes {amount}, not {count}", loc=here(), cure=f"sh.{cls.__name__}({example})"
    )


def assemble(emitter: Emitter, type: Type, operands: Sequence[Operand], cls: type[AbstractValue]) -> Handle:
    """Return the handle of a vector from any mix of scalars and vectors, converted to its base."""
    count = sum(o.size for o in operands)
    if len(operands) == 1 and count == 1:
        return read(emitter, operands[0], type)
    if count != type.size:
        raise count_error(cls, count)
    handles = tuple(read(emitter, o, vec(type.base, o.size)) for o in operands)
    return handles[0] if len(handles) == 1 else emitter.let("construct", handles, type)
