"""The exponential function by way of binary64.

Stage: improve. e to the x is 4**k times e to the r with |r| at most ln 2. Both are squares: of 2**k, which is a normal
binary32, and of e to the r / 2, a polynomial. Binary64 holds all results, also those that are too large for binary32.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.types import Base
from shpy.passes.exact.coefficients import LN2, ROOT_OF_EXP, ROOT_OF_EXP2
from shpy.passes.exact.parts import horner
from shpy.passes.strict.parts import MAGIC
from shpy.passes.terms import Term, where

_EVEN_MAGIC: Final = 2 * MAGIC[Base.F]
"""A sum with it is rounded to an even whole number, half of which its low bits hold."""


def exp(x: Term) -> Term:
    """E to the x: 0 or infinite where it is clamped."""
    near = clamped(x, -105.0, 90.0).named("near")
    shifted = (near * 1.442695 + _EVEN_MAGIC).named("shifted")
    k = (shifted - _EVEN_MAGIC).based(Base.D).named("k")
    ln2, ln2_low = LN2
    r = k.mul_add(-ln2_low, k.mul_add(-ln2, near.based(Base.D))).named("r")
    return _squared(horner(r, ROOT_OF_EXP), shifted)


def exp2(x: Term) -> Term:
    """2 to the x: 0 or infinite where it is clamped."""
    near = clamped(x, -152.0, 130.0).named("near")
    shifted = (near + _EVEN_MAGIC).named("shifted")
    r = (near - (shifted - _EVEN_MAGIC)).based(Base.D).named("r")
    return _squared(horner(r, ROOT_OF_EXP2), shifted)


def clamped(x: Term, low: float, high: float) -> Term:
    """Return the number from low to high that is nearest to x; NaN stays."""
    return where(x > high, high, where(x < low, low, x))


def _squared(y: Term, shifted: Term) -> Term:
    """Return (y * 2**k) squared, for `shifted` of 2 k + _EVEN_MAGIC."""
    root = (y * _power(shifted.op("bits_from_float"))).named("root")
    return root * root


def times_power(y: Term, shifted: Term) -> Term:
    """Return the binary64 y * 2**k for a binary32 `shifted` of k + MAGIC, |k| at most 250: by two binary32 powers."""
    bits = shifted.op("bits_from_float").named("bits")
    half = (bits >> 1).named("half")
    return y * _power(half) * _power(bits - half)


def _power(n: Term) -> Term:
    """Return the binary64 2**n of a uint's low bits: those of MAGIC leave on the left."""
    return ((n + 127) << 23).op("float_from_bits").based(Base.D).named("power")
