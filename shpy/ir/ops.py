"""The table of operations: arity, types, exact meaning at the edges, and how close a target must come.

Stage: represent. `lang` and the verifier ask `result_type`, the interpreter and constant folding execute `meaning`,
the tests run every row on every backend, and docs/numerics.md prints the table.

A signature reads `bases: arguments -> result`. Bases: `f` floats, `i` ints, `u` only u, `b` only b, `n` floats and
ints, `w` ints and b, `a` any. Arguments: `T` one type of those bases for all T, `S` its scalar, `V` T with size >= 2,
`V3` T of size 3, `B` b of T's size, `I` i of T's size, `X` any int type of T's size, `b` scalar b, `U` u of T's size.

>>> result_type("dot", (vec("f", 3), vec("f", 3)))
f
>>> result_type("add", (vec("f"), vec("i")))
Traceback (most recent call last):
TypeError: add takes (T, T) of floats or ints, not (f, i)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np

from shpy.ir import meaning as m
from shpy.ir.types import FLOATS, INTS, Base, Type, vec

_BASES: Final[Mapping[str, frozenset[Base]]] = {
    "f": FLOATS,
    "i": INTS,
    "u": frozenset({Base.U}),
    "b": frozenset({Base.B}),
    "n": FLOATS | INTS,
    "w": INTS | {Base.B},
    "a": frozenset(Base),
}
_SPOKEN: Final = {
    "f": "floats",
    "i": "ints",
    "u": "u",
    "b": "bools",
    "n": "floats or ints",
    "w": "ints or bools",
    "a": "any type",
}


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far a result may be from the exact one: `ulp` units in the last place or `absolute`, whichever is more."""

    ulp: float = 0.0
    absolute: float = 0.0


@dataclass(frozen=True, slots=True)
class Op:
    """One row. `meaning` takes and gives arrays (see `meaning.py`); None for the structural operations.

    `tolerance` is how far it may be off at f32 in strict mode, where all targets give the same bits, and `relaxed` in
    relaxed mode; `double` in strict mode at f64. Fast mode promises nothing.
    """

    name: str
    signature: str
    meaning: Callable[..., Any] | None
    doc: str
    symbol: str | None = None
    tolerance: Tolerance = Tolerance()
    relaxed: Tolerance = Tolerance()
    double: Tolerance = Tolerance()

    def bound(self, math: str) -> Tolerance:
        """What is allowed at f32 in "strict" or "relaxed" mode."""
        return self.relaxed if math == "relaxed" else self.tolerance


OPS: Final[dict[str, Op]] = {}


def _op(
    name: str,
    signature: str,
    meaning: Callable[..., Any],
    doc: str,
    *,
    symbol: str | None = None,
    ulp: float = 0.0,
    relaxed: float = 0.0,
    double: float = 0.0,
) -> None:
    OPS[name] = Op(name, signature, meaning, doc, symbol, Tolerance(ulp), Tolerance(relaxed), Tolerance(double))


