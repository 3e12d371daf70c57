"""Operations at whose edges targets differ, such as the min of a NaN, in terms of what every target has.

Stage: improve and emit. Passes know these operations by their rows in the op table, so a definition is asked for when a
text needs it: as a function of that text. Beside the rows, definitions have four primitives, which C-like targets
spell in a line each: `quot` divides ints that are not at an edge and truncates, `rem` is what it leaves, `bitcast`
keeps the bits, and `whole` converts a float that is in the range of ints.

    edge("min", (f, f))     ->    min(%a.0: f, %b.1: f) { ... %5: f = cond %4, %b.1, %a.0 ... }
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Final

from shpy.ir.builder import Builder
from shpy.ir.nodes import Function
from shpy.ir.types import Base, Type, vec
from shpy.passes.formulas.terms import Term, define, where


def _bitcast(x: Term, base: Base) -> Term:
    return x.op("bitcast", type=x.type.based(base))


def _whole(x: Term, base: Base) -> Term:
    return x.op("whole", type=x.type.based(base))


def minimum(a: Term, b: Term) -> Term:
    """Return the smaller argument; if one is NaN, the other."""
    return where((b < a) | a.differs(a), b, a)


def maximum(a: Term, b: Term) -> Term:
    """Return the greater argument; if one is NaN, the other."""
    return where((a < b) | a.differs(a), b, a)


def clamp(x: Term, low: Term, high: Term) -> Term:
    """Return min(max(x, low), high)."""
    return x.op("max", low).op("min", high)


def absolute(a: Term) -> Term:
    """Return the int without its sign; the least int is its own."""
    return where(a < 0, _negated(a), a)


def _negated(a: Term) -> Term:
    """Return -a, by way of uints: a driver may conclude that the negative of a negative int is positive."""
    return (0 - a.based(Base.U)).based(Base.I)


def sign(x: Term) -> Term:
    """Return the sign of a float; 0 for NaN and both zeros."""
    return (x > 0).based(x.type.base) - (x < 0).based(x.type.base)


def to_int(x: Term) -> Term:
    """Return the float truncated; the nearest int where it is out of range, and 0 for NaN."""
    inside = (x > -(2.0**31)) & (x < 2.0**31)
    whole = _whole(where(inside, x, 0), Base.I)
    outside = where(x >= 2.0**31, whole.constant(2**31 - 1), where(x < 0, whole.constant(-(2**31)), 0))
    return where(inside, whole, outside)


def to_uint(x: Term) -> Term:
    """Return the float truncated; the nearest uint where it is out of range, and 0 for NaN.

    In two halves: a driver may convert through int.
    """
    inside, upper = (x > 0) & (x < 2.0**32), x >= 2.0**31
    half = where(upper, x.constant(2.0**31), 0)
    whole = _whole(where(inside, x - half, 0), Base.I).based(Base.U)
    whole = whole + where(upper, whole.constant(2**31), 0)
    return where(inside, whole, where(x > 0, whole.constant(2**32 - 1), 0))


def floordiv(a: Term, b: Term) -> Term:
    """Return floor(a / b); 0 for b = 0, and the least int for itself by -1."""
    if a.type.base is Base.U:
        return where(b.equals(0), b.constant(0), a.op("quot", b.op("max", b.constant(1)), type=a.type))
    by, rest = _divided(a, b)
    q = a.op("quot", by, type=a.type).named("q")
    q = q - where(_is_below(rest, by), q.constant(1), 0)
    return where(b.equals(0), b.constant(0), where(b.equals(-1), _negated(a), q))


def floormod(a: Term, b: Term) -> Term:
    """Return a - b * floor(a / b), which has b's sign; 0 for b = 0."""
    if a.type.base is Base.U:
        by = b.op("max", b.constant(1)).named("by")
        return where(b.equals(0), b.constant(0), a.op("rem", by, type=a.type))
    by, rest = _divided(a, b)
    return where(_is_below(rest, by), rest + by, rest)


def _divided(a: Term, b: Term) -> tuple[Term, Term]:
    """Return the divisor, 1 at its edges, and what the truncated quotient leaves."""
    by = where(b.equals(0) | b.equals(-1), b.constant(1), b).named("by")
    return by, a.op("rem", by, type=a.type).named("rest")


def _is_below(rest: Term, by: Term) -> Term:
    """Return whether a quotient that was truncated is to be one less."""
    return rest.differs(0) & ((rest ^ by) < 0)


def floordiv_by_doubles(a: Term, b: Term) -> Term:
    """Return floor(a / b), by way of doubles, which are exact enough and have vectors; 0 for b = 0."""
    q = _quotient_of_doubles(a, b)
    q = where(b.equals(-1), _negated(a), q) if a.type.base is Base.I else q
    return where(b.equals(0), b.constant(0), q)


def floormod_by_doubles(a: Term, b: Term) -> Term:
    """Return a - b * floor(a / b), by way of doubles, which are exact enough and have vectors; 0 for b = 0."""
    edge = b.equals(0) | b.equals(-1) if a.type.base is Base.I else b.equals(0)
    return where(edge, a.constant(0), a - b * _quotient_of_doubles(a, b))


def _quotient_of_doubles(a: Term, b: Term) -> Term:
    return _whole((a.based(Base.D) / b.based(Base.D)).op("floor"), a.type.base).named("q")


def popcount(a: Term) -> Term:
    """Count pairs, fours, bytes, and sum the bytes by a product."""
    bits = a.based(Base.U)
    bits = bits - ((bits >> 1) & 0x55555555)
    bits = (bits & 0x33333333) + ((bits >> 2) & 0x33333333)
    return ((((bits + (bits >> 4)) & 0x0F0F0F0F) * 0x01010101) >> 24).based(a.type.base)


