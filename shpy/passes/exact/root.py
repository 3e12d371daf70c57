"""The reciprocal of a square root by way of binary64.

Stage: improve.
"""

from shpy.ir.types import Base
from shpy.passes.terms import Term, where


def rsqrt(x: Term) -> Term:
    """1 / sqrt(x): that of binary32, and what its square times x lacks to 1."""
    near = (1 / x.op("sqrt")).named("near")
    d = near.based(Base.D)
    lack = (-x).based(Base.D).mul_add(d * d, 1.0).based(Base.F).named("lack")
    return where(lack.equals(lack), near + (near * lack) * (0.375 * lack + 0.5), near)
