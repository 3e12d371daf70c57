"""The reciprocal square root, by a correction of an estimate, and the hypotenuse.

Stage: improve. In `rsqrt`, near is 1 / sqrt(x) in binary32 and lack is 1 - x near**2, at most 2**-22. The exact value
is near (1 + lack / 2 + 3 lack**2 / 8 + ...). In binary64, or in binary32 with fma, lack has an error near 2**-47.
"""

from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.parts import two_sum
from shpy.passes.formulas.terms import Term, replaced, where

_ERROR: Final = 2.0**-51
"""A bound of the relative error of the rounded root of a rounded sum in binary64."""


def rsqrt(x: Term) -> Term:
    """Return 1 / sqrt(x)."""
    near = (1 / x.op("sqrt")).named("near")
    lack = (_in_binary32 if x.builder.fused else _in_binary64)(x, near).named("lack")
    return where(lack.equals(lack), near + (near * lack) * (0.375 * lack + 0.5), near)


def _in_binary32(x: Term, near: Term) -> Term:
    """Return 1 - root near - rest near, where x near = root + rest exactly and no number overflows binary32."""
    minus_root = (-(x * near)).named("minus_root")
    rest = x.mul_add(near, minus_root)
    return minus_root.mul_add(near, 1.0) - rest * near


def _in_binary64(x: Term, near: Term) -> Term:
    """Return 1 - x near**2, rounded."""
    d = near.based(Base.D)
    return (1 - x.based(Base.D) * (d * d)).based(Base.F)


def hypot(x: Term, y: Term) -> Term:
    """Return sqrt(x * x + y * y), correctly rounded.

    Squares of binary32 are exact in binary64. If the error of the root leaves a choice between two binary32 numbers,
    the exact sum of the squares is compared with the square of their middle, which is exact too.
    """
    square, other = (v.based(Base.D) * v.based(Base.D) for v in (x, y))
    root = (square + other).op("sqrt").named("root")
    low = (root * (1 - _ERROR)).based(Base.F).named("low")
    high = (root * (1 + _ERROR)).based(Base.F).named("high")

    def decided() -> list[Term]:
        total, rest = two_sum(square, other)
        # To decide on rounding to infinity, take 2**128 for infinity.
        upper = where(high.op("isinf"), square.constant(2.0**128), high.based(Base.D))
        middle = (0.5 * (low.based(Base.D) + upper)).named("middle")
        above = ((total - middle * middle) + rest).named("above")
        near = where(above > 0, high, where(above < 0, low, middle.based(Base.F)))
        return [where(x.op("isinf") | y.op("isinf"), x.constant(float("inf")), near)]

    return replaced(low.differs(high).named("unsure"), {"result": low}, decided)[0]
