"""Rules for operands that meet: literals, mixing of bases, broadcasting, kinds.

Stage: record. Takes the operands of an operator and returns types; `arithmetic` and `builtins` then emit.

An int literal takes the other operand's type, a float literal widens ints to `f`, True and False are `b`; bases mix
h -> f -> d, ints widen to at least `f`, `i` with `u` and anything with `b` are errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shpy.errors import ShpyTypeError
from shpy.ir.types import FLOATS, Base
from shpy.lang.recording.location import here

_ORDER = {Base.H: 0, Base.F: 1, Base.D: 2}
_INFINITE = {Base.H: 65520.0, Base.F: 2.0**128 - 2.0**103, Base.D: math.inf}
"""The least number that rounds to infinity: halfway between the largest float and the next power of two."""
_RANGES = {Base.I: (-(2**31), 2**31 - 1), Base.U: (0, 2**32 - 1)}
_SPOKEN = {Base.F: "f", Base.D: "d", Base.H: "h", Base.I: "i", Base.U: "u", Base.B: "b"}


@dataclass(frozen=True, slots=True)
class Literal:
    """Numbers of the host; `weak` is their kind: "int", "float" or "bool"."""

    weak: str
    components: tuple[Any, ...]

    @property
    def size(self) -> int:
        """The number of components."""
        return len(self.components)


def literal(x: Any) -> Literal | None:
    """Return `x` as a literal if it is a number or bool of Python or numpy, or a 0-D array; else None."""
    if isinstance(x, np.ndarray):
        if x.ndim != 0:
            return None
        x = x[()]
    if isinstance(x, bool | np.bool_):
        return Literal("bool", (bool(x),))
    if isinstance(x, int | np.integer):
        return Literal("int", (int(x),))
    if isinstance(x, float | np.floating):
        return Literal("float", (float(x),))
    return None


def sequence(x: Any) -> list[Any] | None:
    """Return the entries of a tuple, list or 1-D array; else None."""
    if isinstance(x, tuple | list):
        return list(x)
    if isinstance(x, np.ndarray) and x.ndim == 1:
        return list(x)
    return None


def merge(literals: Sequence[Literal]) -> Literal:
    """Join several literals to a vector, of the widest of their kinds."""
    kinds = {part.weak for part in literals}
    if "bool" in kinds and len(kinds) > 1:
        raise ShpyTypeError(
            "bools and numbers stand in one vector", loc=here(), cure="numbers throughout, or True and False throughout"
        )
    weak = "float" if "float" in kinds else kinds.pop()
    return Literal(weak, tuple(c for part in literals for c in part.components))


def common_base(strong: Iterable[Base], weak: Iterable[str], what: str) -> Base:
    """Return the common base of operands with the bases `strong` and literals of the kinds `weak`."""
    bases, kinds = set(strong), set(weak)
    if not bases:
        if "bool" in kinds and len(kinds) > 1:
            raise _mix_error(what, "b", "a number")
        return Base.B if "bool" in kinds else Base.F if "float" in kinds else Base.I
    base = _mix(bases, what)
    if base is Base.B and kinds - {"bool"}:
        raise _mix_error(what, "b", "a number")
    if base is not Base.B and "bool" in kinds:
        raise _mix_error(what, _SPOKEN[base], "a bool")
    return Base.F if "float" in kinds and base not in FLOATS else base


def widens(old: Base, new: Base) -> bool:
    """Return whether a number of `old` becomes one of `new` without a conversion that is written out."""
    try:
        return common_base([old, new], [], "") is new
    except ShpyTypeError:
        return False


def _mix(bases: set[Base], what: str) -> Base:
    if len(bases) == 1:
        return next(iter(bases))
    if Base.B in bases:
        other = next(b for b in bases if b is not Base.B)
        raise _mix_error(what, "b", _SPOKEN[other])
    floats = bases & FLOATS
    if not floats:
        raise ShpyTypeError(
            f"{what} mixes i with u", loc=here(), cure="convert one: sh.Attrib1u(x) or sh.Attrib1i(x) (they wrap)"
        )
    widest = max(floats, key=_ORDER.__getitem__)
    return Base.F if bases - FLOATS and widest is Base.H else widest


def _mix_error(what: str, one: str, other: str) -> ShpyTypeError:
    return ShpyTypeError(
        f"{what} mixes {one} with {other}",
        loc=here(),
        cure="sh.cond(c, 1.0, 0.0) makes a number of a bool, x != 0 a bool of a number",
    )


def cast_literal(value: Literal, base: Base) -> tuple[Any, ...]:
    """Return the literal's components as numbers of `base`; an error when one is out of range."""
    if base is Base.B:
        return tuple(bool(c) for c in value.components)
    if base in FLOATS:
        for c in value.components:
            too_large = isinstance(c, int) and abs(c) >= 2**1024 - 2**970  # float(c) would be an OverflowError
            if too_large or (math.isfinite(c) and abs(float(c)) >= _INFINITE[base]):
                raise ShpyTypeError(
                    f"{_shown(c)} is out of the range of {_SPOKEN[base]}",
                    loc=here(),
                    cure="float('inf') if infinity is meant, or a wider type",
                )
        return tuple(float(c) for c in value.components)
    low, high = _RANGES[base]
    for c in value.components:
        if c != c or not low <= c <= high:
            raise ShpyTypeError(
                f"{_shown(c)} is out of the range of {_SPOKEN[base]}, {low} to {high}",
                loc=here(),
                cure="a number in range, or another type",
            )
    return tuple(int(c) for c in value.components)


def check_base(value: Literal, base: Base) -> None:
    """Raise ShpyTypeError for numbers that an input of `base` refuses: a float for i, a bool for f, a number for b."""
    if base is Base.B:
        wrong = value.weak != "bool"
    else:
        wrong = value.weak == "bool" or (base in _RANGES and value.weak == "float")
    if wrong:
        takes = "bools" if base is Base.B else "ints" if base in _RANGES else "numbers"
        spoken = ", ".join(map(_shown, value.components))
        raise ShpyTypeError(f"it takes {takes}, not {spoken}", loc=here(), cure=_EXAMPLES[takes])


_EXAMPLES = {"bools": "True or False; x != 0", "ints": "int(x), which truncates, or round(x)", "numbers": "float(x)"}


def _shown(number: Any) -> str:
    """Return a number's text for a message; Python itself refuses to write out ints of thousands of digits."""
    return f"an int of {number.bit_length()} bits" if isinstance(number, int) and abs(number) > 10**40 else str(number)


def common_size(sizes: Sequence[int], what: str) -> int:
    """Return the size that operands broadcast to: a scalar goes with a vector, two sizes do not."""
    size = max(sizes)
    if any(s not in (1, size) for s in sizes):
        spoken = " and ".join(str(s) for s in sizes)
        raise ShpyTypeError(
            f"{what} takes operands of one size or scalars, not {spoken} components",
            loc=here(),
            cure="pick components, as in v.xyz, or build the vector, as in sh.Attrib3f(p.xy, 0)",
        )
    return size


def common_kind(kinds: Sequence[str]) -> str:
    """Return the kind of a result: the first that is not Attrib."""
    return next((k for k in kinds if k != "Attrib"), "Attrib")


def sum_kind(op: str, left: str, right: str) -> str:
    """Return the kind of left + right or left - right: Point - Point is a Vector, Point and Vector a Point."""
    if op == "sub" and left == right == "Point":
        return "Vector"
    if "Point" in (left, right) and {left, right} <= {"Point", "Vector", "Attrib"}:
        return "Point"
    return common_kind((left, right))
