"""The hypotenuse, from operations that every target rounds alike.

Stage: improve. A power of two brings the longer side to where no part of a square is denormal or infinite.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.types import Base
from shpy.passes.strict.parts import square_root, two_product, two_sum
from shpy.passes.terms import Term, where

_NEAR: Final = {Base.F: (2.0**-28, 2.0**62), Base.D: (2.0**-400, 2.0**500)}
"""The longer sides that are taken as they are."""
_UP: Final = {Base.F: 2.0**90, Base.D: 2.0**600}
_DOWN: Final = {Base.F: 2.0**-66, Base.D: 2.0**-600}
"""The factors of what is smaller, and of what is larger."""
_SHARE: Final = {Base.F: 2.0**-12, Base.D: 2.0**-27}
"""A shorter side below this share of the longer one does not move the result by half of its last place."""


def hypot(x: Term, y: Term) -> Term:
    """sqrt(x * x + y * y), as the root in two parts of a sum in two parts."""
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
