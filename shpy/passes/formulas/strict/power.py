"""Powers by way of binary64.

Stage: improve. x to the y is 2 to the y log2(x), with the logarithm in two parts, of which the first has 24 bits: its
product with y is exact. Nothing is fused, so that all devices give the same bits. The result has an error of about half
a unit in the last place of binary64, and is rounded once.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.parts import MAGIC, fast_two_sum, polynomial
from shpy.passes.formulas.portable.exponential import two_to_the
from shpy.passes.formulas.portable.logarithm import Pair, mantissa_and_exponent, power_edges
from shpy.passes.formulas.strict.coefficients import STRICT_LOG2_REST, STRICT_TWO_BY_LN2
from shpy.passes.formulas.strict.exponential import clamped, times_power
from shpy.passes.formulas.terms import Term, where

_END: Final = 160.0
"""The size of an exponent beyond which 2 to that power is 0 or infinite in binary32."""


def _shortened(v: Term) -> Term:
    """Return the binary64 rounded to the 24 bits of binary32."""
    return v.based(Base.F).based(Base.D)


def _log2_in_two(x: Term) -> Pair:
    """Return the binary logarithm of a positive finite binary32 in two parts, of which the first has 24 bits.

    It is k + 2 / ln 2 atanh(s) for s = f / (2 + f), with the first 24 bits of s apart: their product with the sum
    2 + f is exact, and so is that with the first part of 2 / ln 2.
    """
    mantissa, exponent = mantissa_and_exponent(x)
    f, k = (mantissa - 1).based(Base.D).named("f"), exponent.based(Base.D).named("k")
    total = (f + 2).named("total")
    inverse = (1 / total).named("inverse")
    quotient = (f * inverse).named("quotient")
    s = _shortened(quotient).named("s")
    z = (quotient * quotient).named("z")
    scale, scale_low = STRICT_TWO_BY_LN2
    linear_low = (f - s * total) * inverse * scale + quotient * scale_low
    high, low = fast_two_sum(k, s * scale)
    rest = (low + (linear_low + quotient * (z * polynomial(z, {Base.D: STRICT_LOG2_REST})))).named("rest")
    upper = _shortened(high + rest).named("upper")
    return upper, (high - upper) + rest


def pow_(x: Term, y: Term) -> Term:
    """Return x to the power of y, as C99 7.12.7.4 and F.9.4.4 define it."""
    a = abs(x).named("a")
    logarithm, logarithm_low = _log2_in_two(a)
    exponent = y.based(Base.D).named("exponent")
    product = (exponent * logarithm).named("product")
    high = clamped(product, -_END, _END).named("high")
    low = where(high.equals(product), exponent * logarithm_low, 0.0).named("low")
    shifted = (high.based(Base.F) + MAGIC[Base.F]).named("shifted")
    r = (high - (shifted - MAGIC[Base.F]).based(Base.D) + low).named("r")
    return power_edges(x, y, a, times_power(two_to_the(r, None), shifted).based(Base.F))
