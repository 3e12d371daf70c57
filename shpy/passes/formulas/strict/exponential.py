"""The exponential function by way of binary64.

Stage: improve. e to the x is 4**k times e to the r with |r| at most ln 2. Both are squares: of 2**k, which is a normal
binary32, and of e to the r / 2, a polynomial. Binary64 holds all results, also those that are too large for binary32.
"""

from __future__ import annotations

import math
from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.coefficients import LOG10_2
from shpy.passes.formulas.parts import MAGIC, horner
from shpy.passes.formulas.strict.coefficients import STRICT_LN2, STRICT_ROOT_OF_EXP, STRICT_ROOT_OF_EXP2
from shpy.passes.formulas.terms import Term, where

_EVEN_MAGIC: Final = 2 * MAGIC[Base.F]
"""The number that, added to a float, rounds it to an even whole number and leaves half of that in the low bits."""


def exp(x: Term) -> Term:
    """Return e to the x; x is clamped to a range outside which the result is 0 or infinite."""
    near = clamped(x, -105.0, 90.0).named("near")
    return exp_of(near, near.based(Base.D))


def exp_of(near: Term, exponent: Term) -> Term:
    """Return e to the power of a binary64 between -105 and 90; `near` is the exponent in binary32."""
    shifted = (near * 1.442695 + _EVEN_MAGIC).named("shifted")
    k = (shifted - _EVEN_MAGIC).based(Base.D).named("k")
    ln2, ln2_low = STRICT_LN2
    r = k.mul_add(-ln2_low, k.mul_add(-ln2, exponent)).named("r")
    return _squared(horner(r, STRICT_ROOT_OF_EXP), shifted)


def exp2(x: Term) -> Term:
    """Return 2 to the x; x is clamped to a range outside which the result is 0 or infinite."""
    near = clamped(x, -152.0, 130.0).named("near")
    shifted = (near + _EVEN_MAGIC).named("shifted")
    r = (near - (shifted - _EVEN_MAGIC)).based(Base.D).named("r")
    return _squared(horner(r, STRICT_ROOT_OF_EXP2), shifted)


def exp10(x: Term) -> Term:
    """Return 10 to the x; x is clamped to a range outside which the result is 0 or infinite."""
    near = clamped(x, -46.0, 39.0).named("near")
    shifted = (near * 3.321928 + _EVEN_MAGIC).named("shifted")
    k = (shifted - _EVEN_MAGIC).based(Base.D).named("k")
    step, step_low = LOG10_2[Base.D]
    r = (k.mul_add(-step_low, k.mul_add(-step, near.based(Base.D))) * math.log(10)).named("r")
    return _squared(horner(r, STRICT_ROOT_OF_EXP), shifted)


def clamped(x: Term, low: float, high: float) -> Term:
    """Return x clamped to [low, high]; NaN stays."""
    return where(x > high, high, where(x < low, low, x))


def _squared(y: Term, shifted: Term) -> Term:
    """Return (y * 2**k) squared, for shifted = 2 k + _EVEN_MAGIC."""
    root = (y * _power(shifted.op("bits_from_float"))).named("root")
    return root * root


def times_power(y: Term, shifted: Term) -> Term:
    """Return the binary64 y * 2**k for a binary32 shifted = k + MAGIC, |k| <= 250, by two factors of binary32."""
    bits = shifted.op("bits_from_float").named("bits")
    half = (bits >> 1).named("half")
    return y * _power(half) * _power(bits - half)


def _power(n: Term) -> Term:
    """Return the binary64 2**n for n in the low bits of a uint; the bits of MAGIC are shifted out at the left."""
    return ((n + 127) << 23).op("float_from_bits").based(Base.D).named("power")
