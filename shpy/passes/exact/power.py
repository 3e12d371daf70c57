"""Powers by way of binary64.

Stage: improve. A logarithm of binary64 decides nearly all results: a relative error below 2**-43 moves none of them
across the middle between two binary32. For the others, once in 2**18, the logarithm is computed in two parts, to
2**-64, and without fused operations: the bits are the same in both spellings.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.types import Base
from shpy.passes.exact.coefficients import EXP2, LOG2
from shpy.passes.exact.exponential import times_power
from shpy.passes.exact.parts import horner
from shpy.passes.strict.exponential import two_to_the
from shpy.passes.strict.logarithm import log2_in_two, parted, power_edges
from shpy.passes.strict.parts import MAGIC, two_product
from shpy.passes.terms import Term, replaced, where

_END: Final = 160.0
"""Beyond it in size, 2 to the power is 0 or infinite in binary32."""

_ERROR: Final = 2.0**-43


def _clamped(v: Term) -> Term:
    """Return the number between -_END and _END that is nearest to v."""
    return where(v > _END, _END, where(v < -_END, -_END, v))


def _split(v: Term) -> tuple[Term, Term]:
    """(r, shifted): the binary64 v less the nearest whole number, about, and that as a binary32 plus MAGIC."""
    shifted = (v.based(Base.F) + MAGIC[Base.F]).named("shifted")
    return (v - (shifted - MAGIC[Base.F]).based(Base.D)).named("r"), shifted


def _in_two_parts(f: Term, k: Term, y: Term) -> Term:
    """Return 2**k * (1 + f) to the power of y, as a binary32."""
    logarithm, logarithm_low = log2_in_two(f, k)
    product, lost = two_product(y, logarithm.named("logarithm"))
    high = _clamped(product).named("high")
    low = where(high.equals(product), lost + y * logarithm_low, 0.0).named("low")
    r, shifted = _split(high)
    return times_power(two_to_the(r, low), shifted).based(Base.F)


def pow_(x: Term, y: Term) -> Term:
    """X to the power of y, as C99 7.12.7.4 and F.9.4.4 have it."""
    a = abs(x).named("a")
    f, k = (t.based(Base.D) for t in parted(a))
    s = (f / (f + 2)).named("s")
    logarithm = s.mul_add(horner((s * s).named("z"), LOG2), k).named("quick_logarithm")
    exponent = y.based(Base.D).named("exponent")
    r, shifted = _split(_clamped(exponent * logarithm))
    quick = times_power(horner(r, EXP2), shifted).named("quick")
    size = (quick * (1 - _ERROR)).based(Base.F).named("size")
    unsure = size.differs((quick * (1 + _ERROR)).based(Base.F)).named("unsure")
    (size,) = replaced(unsure, {"size": size}, lambda: [_in_two_parts(f, k, exponent)])
    return power_edges(x, y, a, size)
