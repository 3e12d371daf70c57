"""The table of operations: arity, types, exact meaning at the edges, and how close a target must come.

Stage: represent. `lang` and the verifier ask `result_type`, the interpreter and constant folding execute `meaning`,
the tests run every row on every backend, and docs/numerics.md prints the table.

A signature reads `bases: arguments -> result`. Bases: `f` floats, `i` ints, `u` only u, `b` only b, `n` floats and
ints, `w` ints and b, `a` any. Arguments: `T` one type of those bases for all T, `S` its scalar, `V` T with size >= 2,
`V3` T of size 3, `B` b of T's size, `I` i of T's size, `X` any int type of T's size, `b` scalar b, `U` u of T's size,
`F` f of T's size.

>>> result_type("dot", (vec("f", 3), vec("f", 3)))
f
>>> result_type("add", (vec("f"), vec("i")))
Traceback (most recent call last):
TypeError: add takes (T, T) of floats or ints, not (f, i)
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Final

import numpy as np

from shpy.ir import exact, meaning as m
from shpy.ir.tangents import TANGENTS, Rule
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
    """The bound of a result's error: `ulp` units in the last place or `absolute`, whichever is more."""

    ulp: float = 0.0
    absolute: float = 0.0


@cache
def _letters(signature: str) -> tuple[str, ...]:
    return tuple(signature.partition(": ")[2].partition(" -> ")[0].split())


@dataclass(frozen=True, slots=True)
class Op:
    """One row. `meaning` takes and gives arrays (see `meaning.py`).

    `tolerance` is how far it may be off at f32 in strict mode, `portable` in portable mode, where all targets give the
    same bits in each, and `relaxed` in relaxed mode; `double` in strict mode at f64. Fast mode promises nothing.

    `definition` expresses a composite operation by others (see `formula.py`); `inline`: it is short enough
    to stand where it is used. `componentwise`: each component of the result depends on that component of the operands
    alone. `commutative`: operands may change places without changing a bit, save those of a NaN. `exact`: of binary16
    numbers it gives a binary16 without rounding.

    `tangent` is the rule by which it is differentiated (see `tangents.py`); None where the result has no derivative.

    `says` is the docstring of the function that users call, "" where an operator of Python is all they have;
    `parameters` are its names.
    """

    name: str
    signature: str
    meaning: Callable[..., Any]
    doc: str
    says: str = ""
    parameters: tuple[str, ...] = ()
    symbol: str | None = None
    tolerance: Tolerance = Tolerance()
    portable: Tolerance = Tolerance()
    relaxed: Tolerance = Tolerance()
    double: Tolerance = Tolerance()
    definition: Callable[..., Any] | None = None
    inline: bool = False
    componentwise: bool = True
    commutative: bool = False
    exact: bool = False
    tangent: Rule | None = None

    def bound(self, math: str) -> Tolerance:
        """Return the error that is allowed at f32 in "strict", "portable" or "relaxed" mode."""
        return {"strict": self.tolerance, "portable": self.portable, "relaxed": self.relaxed}[math]

    def distance(self, math: str) -> float:
        """Return how many units in the last place a result may lie from the exact value: half of one at least.

        Distances are measured to a reference in binary64, which is rounded itself: 2**-20 more is allowed.
        """
        return max(self.bound(math).ulp, 0.5 * (1 + 2**-20))

    @property
    def bases(self) -> frozenset[Base]:
        """The bases of T."""
        return _BASES[self.signature[0]]

    @property
    def takes(self) -> tuple[str, ...]:
        """The type letter of each argument, for example `("T", "T", "S")`."""
        return _letters(self.signature)

    @property
    def gives(self) -> str:
        """The letter of the result."""
        return self.signature.rpartition(" ")[2]

    def arguments(self, typed: Type, count: Base = Base.I) -> tuple[Type, ...] | None:
        """Return the types of the arguments where T is `typed`; `count` is the base of X. None if T cannot be that."""
        types = tuple(typed.based(count) if letter == "X" else _instance(letter, typed) for letter in self.takes)
        return types if _match(self.takes, types, self.bases) else None

    @property
    def function(self) -> Callable[..., Any]:
        """The function on arrays without the rounding of its result: one of numpy, of `meaning.py`, or a lambda."""
        whole: Callable[..., Any] = inspect.unwrap(self.meaning)
        return whole


