"""Logarithms by way of binary64.

Stage: improve. x is 2**k * (1 + f) with 1 + f between the roots of 1/2 and 2. Binary32 holds f and k exactly. The
logarithm of 1 + f is twice the inverse hyperbolic tangent of s = f / (2 + f).
"""

from __future__ import annotations

import math
from typing import Final

from shpy.ir.types import Base
from shpy.passes.exact.coefficients import LOG2, LOG10, LOG10_2, TWICE_ATANH
from shpy.passes.exact.parts import horner
from shpy.passes.strict.logarithm import INFINITY, Pair, edges, mantissa_and_exponent
from shpy.passes.terms import Term, replaced, where

_LEAST_NORMAL: Final = 2.0**-126


def _parted(x: Term) -> Pair:
    """(s, k) in binary64; what is no positive normal number takes a branch.

    At the edges k is the result, an infinity or NaN, whatever finite number is added to it.
    """

    def others() -> Pair:
        tiny = (x < _LEAST_NORMAL).named("tiny")
        return where(tiny, x * 2.0**23, x), edges(x, where(tiny, x.constant(-150), -127))

    rare = (~((x >= _LEAST_NORMAL) & (x < INFINITY))).named("rare")
    near, bias = replaced(rare, {"near": x, "bias": x.constant(-127)}, others)
    mantissa, exponent = mantissa_and_exponent(near)
    k, f = (exponent + bias).based(Base.D), (mantissa - 1).based(Base.D)
    return (f / (f + 2)).named("s"), k.named("k")


def log(x: Term) -> Term:
    """Natural logarithm."""
    s, k = _parted(x)
    return s.mul_add(horner((s * s).named("z"), TWICE_ATANH), k * math.log(2))


def log2(x: Term) -> Term:
    """Binary logarithm."""
    s, k = _parted(x)
    return s.mul_add(horner((s * s).named("z"), LOG2), k)


def log10(x: Term) -> Term:
    """Decimal logarithm."""
    s, k = _parted(x)
    step, step_low = LOG10_2
    return k.mul_add(step, k.mul_add(step_low, s * horner((s * s).named("z"), LOG10)))
