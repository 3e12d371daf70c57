"""What composite operations and transcendentals mean, written as plain operations: the library that `lower` calls.

Stage: improve. `definition("reflect", (f3, f3))` gives the pure function

    reflect3(i : f3, n : f3) -> f3 { i - 2.0 * dot(n, i) * n }

The order of operations is exactly that of `ir/meaning.py`, so that every target gives the same bits. Definitions may
use other composites; `lower` lowers those in turn. A definition's parameter names are those of the emitted function.
Transcendentals are those of `strict`, which is imported when the first one is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, reduce

from shpy.ir.meaning import RANGES
from shpy.ir.nodes import Function, Module
from shpy.ir.ops import TRANSCENDENTALS
from shpy.ir.types import Base, Type
from shpy.passes.names import fresh
from shpy.passes.terms import Term, define, where

__all__ = ["BOUNDED", "CORRECTABLE", "DEFINITIONS", "INLINE", "PARTS", "Library", "definition"]


def _mad(a: Term, b: Term, c: Term) -> Term:
    return a * b + c


def _rsqrt(x: Term) -> Term:
    return 1 / x.op("sqrt")


def _fract(x: Term) -> Term:
    return x - x.op("floor")


def _clamp(x: Term, low: Term, high: Term) -> Term:
    return x.op("max", low).op("min", high)


def _step(edge: Term, x: Term) -> Term:
    return where(x < edge, x.constant(0), x.constant(1))


def _mod(x: Term, y: Term) -> Term:
    quotient = (x / y).op("floor").named("quotient")
    # A negative quotient that is flushed to zero, or too small for a number, is -1 all the same.
    below = quotient.op("eq", 0) & x.op("ne", 0) & (x < 0).op("ne", y < 0) & y.op("isinf").op("not")
    return x - y * where(below, y.constant(-1), quotient)


def _mix(a: Term, b: Term, t: Term) -> Term:
    return a * (1 - t) + b * t


def _smoothstep(a: Term, b: Term, x: Term) -> Term:
    t = ((x - a) / (b - a)).op("clamp", 0, 1).named("t")
    curve = t * t * (3 - 2 * t)
    return where(a.op("eq", b), a.op("step", x), curve)


def _dot(a: Term, b: Term) -> Term:
    total = a[0] * b[0]
    for k in range(1, a.type.size):
        total = total + a[k] * b[k]
    return total


def _cross(a: Term, b: Term) -> Term:
    return a.pick(1, 2, 0) * b.pick(2, 0, 1) - a.pick(2, 0, 1) * b.pick(1, 2, 0)


def _scales(v: Term) -> tuple[Term, Term]:
    """By what v can be squared, a power of two, and what undoes it: 1 but for very large and very small vectors."""
    low, high, factor = RANGES["d" if v.type.base is Base.D else "f"]
    sizes = [v[k].op("abs") for k in range(v.type.size)]
    largest = reduce(lambda a, b: where(a < b, b, a), sizes).named("largest")  # of NaN nothing comes but NaN
    one, up, down = v[0].constant(1), v[0].constant(factor), v[0].constant(1 / factor)
    large, small = largest > high, largest < low
    return where(large, down, where(small, up, one)), where(large, up, where(small, down, one))


def _length(v: Term) -> Term:
    scale, back = _scales(v)
    scaled = (v * scale).named("scaled")
    return scaled.op("dot", scaled).op("sqrt") * back


def _distance(a: Term, b: Term) -> Term:
    return (a - b).op("length")


def _normalize(v: Term) -> Term:
    scaled = (v * _scales(v)[0]).named("scaled")
    size = scaled.op("dot", scaled).op("sqrt").named("size")
    return where(size > 0, scaled / where(size > 0, size, size.constant(1)), v.constant(0))


def _reflect(i: Term, n: Term) -> Term:
    return i - 2 * n.op("dot", i) * n


def _refract(i: Term, n: Term, eta: Term) -> Term:
    cosine = n.op("dot", i).named("cosine")
    k = (1 - eta * eta * (1 - cosine * cosine)).named("k")
    bent = eta * i - (eta * cosine + k.op("sqrt")) * n
    return where(k < 0, i.constant(0), bent)


def _faceforward(n: Term, i: Term, reference: Term) -> Term:
    return where(reference.op("dot", i) < 0, n, -n)


def _odd(x: Term, error: Term) -> Term:
    """The sum x + error rounded to odd, where x is that sum rounded to nearest (Boldo and Melquiond 2008)."""
    bits = x.op("bits_from_float")
    away = (error > 0).op("eq", x > 0)
    up, down = bits + 1, bits - 1
    inexact = (error.op("ne", 0)) & (bits & bits.constant(1)).op("eq", 0) & (x.op("abs") > 0)
    finite = x.op("isinf").op("not") & error.op("isnan").op("not")
    return where(inexact & finite, where(away, up, down).op("float_from_bits"), x)


def _half_fma(a: Term, b: Term, c: Term) -> Term:
    """The sum a * b + c of binary16 numbers, rounded once: the product is exact in binary32, the sum rounds to odd."""
    product = (a * b).named("product")
    total = (product + c).named("total")
    back = (total - product).named("back")
    error = (product - (total - back)) + (c - back)
    return _odd(total, error).op("half", type=a.type)


def _half_from_double(x: Term) -> Term:
    """A binary64 rounded once to binary16, by way of binary32 rounded to odd."""
    narrow = x.op("convert", type=x.type.based(Base.F)).named("narrow")
    error = (x - narrow.op("convert", type=x.type)).op("convert", type=narrow.type)
    return _odd(narrow, error).op("half", type=narrow.type)


DEFINITIONS: dict[str, Callable[..., Term]] = {
    "mad": _mad,
    "rsqrt": _rsqrt,
    "fract": _fract,
    "clamp": _clamp,
    "step": _step,
    "mod": _mod,
    "mix": _mix,
    "smoothstep": _smoothstep,
    "dot": _dot,
    "cross": _cross,
    "length": _length,
    "distance": _distance,
    "normalize": _normalize,
    "reflect": _reflect,
    "refract": _refract,
    "faceforward": _faceforward,
}
"""The composite operations of the table."""

_ROUNDINGS: dict[str, Callable[..., Term]] = {"half_fma": _half_fma, "half_from_double": _half_from_double}
"""What `lower_half` needs besides."""

PARTS = frozenset({"payne_hanek", "sin_strict", "cos_strict", "tan_strict"})
"""Operations that only definitions have: functions that these share."""

BOUNDED = {name: f"{name}_bounded" for name in ("sin", "cos", "tan")}
"""What becomes of functions that a target has within the bounds for angles that are not far only."""

CORRECTABLE = frozenset({"div", "sqrt", "fma", "convert_nan"})
"""Operations of binary32 that `strict/arithmetic.py` corrects for devices that round them wrong or have none.

