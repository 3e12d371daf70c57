"""Sums that are rounded to odd, and so can be rounded a second time without harm.

Stage: improve.
"""

from __future__ import annotations

from shpy.passes.terms import Term, where


def to_odd(x: Term, error: Term) -> Term:
    """Return the sum x + error rounded to odd, where x is that sum rounded to nearest (Boldo and Melquiond 2008)."""
    bits = x.op("bits_from_float")
    away = (error > 0).op("eq", x > 0)
    up, down = bits + 1, bits - 1
    inexact = (error.op("ne", 0)) & (bits & bits.constant(1)).op("eq", 0) & (x.op("abs") > 0)
    finite = x.op("isinf").op("not") & error.op("isnan").op("not")
    return where(inexact & finite, where(away, up, down).op("float_from_bits"), x)