OPS: Final[dict[str, Op]] = {}


def _op(name: str, signature: str, meaning: Callable[..., Any], doc: str, says: str = "", **traits: Any) -> None:
    """Add a row; `parameters` are written in one string."""
    parameters = tuple(str(traits.pop("parameters", "x" if says else "")).split())
    OPS[name] = Op(name, signature, meaning, doc, says, parameters, tangent=TANGENTS.get(name), **traits)


def _composite(
    signature: str,
    definition: Callable[..., Any],
    doc: str,
    *,
    exact: bool = False,
    once: bool = True,
    **traits: Any,
) -> None:
    """Add the row of an operation that others define: its definition gives the name, the parameters and `says`.

    `once`: of binary16 it is computed in binary32 and rounded once; otherwise each of its operations is rounded.
    """
    parameters = " ".join(inspect.signature(definition).parameters)
    traits = {"definition": inspect.unwrap(definition), "parameters": parameters, "exact": exact, **traits}
    meaning = m.in_f32(definition) if once else definition
    _op(definition.__name__, signature, meaning, doc, str(definition.__doc__), **traits)


_geometry = partial(_composite, componentwise=False)

# Arithmetic
_op("neg", "n: T -> T", np.negative, "minus x; ints wrap", symbol="-", exact=True)
_op("add", "n: T T -> T", m.in_f32(np.add), "ints wrap", symbol="+", commutative=True)
_op("sub", "n: T T -> T", m.in_f32(np.subtract), "ints wrap", symbol="-")
_op("mul", "n: T T -> T", m.in_f32(np.multiply), "ints wrap", symbol="*", commutative=True)
_op("div", "f: T T -> T", m.in_f32(np.divide), "correctly rounded", symbol="/")
_op("floordiv", "i: T T -> T", m.floor_div_int, "floor(a / b); 0 for b = 0; INT_MIN // -1 is INT_MIN")
_op("floormod", "i: T T -> T", m.floor_mod_int, "a - b * floor(a / b), sign of b; 0 for b = 0")
_op("fma", "f: T T T -> T", m.fma, "a * b + c rounded once", "Return a * b + c, rounded once.", parameters="a b c")
_composite("f: T T T -> T", m.mad, "a * b + c rounded twice", inline=True, once=False)
# Bits
_op("and", "w: T T -> T", np.bitwise_and, "", symbol="&", commutative=True)
_op("or", "w: T T -> T", np.bitwise_or, "", symbol="|", commutative=True)
_op("xor", "w: T T -> T", np.bitwise_xor, "", symbol="^", commutative=True)
_op("not", "w: T -> T", np.invert, "", symbol="~")
_op("shl", "i: T X -> T", m.shift_left, "by n mod 32", symbol="<<")
_op("shr", "i: T X -> T", m.shift_right, "by n mod 32; arithmetic for i", symbol=">>")
_composite("i: T T -> T", m.mulhi, "the upper half of the product of 64 bits", commutative=True)
_composite("i: T X -> T", m.rotl, "by n mod 32")
_composite("i: T X -> T", m.rotr, "by n mod 32")
_op("popcount", "i: T -> T", m.popcount, "number of one bits", "Count the one bits, component-wise.")
_op("count_leading_zeros", "i: T -> T", m.count_leading_zeros, "number of zero bits above the highest one; 32 for 0",
    "Count the zero bits above the highest one bit, component-wise; 32 for 0.")  # fmt: skip
# Comparison
_op("eq", "a: T T -> B", np.equal, "NaN equals nothing", symbol="==", commutative=True)
_op("ne", "a: T T -> B", np.not_equal, "NaN differs from everything", symbol="!=", commutative=True)
_op("lt", "n: T T -> B", np.less, "false with a NaN", symbol="<")
_op("le", "n: T T -> B", np.less_equal, "false with a NaN", symbol="<=")
_op("gt", "n: T T -> B", np.greater, "false with a NaN", symbol=">")
_op("ge", "n: T T -> B", np.greater_equal, "false with a NaN", symbol=">=")
_op("isnan", "f: T -> B", np.isnan, "", "Tell whether x is NaN, component-wise.")
_op("isinf", "f: T -> B", np.isinf, "", "Tell whether x is infinite, component-wise.")
_op("any", "b: T -> b", m.any_component, "one component holds", "Tell whether one component of a bool holds.",
    parameters="c", componentwise=False)  # fmt: skip
