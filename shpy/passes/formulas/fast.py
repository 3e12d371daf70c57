"""The functions of fast mode that a target lacks, by functions that it has.

Stage: improve. A compiler that reassociates sums takes `(x + MAGIC) - MAGIC`, by which the formulas of portable mode
round, for x. These have a relative error of some 2**-20 for numbers of ordinary size, and no promise at the edges. They
are for binary32, and `pow` for binary64 too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

from shpy.passes.formulas.coefficients import ERF, ERFC
from shpy.passes.formulas.parts import polynomial
from shpy.passes.formulas.terms import Term, where


def expm1(x: Term) -> Term:
    """Return tanh(x / 2) (e to the x + 1), which does not cancel."""
    return (x * 0.5).op("tanh") * (x.op("exp") + 1)


def log1p(x: Term) -> Term:
    """Return the logarithm of 1 + x, near 0 as 2 atanh(x / (2 + x))."""
    return where(abs(x) < 0.5, (x / (x + 2)).op("atanh") * 2, (x + 1).op("log"))


def exp10(x: Term) -> Term:
    """Return 2 to the x log2(10)."""
    return (x * math.log2(10)).op("exp2")


def cbrt(x: Term) -> Term:
    """Return the power of 1/3 of |x|, with the sign of x."""
    return x.op("sign") * abs(x).op("pow", 1 / 3)


def pow_(x: Term, y: Term) -> Term:
    """Return 2 to the y log2(|x|), negative for a negative x and an odd y; powers of 0 and by 0 are those of C99."""
    a = abs(x).named("a")
    size = where(a.equals(0), where(y < 0, x.constant(math.inf), 0.0), (y * a.op("log2")).op("exp2"))
    half = (y * 0.5).named("half")
    odd = half.op("floor").differs(half) & y.op("floor").equals(y)
    return where(y.equals(0), 1.0, where((x < 0) & odd, -size, size.named("size")))


def sinpi(x: Term) -> Term:
    """Return the sine of pi times the rest of x modulo 2."""
    return ((x - (x * 0.5).op("round") * 2) * math.pi).op("sin")


def cospi(x: Term) -> Term:
    """Return the sine of pi (1/2 - |rest|) for the rest of x modulo 2, exact where the cosine is 0."""
    return ((0.5 - abs(x - (x * 0.5).op("round") * 2)) * math.pi).op("sin")


def _erfc_of_size(a: Term) -> Term:
    """Return the complement of the error function for a >= 1/2."""
    total = (a + 3.5).named("total")
    return (-(a * a)).op("exp") * (polynomial(((a - 3.5) / total).named("t"), ERFC) / total)


def erf(x: Term) -> Term:
    """Return the error function: a polynomial up to 1."""
    a = abs(x).named("a")
    size = 1 - _erfc_of_size(a)
    return where(a < 1, x + x * polynomial((x * x).named("z"), ERF), where(x < 0, -size, size))


def erfc(x: Term) -> Term:
    """Return 1 less the error function."""
    a = abs(x).named("a")
    outer = _erfc_of_size(a).named("outer")
    inner = x + x * polynomial((x * x).named("z"), ERF)
    return where(a < 0.5, 1 - inner, where(x < 0, 2 - outer, outer))


FUNCTIONS: Final[Mapping[str, Callable[..., Term]]] = {
    "pow": pow_,
    **{f.__name__: f for f in (expm1, log1p, exp10, cbrt, sinpi, cospi, erf, erfc)},
}
