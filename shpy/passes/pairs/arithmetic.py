"""Pairs: sums of two binary32, the second far smaller, with products, polynomials and a single rounding.

Stage: improve. Nothing here needs a fused multiply-add. Results of products and polynomials have relative errors of
about 2**-47.
"""

from __future__ import annotations

from collections.abc import Sequence

from shpy.passes.rounding import to_odd
from shpy.passes.strict.parts import Pair, fast_two_sum, two_product, two_sum
from shpy.passes.terms import Term

Number = Term | float
Coefficient = Number | tuple[Number, ...]
"""A binary32, or one in two parts."""


def product(a: Pair, b: Pair) -> Pair:
    """Return a * b; the parts may overlap in their last bits."""
    high, low = two_product(a[0], b[0])
    return high, (low + (a[0] * b[1] + a[1] * b[0])).named("product_low")


def square(a: Pair) -> Pair:
    """Return a * a."""
    high, low = two_product(a[0], a[0])
    return fast_two_sum(high, low + (a[0] * a[1]) * 2)


def polynomial(z: Pair, coefficients: Sequence[Coefficient]) -> Pair:
    """Return c[0] + z * (c[1] + z * (c[2] + ...)), where each coefficient is larger than the rest of the sum.

    At least the last two coefficients are single binary32 numbers, since the sum of these terms needs no second part.
    """
    pairs = [c for c in coefficients if isinstance(c, tuple)]
    *others, last = (c for c in coefficients if not isinstance(c, tuple))
    total = z[0] * last
    for c in reversed(others[1:]):
        total = ((total + c) * z[0]).named("series")
    high, low = fast_two_sum(others[0], total)
    for c, c_low in reversed(pairs):
        more, rest = product(z, (high, low))
        high, lost = fast_two_sum(c, more)
        high, low = fast_two_sum(high, lost + (rest + c_low))
    return high, low


def rounded(largest: Term, others: Sequence[Term]) -> Term:
    """Return the sum of the largest number and others, which are at most 2**-20 of it in size, rounded once.

    The sum of the others is rounded to odd: if an addition loses bits, the last bit of its result is set. So the total
    appears to lie in the middle between two numbers only if it does (Boldo and Melquiond 2008).
    """
    first, *rest = others
    lost: Term | None = None
    for number in rest:
        first, error = two_sum(first, number)
        lost = error if lost is None else (lost + error).named("lost")
    assert lost is not None
    high, low = fast_two_sum(largest, first)
    low, error = two_sum(low, lost)
    return high + to_odd(low, error)
