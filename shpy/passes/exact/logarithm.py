"""The natural logarithm by way of binary64.

Stage: improve. x is 2**k * (1 + f) with 1 + f between the roots of 1/2 and 2. Binary32 holds f and k exactly. The
logarithm of 1 + f is twice the inverse hyperbolic tangent of s = f / (2 + f).
"""

from __future__ import annotations

import math

from shpy.ir.types import Base
from shpy.passes.exact.coefficients import LN2, LOG, LOG2, LOG10
from shpy.passes.exact.parts import horner
from shpy.passes.strict.logarithm import edges, parted
from shpy.passes.terms import Term


def log(x: Term) -> Term:
    """Natural logarithm."""
    f, k = (t.based(Base.D) for t in parted(x))
    s = (f / (f + 2)).named("s")
    z = (s * s).named("z")
    ln2, ln2_low = LN2
    part = (s * z).mul_add(horner(z, LOG), s + s).named("part")
    return edges(x, k.mul_add(ln2, k.mul_add(ln2_low, part)).based(Base.F))


def log2(x: Term) -> Term:
    """Binary logarithm."""
    f, k = (t.based(Base.D) for t in parted(x))
    s = (f / (f + 2)).named("s")
    return edges(x, s.mul_add(horner((s * s).named("z"), LOG2), k).based(Base.F))


def log10(x: Term) -> Term:
    """Decimal logarithm."""
    f, k = (t.based(Base.D) for t in parted(x))
    s = (f / (f + 2)).named("s")
    return edges(x, k.mul_add(math.log10(2), s * horner((s * s).named("z"), LOG10)).based(Base.F))