_op("all", "b: T -> b", m.all_components, "every component holds", "Tell whether every component of a bool holds.",
    parameters="c", componentwise=False)  # fmt: skip
_op("cond", "a: B T T -> T", m.select, "a where c holds, else b; both are evaluated",
    "Return a where c holds, else b, component by component over a bool c; both are evaluated.",
    parameters="c a b", exact=True)  # fmt: skip
# Common functions
_op("abs", "n: T -> T", np.abs, "abs(INT_MIN) is INT_MIN", "Return |x|, component-wise; ints too.", exact=True)
_op("sign", "n: T -> T", m.sign, "sign(NaN) and sign(-0) are 0",
    "Return -1, 0 or 1, component-wise; 0 for NaN and both zeros; ints too.", exact=True)  # fmt: skip
_op("floor", "f: T -> T", np.floor, "", "Return the largest whole number that is not above x.", exact=True)
_op("ceil", "f: T -> T", np.ceil, "", "Return the smallest whole number that is not below x.", exact=True)
_op("round", "f: T -> T", np.rint, "half to even", "Return the nearest whole number, halves to even.", exact=True)
_op("trunc", "f: T -> T", np.trunc, "", "Return x without its fraction.", exact=True)
_composite("f: T -> T", m.fract, "x - floor(x)", inline=True)
_composite("f: T T -> T", m.mod, "x - y * floor(x / y)")
_op("min", "n: T T -> T", m.minimum, "the number where one is NaN",
    "Return the smallest of two or more, component-wise; a NaN gives way to a number; ints too.",
    parameters="*args", exact=True)  # fmt: skip
_op("max", "n: T T -> T", m.maximum, "the number where one is NaN",
    "Return the largest of two or more, component-wise; a NaN gives way to a number; ints too.",
    parameters="*args", exact=True)  # fmt: skip
_composite("n: T T T -> T", m.clamp, "min(max(x, low), high)", inline=True, exact=True)
_composite("f: T T T -> T", m.mix, "a * (1 - t) + b * t")
_composite("f: T T -> T", m.step, "0 where x < edge, else 1", inline=True, exact=True)
_composite("f: T T T -> T", m.smoothstep, "step(a, x) where a = b")
_composite(
    "f: T T T -> T",
    m.smootherstep,
    "6t^5 - 15t^4 + 10t^3 of t = clamp((x - a) / (b - a), 0, 1); step(a, x) where a = b",
)
_op("sqrt", "f: T -> T", m.in_f32(np.sqrt), "correctly rounded", "Return the square root, correctly rounded.")
_op("ldexp", "f: T I -> T", m.ldexp, "x * 2**n rounded once",
    "Return x * 2**n, rounded once; n of type i.", parameters="x n")  # fmt: skip
_op("bits_from_float", "f: T -> U", m.bits_from_float, "binary32 bits; 0x7fc00000 for every NaN",
    "Return the bits of the binary32 as u; 0x7fc00000 for every NaN.")  # fmt: skip
_op("float_from_bits", "u: T -> F", m.float_from_bits, "the binary32 with these bits",
    "Return the binary32 with these bits of a u.", parameters="u")  # fmt: skip
_op("unit_float", "u: T -> F", m.unit_float, "(u >> 8) * 2**-24; of binary16 (u >> 21) * 2**-11",
    "Return a float in [0, 1) from the upper 24 bits of a u: (u >> 8) * 2**-24; at f16 from the upper 11 bits.",
    parameters="u")  # fmt: skip