# Arithmetic
_op("neg", "n: T -> T", np.negative, "minus x; ints wrap", symbol="-")
_op("add", "n: T T -> T", m.in_f32(np.add), "ints wrap", symbol="+")
_op("sub", "n: T T -> T", m.in_f32(np.subtract), "ints wrap", symbol="-")
_op("mul", "n: T T -> T", m.in_f32(np.multiply), "ints wrap", symbol="*")
_op("div", "f: T T -> T", m.in_f32(np.divide), "correctly rounded", symbol="/")
_op("floordiv", "i: T T -> T", m.floor_div_int, "floor(a / b); 0 for b = 0; INT_MIN // -1 is INT_MIN")
_op("floormod", "i: T T -> T", m.floor_mod_int, "a - b * floor(a / b), sign of b; 0 for b = 0")
_op("fma", "f: T T T -> T", m.fma, "a * b + c rounded once")
_op("mad", "f: T T T -> T", m.in_f32(lambda a, b, c: a * b + c), "a * b + c rounded twice")
# Bits
_op("and", "w: T T -> T", np.bitwise_and, "", symbol="&")
_op("or", "w: T T -> T", np.bitwise_or, "", symbol="|")
_op("xor", "w: T T -> T", np.bitwise_xor, "", symbol="^")
_op("not", "w: T -> T", np.invert, "", symbol="~")
_op("shl", "i: T X -> T", m.shift_left, "by n mod 32", symbol="<<")
_op("shr", "i: T X -> T", m.shift_right, "by n mod 32; arithmetic for i", symbol=">>")
_op("popcount", "i: T -> T", m.popcount, "number of one bits")
# Comparison
_op("eq", "a: T T -> B", np.equal, "NaN equals nothing", symbol="==")
_op("ne", "a: T T -> B", np.not_equal, "NaN differs from everything", symbol="!=")
_op("lt", "n: T T -> B", np.less, "false with a NaN", symbol="<")
_op("le", "n: T T -> B", np.less_equal, "false with a NaN", symbol="<=")
_op("gt", "n: T T -> B", np.greater, "false with a NaN", symbol=">")
_op("ge", "n: T T -> B", np.greater_equal, "false with a NaN", symbol=">=")
_op("isnan", "f: T -> B", np.isnan, "")
_op("isinf", "f: T -> B", np.isinf, "")
_op("any", "b: T -> b", lambda x: x if x.ndim == 0 else np.any(x, axis=0), "one component holds")
_op("all", "b: T -> b", lambda x: x if x.ndim == 0 else np.all(x, axis=0), "every component holds")
_op("cond", "a: B T T -> T", m.select, "a where c holds, else b; both are evaluated")
# Common functions
_op("abs", "n: T -> T", np.abs, "abs(INT_MIN) is INT_MIN")
_op("sign", "n: T -> T", m.sign, "sign(NaN) and sign(-0) are 0")
_op("floor", "f: T -> T", np.floor, "")
_op("ceil", "f: T -> T", np.ceil, "")
_op("round", "f: T -> T", np.rint, "half to even")
_op("trunc", "f: T -> T", np.trunc, "")
_op("fract", "f: T -> T", m.in_f32(m.fract), "x - floor(x)")
_op("mod", "f: T T -> T", m.in_f32(m.mod), "x - y * floor(x / y)")
_op("min", "n: T T -> T", m.minimum, "the number where one is NaN")
_op("max", "n: T T -> T", m.maximum, "the number where one is NaN")
_op("clamp", "n: T T T -> T", m.clamp, "min(max(x, low), high)")
_op("mix", "f: T T T -> T", m.in_f32(m.mix), "a * (1 - t) + b * t")
_op("step", "f: T T -> T", m.step, "0 where x < edge, else 1")
_op("smoothstep", "f: T T T -> T", m.in_f32(m.smoothstep), "step(a, x) where a = b")
_op("sqrt", "f: T -> T", m.in_f32(np.sqrt), "correctly rounded")
_op("rsqrt", "f: T -> T", m.in_f32(m.rsqrt), "1 / sqrt(x), rounded twice")
_op("ldexp", "f: T I -> T", m.ldexp, "x * 2**n rounded once")
_op("bits_from_float", "f: T -> U", m.bits_from_float, "binary32 bits; 0x7fc00000 for every NaN")
_op("float_from_bits", "u: T -> F", lambda x: x.view(np.float32), "the binary32 with these bits")
# Geometry
_op("dot", "f: T T -> S", m.in_f32(m.dot), "summed from the first component on")
_op("cross", "f: V3 V3 -> V3", m.in_f32(m.cross), "")
_op("length", "f: T -> S", m.in_f32(m.length), "sqrt(dot(v, v)), scaled where squares would overflow or vanish")
_op("distance", "f: T T -> S", m.in_f32(m.distance), "length(a - b)")
_op("normalize", "f: T -> T", m.in_f32(m.normalize), "v / length(v); 0 for the zero vector")
_op("reflect", "f: T T -> T", m.in_f32(m.reflect), "i - 2 * dot(n, i) * n")
_op("refract", "f: T T S -> T", m.in_f32(m.refract), "GLSL 4.60 section 8.5; 0 at total reflection")
_op("faceforward", "f: T T T -> T", m.in_f32(m.faceforward), "n where dot(reference, i) < 0, else -n")


# Transcendentals: in strict mode those of `passes/strict`; in relaxed mode the target's own within the bounds of
# OpenCL's full profile (OpenCL C 3.0 section 7.4), or the strict ones where the target has none that keep them.
def _transcendental(
    name: str, f: Callable[..., Any], ulp: float, relaxed: float, double: float, doc: str = "", arity: int = 1
) -> None:
    signature = f"f: {' '.join('T' * arity)} -> T"
    _op(name, signature, m.through_f64(f), doc, ulp=ulp, relaxed=relaxed, double=double)


