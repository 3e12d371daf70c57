"""The error function and its complement, from operations that every target rounds alike.

Stage: improve. Up to 1, erf x = x + x P(x x). From 1/2 on, erfc x = exp(-x x) Q(t) / (x + 7/2) for
t = (x - 7/2) / (x + 7/2). Its x x has two parts, since exp multiplies the rounding error of the square by the square.
"""

from __future__ import annotations

import math
from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.coefficients import ERF, ERFC
from shpy.passes.formulas.parts import TINY, polynomial, scaled_by, two_product
from shpy.passes.formulas.portable.exponential import exp_parts
from shpy.passes.formulas.terms import Term, where

_END: Final = {Base.F: 10.2, Base.D: 27.3}
"""The number from which on erfc is 0."""


def _parts_of(x: Term) -> tuple[Term, Term, Term]:
    """Return |x|, the error function of x up to 1, and its complement at |x| from 1/2 on."""
    a = abs(x).named("a")
    end = _END[x.type.base]
    near = where(a > end, end, a).named("near")
    square, lost = two_product(near, near)
    high, low, _, shifted = exp_parts(-square)
    total = (near + 3.5).named("total")
    factor = (polynomial(((near - 3.5) / total).named("t"), ERFC) / total).named("factor")
    power = high + (low - lost * (high + low))
    outer = scaled_by(power * factor, shifted).named("outer")
    slope = x.constant(2 / math.sqrt(math.pi))
    inner = where(a < TINY[x.type.base], x * slope, x + x * polynomial(square, ERF)).named("inner")
    return a, inner, outer


def erf(x: Term) -> Term:
    """Return the error function of x."""
    a, inner, outer = _parts_of(x)
    size = (1 - outer).named("size")
    return where(a < 1, inner, where(x < 0, -size, size))


def erfc(x: Term) -> Term:
    """Return 1 less the error function of x."""
    a, inner, outer = _parts_of(x)
    return where(a < 0.5, 1 - inner, where(x < 0, 2 - outer, outer))
