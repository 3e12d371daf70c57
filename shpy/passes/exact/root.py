"""The reciprocal of a square root, by what the square of an estimate lacks.

Stage: improve. near is 1 / sqrt(x) in binary32, lack is 1 - x near**2, at most 2**-22, and the exact value is
near (1 + lack / 2 + 3 lack**2 / 8 + ...). In binary64, or in binary32 with fma, lack has an error near 2**-47.
"""

from shpy.ir.types import Base
from shpy.passes.terms import Term, where


def rsqrt(x: Term) -> Term:
    """1 / sqrt(x)."""
    near = (1 / x.op("sqrt")).named("near")
    lack = (_in_binary32 if x.builder.fused else _in_binary64)(x, near).named("lack")
    return where(lack.equals(lack), near + (near * lack) * (0.375 * lack + 0.5), near)


def _in_binary32(x: Term, near: Term) -> Term:
    """Return 1 - root near - rest near for x near = root + rest, whose numbers are all in the range of binary32."""
    root = (x * near).named("root")
    rest = x.mul_add(near, -root).named("rest")
    return (-root).mul_add(near, 1.0) - rest * near


def _in_binary64(x: Term, near: Term) -> Term:
    """Return 1 - x near**2, rounded."""
    d = near.based(Base.D)
    return (1 - x.based(Base.D) * (d * d)).based(Base.F)
