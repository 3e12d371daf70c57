"""Avoid double rounding: round sums to odd, so that a second rounding is correct, and correct single inputs.

Stage: improve.
"""

from __future__ import annotations

from collections.abc import Iterable

from shpy.ir.exact import EVEN, ODD
from shpy.passes.formulas.terms import Term, where


def to_odd(x: Term, error: Term) -> Term:
    """Return the sum x + error rounded to odd, where x is that sum rounded to nearest (Boldo and Melquiond 2008)."""
    bits = x.op("bits_from_float")
    away = (error > 0).op("eq", x > 0)
    up, down = bits + 1, bits - 1
    inexact = (error.op("ne", 0)) & (bits & bits.constant(1)).op("eq", 0) & (x.op("abs") > 0)
    finite = x.op("isinf").op("not") & error.op("isnan").op("not")
    return where(inexact & finite, where(away, up, down).op("float_from_bits"), x)


def with_exceptions(name: str, x: Term, result: Term, exceptions: Iterable[tuple[float, float]]) -> Term:
    """Return the result of a function, replaced by the value of an exception (input, value) where x is its input.

    Exceptions of an odd or even function are listed for positive inputs only.
    """
    size = abs(x) if name in ODD | EVEN else x
    for argument, value in exceptions:
        right = where(x < 0, x.constant(-value), value) if name in ODD else value
        result = where(size.equals(argument), right, result)
    return result
