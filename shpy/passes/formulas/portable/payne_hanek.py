"""Reduce angles of any size by multiples of pi / 2 (Payne and Hanek 1983).

Stage: improve. The reduction needs x * 2 / pi modulo 4 only. So it uses only those digits of 2 / pi whose products with
the digits of x are neither multiples of 4 nor too small. Digits are balanced: whole numbers of at most half of the
radix in size, so that a column of products and its carry are exact in the float itself. GLSL has the same algorithm as
a loop over the columns (`edges.glsl`), for drivers that execute both sides of a branch.

    [high, low, k] = payne_hanek(x)    # x is k * pi / 2 + high + low plus a multiple of 2 * pi; |high| <= pi / 4
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.coefficients import PI, TWO_BY_PI_DIGITS
from shpy.passes.formulas.parts import constants, fast_two_sum, two_product, whole_and_shifted
from shpy.passes.formulas.terms import Term, joined, replaced, where

FAR: Final = 2.0**20
"""The least |x| that is reduced here; `_window` scales x to less than FAR times the radix."""

_RADIX_BITS: Final = {Base.F: 12, Base.D: 26}
"""Bits of a digit. Three digits hold the 24 or 53 bits of a float in [1, radix), wherever its first bit is."""

_SHIFTS: Final = {Base.F: (8, 4, 2, 1), Base.D: (32, 16, 8, 4, 2, 1)}
"""The numbers of digits by which x is scaled down in turn; together they suffice for x up to 2**128 or 2**1024."""

_COLUMNS: Final = 7
"""The digits of x * 2 / pi that are computed: one for k, and six for the fraction, of which the first two may be 0."""


def _window(x: Term, digits: Sequence[float], columns: int) -> tuple[Term, list[Term]]:
    """Return x / FAR, scaled by a power of the radix into [1, radix), and the digits of 2 / pi for that scale."""
    base = x.type.base
    bits = _RADIX_BITS[base]
    window = [x.constant(digit) for digit in digits]
    for shift in _SHIFTS[base]:
        large = (abs(x) >= FAR * 2.0 ** (bits * shift)).named("large")
        x = where(large, x * 2.0 ** (-bits * shift), x).named("scaled")
        shifted = [where(large, b, a).named("digit") for a, b in zip(window, window[shift:], strict=False)]
        window = (shifted + window[len(shifted) :])[: columns + shift + 1]
    return (x * (1 / FAR)).named("mantissa"), window


def quarters(x: Term, digits: Sequence[float], columns: int) -> tuple[list[Term], Term]:
    """Return x * 2 / pi modulo 4: a fraction of at most 1/2 in size, as numbers of two digits each, and a whole number.

    The fraction has `columns` - 1 digits, of which the first two may be 0. `digits` are those of 2 / pi.
    """
    mantissa, window = _window(x, digits, columns)
    radix = 2.0 ** _RADIX_BITS[x.type.base]
    first = whole_and_shifted(mantissa)[0].named("first")
    rest = ((mantissa - first) * radix).named("rest")
    second = whole_and_shifted(rest)[0].named("second")
    third = ((rest - second) * radix).named("third")
    sums = [
        (first * window[n + 2] + second * window[n + 1] + third * window[n]).named("column") for n in range(columns)
    ]
    place_values = []
    total = sums.pop()
    while sums:
        carry = whole_and_shifted(total * (1 / radix))[0].named("carry")
        place_values.append((total - carry * radix).named("place"))
        total = (sums.pop() + carry).named("total")
    # One float holds two digits.
    places = enumerate(zip(place_values[::-2], place_values[-2::-2], strict=True), 1)
    pairs = [((upper * radix + lower) * radix ** (-2 * n)).named("pair") for n, (upper, lower) in places]
    return pairs, total.named("k")


def payne_hanek(x: Term) -> Term:
    """Return [high, low, k] for |x| >= FAR: x is k * pi / 2 + high + low plus a multiple of 2 * pi."""
    (a, b, c), k = quarters(x, constants(x, TWO_BY_PI_DIGITS), _COLUMNS)
    part, part_low = fast_two_sum(a, b)
    part_low = (part_low + c).named("low")
    pi, pi_low = constants(x, PI)
    product, rest = two_product(part, x.constant(pi * 0.5))
    high, low = fast_two_sum(product, (rest + (part * (pi_low * 0.5) + part_low * (pi * 0.5))).named("tail"))
    return joined(high.named("high"), low.named("low"), k)


def _bounded(name: str) -> Callable[[Term], Term]:
    def meaning(x: Term) -> Term:
        far = (abs(x) > FAR).named("far")
        return replaced(far, {"size": x.op(name)}, lambda: [x.op(f"{name}_strict", type=x.type)])[0]

    return meaning


BOUNDED: Final = {name: _bounded(name) for name in ("sin", "cos", "tan")}
"""Functions that use the target's own function for angles up to FAR, and the strict one for larger angles."""
