"""Sine and cosine in pairs of binary32, for angles of any size.

Stage: improve. An angle is k * pi / 2 plus a sum of three numbers: the first is at most pi / 4, the others far smaller.
"""

from __future__ import annotations

from typing import Any, Final

from shpy.passes.pairs.arithmetic import Coefficient, polynomial, product, rounded, square
from shpy.passes.pairs.coefficients import COS, HALF_PI, SIN, TWO_BY_PI_DIGITS
from shpy.passes.strict.circular import quadrant
from shpy.passes.strict.parts import fast_two_sum, two_product, two_sum, whole_and_shifted
from shpy.passes.strict.payne_hanek import FAR, quarters
from shpy.passes.terms import Term, joined, replaced, where

_COLUMNS: Final = 9
_SERIES: Final[list[tuple[Any, Any]]] = list(zip(COS, SIN, strict=True))
_TWO_BY_PI: Final = 0.63661975
_SMALL: Final = 2.0**-13
"""The bound below which the sine of x rounds to x."""


def _near_reduced(x: Term) -> list[Term]:
    """Return [high, low, last, k] for |x| up to FAR; the result for larger x is arbitrary."""
    first, second, third, fourth = (x.constant(part) for part in HALF_PI)
    k = whole_and_shifted(x * _TWO_BY_PI)[0].named("near_k")
    large, rest = two_product(k, first)
    middle, middle_rest = two_product(k, second)
    small, small_rest = two_product(k, third)
    high = (x - large).named("left")
    lost: list[Term] = []
    for part in (rest, middle):
        high, error = two_sum(high, -part)
        lost.append(error)
    low, tail = two_sum(*lost)
    for part in (middle_rest, small):
        low, error = two_sum(low, -part)
        tail = tail + error
    tail = (tail - (small_rest + k * fourth)).named("tail")
    high, low = two_sum(high, low)
    low, tail = two_sum(low, tail)
    high, low = fast_two_sum(high, low)
    return [high.named("near_high"), low.named("near_low"), tail.named("near_last"), k]


def far_reduced(x: Term) -> Term:
    """Return [high, low, last, k] of a scalar x with |x| >= FAR; see `_reduced`."""
    (a, b, c, d), k = quarters(x, TWO_BY_PI_DIGITS, _COLUMNS)
    part, lost = fast_two_sum(a, b)
    part_low, more = two_sum(lost, c)
    part, part_low = fast_two_sum(part, part_low)
    part_last = (more + d).named("part_last")
    first, second, third, _ = (x.constant(number) for number in HALF_PI)
    high, rest = two_product(part, first)
    middle, middle_rest = two_product(part, second)
    small, small_rest = two_product(part_low, first)
    low, error = two_sum(rest, middle)
    low, more = two_sum(low, small)
    tail = (error + more) + (middle_rest + small_rest)
    tail = tail + (part_low * second + (part_last * first + part * third))
    low, last = two_sum(low, tail.named("tail"))
    high, low = fast_two_sum(high, low)
    return joined(high.named("high"), low.named("low"), last.named("last"), k)


def _reduced(x: Term) -> list[Term]:
    """Return [high, low, last, k]: x is k * pi / 2 + high + low + last plus a multiple of 2 * pi."""

    def far() -> list[Term]:
        reductions = [x[n].op("far_reduced", type=x.type.sized(4)) for n in range(x.type.size)]
        return [joined(*(one[n] for one in reductions)) for n in range(4)]

    near = dict(zip(("high", "low", "last", "k"), _near_reduced(x), strict=True))
    return replaced((abs(x) > FAR).named("far"), near, far)


def _sine_or_cosine(high: Term, low: Term, last: Term, cosine: Term) -> Term:
    """Return the cosine of high + low + last where `cosine` holds, else the sine."""

    def chosen(c: float, s: float) -> Term:
        return where(cosine, high.constant(c), s)

    z = square((high, low))
    coefficients: list[Coefficient] = [
        tuple(map(chosen, c, s)) if isinstance(c, tuple) else chosen(c, s) for c, s in _SERIES
    ]
    series = polynomial(z, coefficients)
    rest = fast_two_sum(*product(z, series))
    first = where(cosine, high.constant(1), high).named("first")
    low, last = where(cosine, high.constant(0), low), where(cosine, high.constant(0), last)
    small, small_low = product((first, low), rest)
    largest, lost = fast_two_sum(first, small)
    return rounded(largest, [lost, low, small_low, last]).named("size")


def sin(x: Term) -> Term:
    """Return the sine of x."""
    high, low, last, k = _reduced(x)
    odd, opposite = quadrant(k)
    size = _sine_or_cosine(high, low, last, odd)
    return where(abs(x) < _SMALL, x, where(opposite, -size, size))


def cos(x: Term) -> Term:
    """Return the cosine of x."""
    high, low, last, k = _reduced(x)
    odd, opposite = quadrant(k)
    size = _sine_or_cosine(high, low, last, ~odd)
    return where(odd ^ opposite, -size, size)
