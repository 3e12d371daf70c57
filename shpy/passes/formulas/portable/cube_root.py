"""The cube root: an estimate of a scaled number, and Halley's steps.

Stage: improve. |x| is v 8**q with v between 0.7 and 5.7. A step of Halley's takes an estimate y to
y + y (v - y**3) / (2 y**3 + v), with the cube of its relative error times 2/3. The first estimate is off by 1.5%.
"""

from __future__ import annotations

import math

from shpy.ir.types import Base
from shpy.passes.formulas.parts import Pair, scaled_by, sign_bit, two_product, whole_and_shifted
from shpy.passes.formulas.portable.logarithm import mantissa_and_exponent, parted
from shpy.passes.formulas.terms import Term, where


def _estimated(m: Term, k: Term, steps: int) -> tuple[Term, Term, Term]:
    """Return (v, y, shifted): m 2**k is v 8**q, y is nearly the cube root of v, and shifted is q + MAGIC."""
    q, shifted = whole_and_shifted((k - 1) * (1 / 3))
    rest = (k - 3 * q.named("q")).based(m.type.base).named("rest")
    one, two = rest.equals(1), rest.equals(2)
    v = (m * where(two, m.constant(4), where(one, m.constant(2), 1.0))).named("v")
    root = where(two, m.constant(4 ** (1 / 3)), where(one, m.constant(2 ** (1 / 3)), 1.0)).named("root")
    y = ((m + 2) * (1 / 3) * root).named("y")
    for _ in range(steps):
        cube = (y * y * y).named("cube")
        y = (y + y * ((v - cube) / (cube + cube + v))).named("y")
    return v, y, shifted.named("shifted")


def _signed(x: Term, a: Term, size: Term) -> Term:
    """Return the root of x from that of its size; zeros, infinities and NaN are their own roots."""
    return where((a > 0) & (a < math.inf), where(sign_bit(x), -size, size), x)


def rounded_once(x: Term) -> Term:
    """Return the cube root of a binary32 by way of binary64."""
    a = abs(x).named("a")
    mantissa, k = mantissa_and_exponent(a)
    _, y, shifted = _estimated(mantissa.based(Base.D), k, 2)
    return _signed(x, a, scaled_by(y.based(Base.F), shifted))


def cbrt(x: Term) -> Term:
    """Return the cube root of x; the last step takes the difference of v and the cube of y in two parts."""
    a = abs(x).named("a")
    f, k = parted(a)
    v, y, shifted = _estimated((f + 1).named("m"), k, 2 if x.type.base is Base.D else 1)
    (square, square_low), (cube, cube_low) = _cube(y)
    rest = ((v - cube) - (cube_low + square_low * y)).named("rest")
    return _signed(x, a, scaled_by(y + rest / (3 * square), shifted))


def _cube(y: Term) -> tuple[Pair, Pair]:
    """Return the square of y in two parts, and the product of its first part and y in two parts."""
    square, square_low = two_product(y, y)
    return (square, square_low), two_product(square, y)
