"""The exponential function by way of binary64.

Stage: improve. e to the x is 2**k times e to the r with |r| at most half of ln 2, and that a polynomial.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from shpy.ir.types import Base
from shpy.passes.exact.coefficients import EXP, EXP2, LN2
from shpy.passes.exact.parts import horner
from shpy.passes.strict.parts import MAGIC
from shpy.passes.terms import Term, replaced, where

Pair = tuple[Term, Term]

_NEAR: Final = 126
"""Up to this in size, an exponent of two is that of one binary32."""


def exp(x: Term) -> Term:
    """E to the x."""

    def parts(x: Term) -> Pair:
        shifted = (x * 1.442695 + MAGIC[Base.F]).named("shifted")
        k = (shifted - MAGIC[Base.F]).based(Base.D).named("k")
        ln2, ln2_low = LN2
        return horner(k.mul_add(-ln2_low, k.mul_add(-ln2, x.based(Base.D))).named("r"), EXP), shifted

    return _power_of(x, parts, _NEAR * 0.693, (-105.0, 90.0))


def exp2(x: Term) -> Term:
    """2 to the x."""

    def parts(x: Term) -> Pair:
        shifted = (x + MAGIC[Base.F]).named("shifted")
        return horner((x - (shifted - MAGIC[Base.F])).based(Base.D).named("r"), EXP2), shifted

    return _power_of(x, parts, _NEAR, (-152.0, 130.0))


def _power_of(x: Term, parts: Callable[[Term], Pair], near: float, ends: tuple[float, float]) -> Term:
    """Return y * 2**k for the (y, k + MAGIC) that `parts` gives of x; beyond the ends it is 0 or infinite."""
    y, shifted = parts(x)
    result = (y * _power(shifted.op("bits_from_float"))).based(Base.F).named("result")

    def far() -> list[Term]:
        low, high = ends
        return [times_power(*parts(where(x > high, high, where(x < low, low, x)).named("bounded"))).based(Base.F)]

    return replaced((abs(x) > near).named("far"), {"result": result}, far)[0]


def times_power(y: Term, shifted: Term) -> Term:
    """Return the binary64 y * 2**k for a binary32 `shifted` of k + MAGIC, |k| at most 250: by two binary32 powers."""
    bits = shifted.op("bits_from_float").named("bits")
    half = (bits >> 1).named("half")
    return y * _power(half) * _power(bits - half)


def _power(n: Term) -> Term:
    """Return the binary64 2**n of a uint's low bits: those of MAGIC leave on the left."""
    return ((n + 127) << 23).op("float_from_bits").based(Base.D).named("power")
