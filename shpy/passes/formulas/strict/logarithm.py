"""Logarithms by way of binary64.

Stage: improve. x is 2**k * (1 + f) with 1 + f between the roots of 1/2 and 2. Binary32 holds f and k exactly. The
logarithm of 1 + f is twice the inverse hyperbolic tangent of s = f / (2 + f).
"""

from __future__ import annotations

import math

from shpy.ir.types import Base
from shpy.passes.formulas.parts import horner
from shpy.passes.formulas.portable.logarithm import Pair, edges, mantissa_and_exponent
from shpy.passes.formulas.strict.coefficients import STRICT_LOG2, STRICT_LOG10, STRICT_LOG10_2, STRICT_TWICE_ATANH
from shpy.passes.formulas.terms import Term


def _parted(x: Term) -> Pair:
    """Return (s, k) in binary64 for positive finite x."""
    mantissa, exponent = mantissa_and_exponent(x)
    f, k = (mantissa - 1).based(Base.D), exponent.based(Base.D)
    return (f / (f + 2)).named("s"), k.named("k")


def log(x: Term) -> Term:
    """Return the natural logarithm of x."""
    s, k = _parted(x)
    return edges(x, s.mul_add(horner((s * s).named("z"), STRICT_TWICE_ATANH), k * math.log(2)).based(Base.F))


def log2(x: Term) -> Term:
    """Return the binary logarithm of x."""
    s, k = _parted(x)
    return edges(x, s.mul_add(horner((s * s).named("z"), STRICT_LOG2), k).based(Base.F))


def log10(x: Term) -> Term:
    """Return the decimal logarithm of x."""
    s, k = _parted(x)
    step, step_low = STRICT_LOG10_2
    inside = k.mul_add(step, k.mul_add(step_low, s * horner((s * s).named("z"), STRICT_LOG10)))
    return edges(x, inside.based(Base.F))
