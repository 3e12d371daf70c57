"""The error function and its complement by way of binary64.

Stage: improve. Up to 1/2, erf x = x P(x x). Beyond, erfc x = exp(-x x) Q(t) / (x + 7/2) with t = (x - 7/2) / (x + 7/2),
where x x is exact in binary64. Everything else is 1 less one of them, or 2 less erfc, where that does not cancel.
"""

from __future__ import annotations

from shpy.ir.types import Base
from shpy.passes.formulas.parts import horner
from shpy.passes.formulas.strict.coefficients import STRICT_ERF, STRICT_ERFC
from shpy.passes.formulas.strict.exponential import clamped, exp_of
from shpy.passes.formulas.terms import Term, where


def _parts_of(x: Term) -> tuple[Term, Term, Term]:
    """Return whether |x| < 1/2, the error function of x if so, and its complement at |x| if not."""
    a = abs(x).named("a")
    d = clamped(a, 0.0, 10.2).based(Base.D).named("d")
    z = (d * d).named("z")
    inverse = (1 / (d + 3.5)).named("inverse")
    far = exp_of((-z).based(Base.F).named("near"), -z) * (inverse * horner(inverse.mul_add(-7.0, 1.0), STRICT_ERFC))
    return (a < 0.5).named("small"), (x.based(Base.D) * horner(z, STRICT_ERF)).named("inner"), far.named("outer")


def erf(x: Term) -> Term:
    """Return the error function of x."""
    small, inner, outer = _parts_of(x)
    size = 1 - outer
    return where(small, inner, where(x < 0, -size, size))


def erfc(x: Term) -> Term:
    """Return 1 less the error function of x."""
    small, inner, outer = _parts_of(x)
    return where(small, 1 - inner, where(x < 0, 2 - outer, outer))
