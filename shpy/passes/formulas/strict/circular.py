"""Sine, cosine and tangent by way of binary64.

Stage: improve. The angle is divided by pi: the digits of 1 / pi have 29 + 29 + 53 bits, so that the products of the
first two with a binary32 are exact. The quotient is a whole number k plus a fraction f of at most 1/2 in size; f keeps
its relative precision even if it is tiny. Angles from FAR on need later digits of 1 / pi. Digits whose products with
the angle are even whole numbers are left out, since 2 pi is a period.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.parts import horner, sign_bit, whole
from shpy.passes.formulas.strict.coefficients import (
    STRICT_FAR_DIGITS,
    STRICT_INVERSE_PI,
    STRICT_SIN,
    STRICT_TAN_ABOVE,
    STRICT_TAN_BELOW,
)
from shpy.passes.formulas.terms import Term, replaced, where

FAR: Final = 2.0**24
"""The least far angle, for which k may be too large for a binary32."""

_WINDOW: Final = 2.0**26
"""The ratio of angles that need the next digits."""


def _parts_of(x: Term, halves: int, offset: float = 0.0) -> tuple[Term, Term]:
    """Return (f, odd): halves * x / pi is k + f + offset with a whole number k and |f| <= 1/2; `odd`: k is odd."""
    d = x.based(Base.D)
    first, second, third = (digit * halves for digit in STRICT_INVERSE_PI)
    product = (d * first).named("product")
    k = whole(product - offset if offset else product).named("near_k")
    f = d.mul_add(third, d.mul_add(second, product - (k + offset if offset else k))).named("near_f")

    def far() -> tuple[Term, Term]:
        return _far_parts(d, abs(x), halves, offset)

    f, count = replaced((abs(x) >= FAR).named("far"), {"f": f, "k": k.based(Base.F)}, far)
    half = (count * 0.5).named("half")
    return f, half.differs(half.op("floor")).named("odd")


def _far_parts(d: Term, a: Term, halves: int, offset: float) -> tuple[Term, Term]:
    """Return (f, k) of a far angle; k may differ from the exact one by an even number."""
    digits = [d.constant(digit * halves) for digit in STRICT_INVERSE_PI]
    for n, window in enumerate(STRICT_FAR_DIGITS, 1):
        above = (a >= FAR * _WINDOW**n).named("above")
        digits = [
            where(above, later * halves, digit).named("digit") for later, digit in zip(window, digits, strict=True)
        ]
    first, second, third = digits
    product, rest = (d * first).named("product"), (d * second).named("rest")
    k, more = whole(product - offset if offset else product).named("k"), whole(rest).named("more")
    left = ((product - (k + offset if offset else k)) + (rest - more)).named("left")
    last = whole(left).named("last")
    even = (k * 0.5).op("floor") * 2
    return d.mul_add(third, left - last), ((k - even) + (more + last)).based(Base.F)


def sin(x: Term) -> Term:
    """Return the sine of x."""
    f, odd = _parts_of(x, 1)
    return _sine(f, odd)


def cos(x: Term) -> Term:
    """Return the cosine of x, which is the sine of x + pi / 2."""
    f, odd = _parts_of(x, 1, 0.5)
    return _sine(f, ~odd)


def sinpi(x: Term) -> Term:
    """Return the sine of pi x, from the exact difference of x and the nearest whole number."""
    k = x.op("round").named("k")
    half = (k * 0.5).named("half")
    f = (x - k).named("f")
    sine = _sine(f.based(Base.D), half.differs(half.op("floor")))
    return where(f.equals(0), where(sign_bit(x), x.constant(-0.0), 0.0), sine)


def cospi(x: Term) -> Term:
    """Return the cosine of pi x, the sine of pi (1/2 - |f|) for the same difference f; all zeros are positive."""
    k = x.op("round").named("k")
    half = (k * 0.5).named("half")
    f = (0.5 - abs(x - k).based(Base.D)).named("f")
    return _sine(f, half.differs(half.op("floor")) & f.differs(0))


def _sine(f: Term, odd: Term) -> Term:
    """Return sin(pi * f), negated where `odd` holds."""
    size = (f * horner((f * f).named("z"), STRICT_SIN)).based(Base.F).named("size")
    return where(odd, -size, size)


def tan(x: Term) -> Term:
    """Return the tangent of x, from a quotient of polynomials on [-pi / 4, pi / 4]."""
    f, odd = _parts_of(x, 2)
    z = (f * f).named("z")
    above, below = (f * horner(z, STRICT_TAN_ABOVE)).named("above"), horner(z, STRICT_TAN_BELOW).named("below")
    return where(odd, -below, above) / where(odd, above, below)