# Geometry
_geometry("f: T T -> S", m.dot, "summed from the first component on", commutative=True)
_geometry("f: V3 V3 -> V3", m.cross, "")
_geometry("f: T -> S", m.length, "sqrt(dot(v, v)), scaled where squares would overflow or vanish")
_geometry("f: T T -> S", m.distance, "length(a - b)")
_geometry("f: T -> T", m.normalize, "v / length(v); 0 for the zero vector")
_geometry("f: T T -> T", m.reflect, "i - 2 * dot(n, i) * n")
_geometry("f: T T S -> T", m.refract, "GLSL 4.60 section 8.5; 0 at total reflection")
_geometry("f: T T T -> T", m.faceforward, "n where dot(reference, i) < 0, else -n", exact=True)


# Transcendentals: in strict mode the formulas of `passes/formulas/strict`, correctly rounded; in portable mode those of
# `passes/formulas/portable`; in relaxed mode the target's own within the bounds of OpenCL's full profile (OpenCL C 3.0
# section 7.4), or those of portable mode where the target has none that keep them. The numbers bound portable and
# relaxed mode, and f64.
def _transcendental(
    name: str,
    meaning: Callable[..., Any],
    portable: float,
    relaxed: float,
    double: float,
    says: str,
    parameters: str = "x",
    strict: float = 0,
) -> None:
    bounds = {
        "tolerance": Tolerance(strict),
        "portable": Tolerance(portable),
        "relaxed": Tolerance(relaxed),
        "double": Tolerance(double),
    }
    signature = f"f: {' '.join('T' for _ in parameters.split())} -> T"
    _op(name, signature, meaning, "", says, parameters=parameters, **bounds)


_transcendental("exp", exact.exp, 1, 3, 1, "Return e to the power of x.")
_transcendental("exp2", exact.exp2, 1, 3, 1, "Return 2 to the power of x.")
_transcendental("rsqrt", exact.rsqrt, 1.5, 2, 1.5, "Return 1 / sqrt(x).")
_transcendental("log", exact.log, 1, 3, 1, "Return the natural logarithm.")
_transcendental("log2", exact.log2, 1, 3, 1, "Return the logarithm to base 2.")
_transcendental("log10", exact.log10, 1, 3, 1, "Return the logarithm to base 10: a whole number for each power of ten.")
_transcendental("sin", exact.sin, 1, 4, 1.25, "Return the sine of x radians.")
_transcendental("cos", exact.cos, 1, 4, 1.25, "Return the cosine of x radians.")
_transcendental("tan", exact.tan, 1.5, 5, 1.5, "Return the tangent of x radians.")
_transcendental("asin", exact.asin, 1, 4, 1, "Return the arc sine, in radians.")
_transcendental("acos", exact.acos, 1, 4, 1, "Return the arc cosine, in radians.")
_transcendental(
    "atan", exact.atan, 1, 5, 1, "Return the arc tangent of y in radians; with two arguments, atan2(y, x).", "y"
)
_transcendental("sinh", exact.sinh, 1, 4, 1, "Return the hyperbolic sine.")
_transcendental("cosh", exact.cosh, 1, 4, 1, "Return the hyperbolic cosine.")
_transcendental("tanh", exact.tanh, 1.5, 5, 1.5, "Return the hyperbolic tangent.")
_transcendental("asinh", exact.asinh, 1.5, 4, 1.25, "Return the inverse hyperbolic sine.")
_transcendental("acosh", exact.acosh, 1.5, 4, 1.25, "Return the inverse hyperbolic cosine.")
_transcendental("atanh", exact.atanh, 1.5, 5, 1.25, "Return the inverse hyperbolic tangent.")
_transcendental("expm1", exact.expm1, 1.5, 3, 1, "Return e to the power of x, less 1, without cancellation near 0.")
_transcendental("log1p", exact.log1p, 1, 2, 1, "Return the natural logarithm of 1 + x, without cancellation near 0.")
_transcendental("exp10", exact.exp10, 1, 3, 1, "Return 10 to the power of x.")
_transcendental("cbrt", exact.cbrt, 1, 2, 1, "Return the cube root; negative for a negative x.")
_transcendental(
    "erf",
    exact.erf,
    1.5,
    16,
    1.5,
    "Return the error function, 2 / sqrt(pi) times the integral of exp(-t * t) from 0 to x.",
)
_transcendental("erfc", exact.erfc, 5, 16, 5, "Return 1 - erf(x), without cancellation where x is large.")
_transcendental("sinpi", exact.sinpi, 1, 4, 1, "Return the sine of pi * x; 0 for whole numbers, with the sign of x.")
_transcendental("cospi", exact.cospi, 1, 4, 1, "Return the cosine of pi * x; 0 for halves of odd numbers.")
_NEARLY = 0.5000001
"""The error of a value that is rounded to binary64 first."""
_pow = "Raise x to the power of y; 1 for two zeros; a negative x takes a whole y (C99)."
_transcendental("pow", m.through_f64(m.power), 1, 16, 1, _pow, "x y", _NEARLY)
_atan2 = "Return the angle of the point (x, y) in radians, -pi to pi, quadrants and signed zeros as in C99."
_hypot = "Return sqrt(x * x + y * y), where no square overflows or vanishes; infinite beside NaN too (C99)."
_transcendental("hypot", exact.hypot, 1, 4, 1, _hypot, "x y")
_transcendental("atan2", m.through_f64(np.arctan2), 1, 6, 1, _atan2, "y x", _NEARLY)

