"""Arc sine, cosine and tangent by way of binary64.

Stage: improve. For x > 1/2, asin(x) = pi/2 - 2 asin(sqrt((1 - x) / 2)). An arc tangent is the nearest of 0, pi/4 and
pi/2 plus the arc tangent of a quotient of at most tan(pi/8).
"""

from __future__ import annotations

import math
from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.parts import horner, sign_bit
from shpy.passes.formulas.strict.coefficients import STRICT_ASIN, STRICT_ATAN
from shpy.passes.formulas.terms import Term, where

HALF_PI: Final = math.pi / 2

_ABOVE_HALF_PI: Final = HALF_PI + 2.0**-52
"""The binary64 after HALF_PI; with it no arc sine or arc cosine is misrounded."""

_EIGHTH: Final = math.sqrt(2) - 1
"""The tangent of pi/8."""


def _arc(x: Term) -> tuple[Term, Term]:
    """Return whether |x| < 1/2, and the arc sine of |x| if so, else of sqrt((1 - |x|) / 2)."""
    a = abs(x).named("a")
    near = (a < 0.5).named("near")
    d = where(near, a, (1 - a) * 0.5).based(Base.D).named("d")
    z = where(near, d * d, d).named("z")
    return near, (z.op("sqrt") * horner(z, STRICT_ASIN)).named("arc")


def asin(x: Term) -> Term:
    """Return the arc sine of x."""
    near, arc = _arc(x)
    size = where(near, arc, arc.mul_add(-2.0, _ABOVE_HALF_PI)).based(Base.F).named("size")
    return where(sign_bit(x), -size, size)


def acos(x: Term) -> Term:
    """Return the arc cosine of x."""
    near, arc = _arc(x)
    left = (x < 0).named("left")
    turned = where(left ^ near, -arc, arc).named("turned")
    return where(near, turned + _ABOVE_HALF_PI, turned.mul_add(2.0, where(left, turned.constant(math.pi), 0.0)))


def _angle(a: Term, b: Term) -> Term:
    """Return the arc tangent of a / b for a, b >= 0 that are not both 0 and not both infinite."""
    near, far = (a <= b * _EIGHTH).named("near"), (a > b * (1 / _EIGHTH)).named("far")
    cosine, sine = where(far, a.constant(0.0), 1.0).named("cosine"), where(near, a.constant(0.0), 1.0).named("sine")
    q = ((a * cosine - b * sine) / b.mul_add(cosine, a * sine)).named("q")
    first = where(near, a.constant(0.0), where(far, a.constant(HALF_PI), math.pi / 4))
    return q.mul_add(horner((q * q).named("z"), STRICT_ATAN), first)


def atan(x: Term) -> Term:
    """Return the arc tangent of x."""
    a = abs(x).named("a")
    bounded = where(a > 2.0**30, 2.0**30, a).based(Base.D).named("bounded")
    near, far = (a < _EIGHTH).named("near"), (a > 1 / _EIGHTH).named("far")
    cosine, sine = where(far, bounded.constant(0.0), 1.0).named("cosine"), where(near, bounded.constant(0.0), 1.0)
    q = (bounded.mul_add(cosine, -sine) / bounded.mul_add(sine, cosine)).named("q")
    first = where(near, q.constant(0.0), where(far, q.constant(HALF_PI), math.pi / 4))
    size = q.mul_add(horner((q * q).named("z"), STRICT_ATAN), first).based(Base.F).named("size")
    return where(sign_bit(x), -size, size)


def atan2(y: Term, x: Term) -> Term:
    """Return the angle of (x, y), as C99 7.12.4.4 and F.9.1.4 define it."""
    ax, ay = abs(x).named("ax"), abs(y).named("ay")
    endless, none = ax.op("max", ay).equals(math.inf), ax.op("max", ay).equals(0)
    a = where(endless, where(ay.equals(math.inf), ay.constant(1.0), 0.0), ay).based(Base.D).named("a")
    b = where(endless, where(ax.equals(math.inf), ax.constant(1.0), 0.0), where(none, 1.0, ax)).based(Base.D).named("b")
    angle = _angle(a, b).named("angle")
    size = where(sign_bit(x), math.pi - angle, angle).based(Base.F).named("size")
    return where(x.equals(x) & y.equals(y), where(sign_bit(y), -size, size), math.nan)