_transcendental("exp", np.exp, 1, 3, 1)
_transcendental("exp2", np.exp2, 1, 3, 1)
_transcendental("log", np.log, 1, 3, 1)
_transcendental("log2", np.log2, 1, 3, 1)
_transcendental("log10", np.log10, 1, 3, 1)
_transcendental("sin", np.sin, 1, 4, 1.25)
_transcendental("cos", np.cos, 1, 4, 1.25)
_transcendental("tan", np.tan, 1.5, 5, 1.5)
_transcendental("asin", np.arcsin, 1, 4, 1)
_transcendental("acos", np.arccos, 1, 4, 1)
_transcendental("atan", np.arctan, 1, 5, 1)
_transcendental("sinh", np.sinh, 1, 4, 1)
_transcendental("cosh", np.cosh, 1, 4, 1)
_transcendental("tanh", np.tanh, 1.5, 5, 1)
_transcendental("asinh", np.arcsinh, 1.5, 4, 1)
_transcendental("acosh", np.arccosh, 1.5, 4, 1)
_transcendental("atanh", np.arctanh, 1.5, 5, 1)
_transcendental("pow", m.power, 1, 16, 1, arity=2)
_transcendental("atan2", np.arctan2, 1, 6, 1, arity=2)

TRANSCENDENTALS: Final = frozenset(name for name, op in OPS.items() if op.relaxed.ulp)
"""The operations that no target is asked to do correctly rounded."""

# Structural operations: their types are ruled by the verifier, their meaning is the interpreter's.
STRUCTURAL: Final[Mapping[str, str]] = {
    "const": "a constant of the value's type; attr: its components",
    "load": "the variable's value; of an array, the element at the i (clamped) that is the argument; attr: its id",
    "construct": "a vector from scalars and vectors of its base, N components in all",
    "splat": "a vector from one scalar",
    "swizzle": "components picked, in any order and number; attr: which",
    "component": "the component at a run-time i, clamped; arguments: vector, i",
    "convert": "the value's type from another base of the same size; see docs/numerics.md",
    "param": "a uniform; attr: its name",
    "table": "the element at an i, or at an i2 or i3 in the order of numpy's axes, clamped on each; attr: its name",
    "table_size": "the table's shape: i, i2 or i3; attr: its name",
    "neighbour": "a table's element at grid_index moved by an i on each axis, clamped; where as many i follow, modulo "
    "these; attr: the table's name",
    "grid_index": "this element's index along numpy's axes: i to i4",
    "grid_shape": "the number of elements along numpy's axes: i to i4",
    "any_lane": "whether c holds for any active element that runs together with this one",
    "all_lanes": "whether c holds for all active elements that run together with this one",
    "lane_mask": "the lanes that hold an element; `vectorize` makes it, and a b that has one answer for every lane",
    "lane_any": "whether c holds for one lane at least; `vectorize` makes it, and only of masks",
    "call": "a pure function applied to values; attr: its name",
    "half": "f rounded to the nearest binary16 and kept as f: how h is done where the target has none",
}

MADE_BY_PASSES: Final = frozenset({"lane_mask", "lane_any", "neighbour"})
"""Operations that no program is recorded with."""

LANE_OPS: Final = frozenset({"any_lane", "all_lanes"})
"""Operations that depend on which elements run together: never moved across control flow, never merged."""


@cache
def result_type(op: str, args: tuple[Type, ...]) -> Type:
    """The type that a row of the table gives for these argument types; TypeError if it takes no such types."""
    row = OPS[op]
    bases, _, rest = row.signature.partition(": ")
    pattern, _, result = rest.partition(" -> ")
    wanted = pattern.split()
    typed = _match(wanted, args, _BASES[bases])
    if typed is None:
        given = ", ".join(map(repr, args))
        raise TypeError(f"{op} takes ({', '.join(wanted)}) of {_SPOKEN[bases]}, not ({given})")
    return _instance(result, typed)


def _match(wanted: list[str], args: tuple[Type, ...], bases: frozenset[Base]) -> Type | None:
    if len(wanted) != len(args):
        return None
    typed = next((a for w, a in zip(wanted, args, strict=True) if w[0] in "TV"), None)
    if typed is None or typed.base not in bases:
        return None
    if ("V3" in wanted and typed.size != 3) or ("V" in wanted and typed.size == 1):
        return None
    for letter, given in zip(wanted, args, strict=True):
        if letter == "X":
            if not given.is_int or given.size != typed.size:
                return None
        elif given is not _instance(letter, typed):
            return None
    return typed


def _instance(letter: str, typed: Type) -> Type:
    match letter:
        case "S":
            return typed.scalar
        case "B":
            return typed.based(Base.B)
        case "I":
            return typed.based(Base.I)
        case "U":
            return typed.based(Base.U)
        case "F":
            return typed.based(Base.F)
        case "b":
            return vec(Base.B)
    return typed