TRANSCENDENTALS: Final = frozenset(name for name, op in OPS.items() if op.relaxed.ulp)
"""The operations that no target is asked to do correctly rounded."""

COMPOSITES: Final = frozenset(name for name, op in OPS.items() if op.definition)
"""The operations that others define."""

COMMUTATIVE: Final = frozenset(name for name, op in OPS.items() if op.commutative)
"""The operations whose operands may change places."""

# Structural operations: the verifier has their types, the interpreter their meaning.
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
    "grid_line": "grid_index without the last axis, i to i3, where all lanes are in one line; `lines` makes it",
    "grid_shape": "the number of elements along numpy's axes: i to i4",
    "any_lane": "whether c holds for any active element that runs together with this one",
    "all_lanes": "whether c holds for all active elements that run together with this one",
    "min_lane": "the least x of all active elements that run together with this one; a NaN may count or not",
    "max_lane": "the greatest x of all active elements that run together with this one; a NaN may count or not",
    "lane_mask": "the lanes that hold an element; `vectorize` makes it, and a b that has one answer for every lane",
    "lane_any": "whether c holds for one lane at least; `vectorize` makes it, and only of masks",
    "lane_min": "the least x of all lanes; `vectorize` makes it",
    "lane_max": "the greatest x of all lanes; `vectorize` makes it",
    "call": "a pure function applied to values; attr: its name",
    "half": "f rounded to the nearest binary16 and kept as f: how h is done where the target has none",
}

MADE_BY_PASSES: Final = frozenset({"lane_mask", "lane_any", "lane_min", "lane_max", "neighbour", "grid_line"})
"""Operations that no program is recorded with."""

LANE_OPS: Final = frozenset({"any_lane", "all_lanes", "min_lane", "max_lane"})
"""Operations that depend on which elements run together: never moved across control flow, never merged."""


@cache
def result_type(op: str, args: tuple[Type, ...]) -> Type:
    """Return the type that a row of the table gives for these argument types; TypeError if it takes no such types."""
    row = OPS[op]
    typed = _match(row.takes, args, row.bases)
    if typed is None:
        types = ", ".join(map(repr, args))
        raise TypeError(f"{op} takes ({', '.join(row.takes)}) of {_SPOKEN[row.signature[0]]}, not ({types})")
    return _instance(row.gives, typed)


def _match(letters: tuple[str, ...], args: tuple[Type, ...], bases: frozenset[Base]) -> Type | None:
    if len(letters) != len(args):
        return None
    typed = next((a for w, a in zip(letters, args, strict=True) if w[0] in "TV"), None)
    if typed is None or typed.base not in bases:
        return None
    if ("V3" in letters and typed.size != 3) or ("V" in letters and typed.size == 1):
        return None
    for letter, arg in zip(letters, args, strict=True):
        if letter == "X":
            if not arg.is_int or arg.size != typed.size:
                return None
        elif arg is not _instance(letter, typed):
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
