"""The hypotenuse, from operations that every target rounds alike.

Stage: improve. A power of two scales the sides, so that no part of a square is denormal or infinite.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.parts import square_root, two_product, two_sum
from shpy.passes.formulas.terms import Term, where

_NEAR: Final = {Base.F: (2.0**-28, 2.0**62), Base.D: (2.0**-400, 2.0**500)}
"""The range of the longer side in which the sides are not scaled."""
_UP: Final = {Base.F: 2.0**90, Base.D: 2.0**600}
_DOWN: Final = {Base.F: 2.0**-66, Base.D: 2.0**-600}
"""The scale for sides below that range is _UP, for sides above it _DOWN."""
_SHARE: Final = {Base.F: 2.0**-12, Base.D: 2.0**-27}
"""A shorter side below this fraction of the longer one changes the result by less than half of its last place."""


def hypot(x: Term, y: Term) -> Term:
    """Return sqrt(x * x + y * y): the root, in two parts, of a sum in two parts."""
    base = x.type.base
    low, high = _NEAR[base]
    a, b = abs(x).named("a"), abs(y).named("b")
    swapped = (a < b).named("swapped")
    longer = where(swapped, b, a).named("longer")
    small, large = (longer < low).named("small"), (longer > high).named("large")
    scale = where(small, x.constant(_UP[base]), where(large, x.constant(_DOWN[base]), 1.0)).named("scale")
    back = where(small, x.constant(1 / _UP[base]), where(large, x.constant(1 / _DOWN[base]), 1.0))
    longer, shorter = (longer * scale).named("side"), (where(swapped, a, b) * scale).named("shorter")
    shorter = where(shorter < longer * _SHARE[base], 0.0, shorter).named("other")
    (square, lost), (other, other_lost) = two_product(longer, longer), two_product(shorter, shorter)
    total, rest = two_sum(square, other)
    root, root_low = square_root(total, rest + (lost + other_lost))
    return where(a.op("isinf") | b.op("isinf"), x.constant(float("inf")), (root + root_low) * back)
