"""Polynomials by Horner's rule and rounding to whole numbers, for the formulas in binary64.

Stage: improve.

    horner(z, (c0, c1, c2))                # c0 + z * (c1 + z * c2)
"""

from __future__ import annotations

from collections.abc import Sequence

from shpy.ir.types import Base
from shpy.passes.strict.parts import MAGIC
from shpy.passes.terms import Term


def horner(z: Term, coefficients: Sequence[float]) -> Term:
    """Return the polynomial with these coefficients, lowest power first."""
    *others, last = coefficients
    total = z.constant(last)
    for c in reversed(others):
        total = total.mul_add(z, c)
    return total.named("series")


def whole(x: Term) -> Term:
    """Return the nearest whole number, for a binary64 below 2**51 in size."""
    return (x + MAGIC[Base.D]) - MAGIC[Base.D]