def count_leading_zeros(a: Term) -> Term:
    """Make ones of all bits below the highest one bit, and count the others."""
    bits = a.based(Base.U)
    for by in (1, 2, 4, 8, 16):
        bits = bits | (bits >> by)
    return (32 - bits.op("popcount")).based(a.type.base)


def bits_from_float(x: Term) -> Term:
    """Return the bits of x; every NaN gives the same bits."""
    bits = _bitcast(x, Base.U)
    return where(x.differs(x), bits.constant(0x7FC00000), bits)


def isnan(x: Term) -> Term:
    """Return whether x is NaN, by its bits."""
    return (_bitcast(x, Base.U) & 0x7FFFFFFF) > 0x7F800000


def isinf(x: Term) -> Term:
    """Return whether x is infinite, by its bits."""
    return (_bitcast(x, Base.U) & 0x7FFFFFFF).equals(0x7F800000)


def ldexp(x: Term, n: Term) -> Term:
    """Return x * 2^n rounded once: by the bits, but for results that are denormal (one product) or too large."""
    bits = _bitcast(x, Base.U).named("bits")
    denormal = (bits & 0x7F800000).equals(0)
    normal = where(denormal, x * 2.0**24, x).named("normal")
    own = _exponent(normal).named("own")
    e = own - where(denormal, own.constant(24), 0) + _limited(n, -1000, 1000)
    at_e = _bitcast((_bitcast(normal, Base.U) & 0x807FFFFF) | _power(_limited(e, 1, 254)), Base.F).named("at_e")
    small = at_e * _bitcast(_power(_limited(e + 126, 1, 126)), Base.F)
    infinity = _bitcast((bits & 0x80000000) | 0x7F800000, Base.F)
    unchanged = x.equals(0) | own.equals(255)
    return where(unchanged, x, where(e > 254, infinity, where(e < 1, small, at_e)))


def _exponent(x: Term) -> Term:
    """Return the biased exponent."""
    return ((_bitcast(x, Base.U) >> 23) & 255).based(Base.I)


def _power(exponent: Term) -> Term:
    """Return the bits of a power of two, by its biased exponent."""
    return exponent.based(Base.U) << 23


def _limited(n: Term, low: int, high: int) -> Term:
    return n.op("max", n.constant(low)).op("min", n.constant(high))


def half(x: Term) -> Term:
    """Return the nearest binary16, half to even: by the bits, but for halves that are denormal.

    There 2^-24 is the last place.
    """
    bits = _bitcast(x, Base.U).named("bits")
    size = (bits & 0x7FFFFFFF).named("size")
    rounded = ((size + 0xFFF + ((size >> 13) & 1)) & 0xFFFFE000).named("rounded")
    rounded = where(rounded >= 0x47800000, size.constant(0x7F800000), rounded)
    small = _bitcast((_bitcast(size, Base.F) + 0.5) - 0.5, Base.U)
    rounded = where(size > 0x7F800000, size.constant(0x7FC00000), where(size < 0x38800000, small, rounded))
    return _bitcast(rounded | (bits & 0x80000000), Base.F)


def component(v: Term, i: Term) -> Term:
    """Return the component at i, clamped."""
    result = v[v.size - 1]
    for k in range(v.size - 2, -1, -1):
        result = where(i.equals(k) if k else i <= 0, v[k], result)
    return result


DEFINITIONS: Final[Mapping[str, Callable[..., Term]]] = {
    "min": minimum, "max": maximum, "clamp": clamp, "abs": absolute, "sign": sign, "to_int": to_int,
    "to_uint": to_uint, "floordiv": floordiv, "floormod": floormod, "popcount": popcount,
    "count_leading_zeros": count_leading_zeros, "bits_from_float": bits_from_float, "isnan": isnan, "isinf": isinf,
    "ldexp": ldexp, "half": half, "component": component,
}  # fmt: skip
BY_DOUBLES: Final[Mapping[str, Callable[..., Term]]] = {
    "floordiv": floordiv_by_doubles,
    "floormod": floormod_by_doubles,
}
"""Definitions for vectors of a device whose doubles are faster than its division of ints."""


def edge(op: str, types: tuple[Type, ...], *, by_doubles: bool = False) -> Function:
    """Return the pure function that computes `op` for arguments of these types."""
    return _defined(op, _meaning(op, by_doubles), types)


def remark(op: str, *, by_doubles: bool = False) -> str:
    """Return the comment above the function that computes `op`."""
    says = str(_meaning(op, by_doubles).__doc__).splitlines()[0].removeprefix("Return ")
    word = says.partition(" ")[0]
    return f"// {word.capitalize() if len(word) > 1 and word.isalpha() else word}{says[len(word) :]}\n"


def _meaning(op: str, by_doubles: bool) -> Callable[..., Term]:
    return BY_DOUBLES[op] if by_doubles and op in BY_DOUBLES else DEFINITIONS[op]


_defined = cache(define)


@cache
def componentwise(op: str, types: tuple[Type, ...], result: Base) -> Function:
    """Return the pure function that applies `op` to each component of vectors in turn."""
    b = Builder(op)
    b.pure = True
    inputs = [b.input(t, name) for name, t in zip("abc", types, strict=False)]
    size = max(t.size for t in types)
    parts = []
    for k in range(size):
        operands = [b.swizzle(i, (k,)) if i.type.size > 1 else i for i in inputs]
        parts.append(b.let(op, *operands, type=vec(result)))
    b.store(b.output(vec(result, size), "result"), b.let("construct", *parts, type=vec(result, size)))
    return b.finish()