"convert_nan" is the conversion of a float to an int where it gives anything but 0 for a NaN; `lower` corrects it.
"""

INLINE = frozenset({"mad", "rsqrt", "fract", "clamp", "step"})
"""Those that are short enough to stand where they are used."""


@cache
def definition(name: str, types: tuple[Type, ...]) -> Function:
    """The pure function that does `name` for arguments of these types: `dot3`, `sin_strict`, `sin_strict_d2`."""
    first = types[0]
    if name in PARTS or name in BOUNDED.values():
        return _part(name, types)
    if name in TRANSCENDENTALS:
        from shpy.passes.strict import FUNCTIONS

        base = "_d" if first.base is Base.D else ""
        return define(f"{name}_strict{base}{first.size if first.size > 1 else ''}", FUNCTIONS[name], types)
    if name in CORRECTABLE:
        from shpy.passes.strict.arithmetic import CORRECTED

        return define(f"{name}_corrected{first.size if first.size > 1 else ''}", CORRECTED[name], types)
    suffix = "d" if first.base is Base.D and name in DEFINITIONS else ""
    return define(f"{name}{first.size}{suffix}", DEFINITIONS.get(name) or _ROUNDINGS[name], types)


def _part(name: str, types: tuple[Type, ...]) -> Function:
    """What only definitions and `lower` ask for."""
    from shpy.passes.strict import payne_hanek

    function, _, which = name.partition("_")
    if which == "strict":
        return definition(function, types)
    base = "_d" if types[0].base is Base.D else ""
    if which == "bounded":
        size = types[0].size
        return define(f"{name}{base}{size if size > 1 else ''}", payne_hanek.BOUNDED[function], types)
    return define(f"{name}{base}", payne_hanek.payne_hanek, types)


class Library:
    """The definitions that a module uses, as functions whose names differ from the module's own."""

    def __init__(self, module: Module) -> None:
        self.module = module
        self.taken = {f.name for f in module.functions}
        self.functions: dict[Function, Function] = {}

    def use(
        self, name: str, types: tuple[Type, ...], prepare: Callable[[Function], Function] | None = None
    ) -> Function:
        """The function that does `name` for these types; `prepare` is applied to it once, and may use others."""
        original = definition(name, types)
        if original not in self.functions:
            function = prepare(original) if prepare else original
            self.functions[original] = replace(function, name=fresh(function.name, self.taken))
        return self.functions[original]

    def added(self, module: Module) -> Module:
        """The module with what was used in front of its own functions, callees first."""
        return replace(module, functions=(*self.functions.values(), *module.functions))
