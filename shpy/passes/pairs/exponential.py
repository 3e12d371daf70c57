"""The exponential, the logarithm and the reciprocal root in pairs of binary32.

Stage: improve.
"""

from __future__ import annotations

from typing import Final

from shpy.passes.pairs.arithmetic import polynomial, product, rounded, square
from shpy.passes.pairs.coefficients import EXP, LN2, LOG
from shpy.passes.strict.logarithm import edges, parted
from shpy.passes.strict.parts import (
    exact_quotient_rest,
    fast_two_sum,
    scaled_by,
    two_product,
    two_sum,
    whole_and_shifted,
)
from shpy.passes.terms import Term, where

_INVERSE_LN2: Final = 1.442695
_ENDS: Final = (-105.0, 90.0)
"""Outside these ends e to the x is 0 or infinite."""


def exp(x: Term) -> Term:
    """Return e to the x."""
    low_end, high_end = _ENDS
    near = where(x > high_end, high_end, where(x < low_end, low_end, x)).named("near")
    k, shifted = whole_and_shifted(near * _INVERSE_LN2)
    first, second, third = LN2
    left, lost = two_sum(near - k.named("k") * first, -(k * second))
    r = two_sum(left, lost - k * third)
    rest, rest_low = product(square(r), polynomial(r, EXP))
    high, first_lost = fast_two_sum(r[0].constant(1), r[0])
    high, second_lost = two_sum(high, rest)
    # A denormal result has fewer bits: adding a suitable larger number rounds the sum at the last of them.
    bits = shifted.op("bits_from_float")
    denormal = ((k < -126) | (k.equals(-126) & (high < 1))).named("denormal")
    above = where(denormal, ((1 - bits) << 23).op("float_from_bits"), 0.0).named("above")
    high, third_lost = fast_two_sum(above, high)
    total = rounded(high, [third_lost, second_lost, first_lost, r[1], rest_low])
    return scaled_by(total - above, shifted)


def log(x: Term) -> Term:
    """Return the natural logarithm of x."""
    f, k = parted(x)
    d, d_low = fast_two_sum(f.constant(2), f)
    q = (f / d).named("q")
    s = fast_two_sum(q, (exact_quotient_rest(f, d, q) - q * d_low) / d)
    z = square(s)
    rest, rest_low = product(s, fast_two_sum(*product(z, polynomial(z, LOG))))
    mantissa, mantissa_lost = fast_two_sum(s[0] + s[0], rest)
    first, second, third = LN2
    high, lost = two_sum(k * first, mantissa)
    high, more = two_sum(high, k * second)
    others = [lost, more, mantissa_lost, s[1] + s[1], rest_low, k * third]
    return edges(x, rounded(high, others))


def rsqrt(x: Term) -> Term:
    """Return the reciprocal of the square root of x = 2**(2 n) * m, which is 2**-n times that of m."""
    f, k = parted(x)
    n = (k * 0.5).op("floor").named("n")
    m = ((f + 1) * where((n + n).equals(k), x.constant(1), 2.0)).named("m")
    root = m.op("sqrt").named("root")
    whole, lost = two_product(root, root)
    root_low = ((m - whole) - lost) / (root + root)
    one = x.constant(1)
    q = (one / root).named("q")
    rest, rest_low = fast_two_sum(exact_quotient_rest(one, root, q), -(q * root_low))
    low = (rest / root).named("low")
    last = (exact_quotient_rest(rest, root, low) + rest_low) / root - low * (root_low / root)
    size = scaled_by(rounded(q, [low, last]), whole_and_shifted(-n)[1])
    inside = (x > 0) & (x < float("inf"))
    outside = where(x.equals(0), one / x, where(x.equals(float("inf")), x.constant(0), float("nan")))
    return where(inside, size, outside)
