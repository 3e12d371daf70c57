"""The natural logarithm by way of binary64.

Stage: improve. x is 2**k * (1 + f) with 1 + f between the roots of 1/2 and 2. Binary32 holds f and k exactly. The
logarithm of 1 + f is twice the inverse hyperbolic tangent of s = f / (2 + f).
"""

from __future__ import annotations

import math

from shpy.ir.types import Base
from shpy.passes.exact.coefficients import LN2, LOG, LOG2, LOG10
from shpy.passes.exact.parts import Rare, horner
from shpy.passes.strict.logarithm import INFINITY, edges, parted
from shpy.passes.terms import Term


def _rare_edges(x: Term, inside: Term) -> Rare:
    inside = inside.named("inside")
    return Rare(inside, (x <= 0) | x.differs(x) | x.equals(INFINITY), lambda: edges(x, inside))


def log(x: Term) -> Rare:
    """Natural logarithm."""
    f, k = (t.based(Base.D) for t in parted(x))
    s = (f / (f + 2)).named("s")
    z = (s * s).named("z")
    ln2, ln2_low = LN2
    part = (s * z).mul_add(horner(z, LOG), s + s).named("part")
    return _rare_edges(x, k.mul_add(ln2, k.mul_add(ln2_low, part)).based(Base.F))


def log2(x: Term) -> Rare:
    """Binary logarithm."""
    f, k = (t.based(Base.D) for t in parted(x))
    s = (f / (f + 2)).named("s")
    return _rare_edges(x, s.mul_add(horner((s * s).named("z"), LOG2), k).based(Base.F))


def log10(x: Term) -> Rare:
    """Decimal logarithm."""
    f, k = (t.based(Base.D) for t in parted(x))
    s = (f / (f + 2)).named("s")
    return _rare_edges(x, k.mul_add(math.log10(2), s * horner((s * s).named("z"), LOG10)).based(Base.F))
