"""The exponential function by way of binary64.

Stage: improve. e to the x is 2**k times e to the r with |r| at most half of ln 2, and that a polynomial.
"""

from __future__ import annotations

import math
from typing import Final

from shpy.ir.types import Base
from shpy.passes.exact.coefficients import EXP, EXP2, LN2
from shpy.passes.exact.parts import horner
from shpy.passes.strict.parts import MAGIC
from shpy.passes.terms import Term, replaced, where

_NEAR: Final = 126
"""Up to this in size, an exponent of two is that of one binary32."""


def exp(x: Term) -> Term:
    """E to the x."""
    shifted = (x * 1.442695 + MAGIC[Base.F]).named("shifted")
    k = (shifted - MAGIC[Base.F]).based(Base.D).named("k")
    ln2, ln2_low = LN2
    r = k.mul_add(-ln2_low, k.mul_add(-ln2, x.based(Base.D))).named("r")
    return _scaled(x, horner(r, EXP), shifted, _NEAR * 0.693, (-105.0, 90.0))


def exp2(x: Term) -> Term:
    """2 to the x."""
    shifted = (x + MAGIC[Base.F]).named("shifted")
    r = (x - (shifted - MAGIC[Base.F])).based(Base.D).named("r")
    return _scaled(x, horner(r, EXP2), shifted, _NEAR, (-152.0, 130.0))


def _scaled(x: Term, y: Term, shifted: Term, near: float, ends: tuple[float, float]) -> Term:
    """Return y * 2**k for `shifted`, which is k + MAGIC; beyond the ends of x it is 0 or infinite."""
    low, high = ends
    result = (y * _power(shifted.op("bits_from_float"))).based(Base.F)

    def far() -> list[Term]:
        inside = times_power(y, shifted).based(Base.F)
        return [where(x > high, math.inf, where(x < low, 0.0, inside))]

    return replaced((abs(x) > near).named("far"), {"result": result}, far)[0]


def times_power(y: Term, shifted: Term) -> Term:
    """Return the binary64 y * 2**k for a binary32 `shifted` of k + MAGIC, |k| at most 250: by two binary32 powers."""
    bits = shifted.op("bits_from_float").named("bits")
    half = (bits >> 1).named("half")
    return y * _power(half) * _power(bits - half)


def _power(n: Term) -> Term:
    """Return the binary64 2**n of a uint's low bits: those of MAGIC leave on the left."""
    return ((n + 127) << 23).op("float_from_bits").based(Base.D).named("power")
