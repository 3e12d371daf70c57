"""The exponential function by way of binary64.

Stage: improve. e to the x is 2**k times e to the r with |r| at most half of ln 2, and that a polynomial.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.types import Base
from shpy.passes.exact.coefficients import EXP, EXP2, LN2
from shpy.passes.exact.parts import horner
from shpy.passes.strict.parts import MAGIC
from shpy.passes.terms import Term, where

_ENDS: Final = (-105.0, 90.0)
"""Limits beyond which e to the x is 0 or infinite in binary32."""


def exp(x: Term) -> Term:
    """E to the x."""
    low, high = _ENDS
    near = where(x > high, high, where(x < low, low, x)).named("near")
    shifted = (near * 1.442695 + MAGIC[Base.F]).named("shifted")
    k = (shifted - MAGIC[Base.F]).based(Base.D).named("k")
    ln2, ln2_low = LN2
    r = k.mul_add(-ln2_low, k.mul_add(-ln2, near.based(Base.D))).named("r")
    return times_power(horner(r, EXP), shifted)


def exp2(x: Term) -> Term:
    """2 to the x."""
    near = where(x > 130.0, 130.0, where(x < -152.0, -152.0, x)).named("near")
    shifted = (near + MAGIC[Base.F]).named("shifted")
    r = (near - (shifted - MAGIC[Base.F])).based(Base.D).named("r")
    return times_power(horner(r, EXP2), shifted)


def times_power(y: Term, shifted: Term) -> Term:
    """Return the binary64 y * 2**k for a binary32 `shifted` of k + MAGIC, |k| at most 250: by two binary32 powers."""
    bits = shifted.op("bits_from_float").named("bits")
    half = (bits >> 1).named("half")
    return y * _power(half) * _power(bits - half)


def _power(n: Term) -> Term:
    """Return the binary64 2**n of a uint's low bits: those of MAGIC leave on the left."""
    return ((n + 127) << 23).op("float_from_bits").based(Base.D).named("power")
