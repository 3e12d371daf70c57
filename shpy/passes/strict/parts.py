"""Numbers in two parts, polynomials and powers of two: what the strict functions are built from.

Stage: improve. A number that one float cannot hold exactly enough is the sum of two, the second far smaller. No
operation here needs a fused multiply-add.

    high, low = two_product(a, b)           # high + low is exactly a * b
    polynomial(z, SIN)                      # with the coefficients of z's base
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from shpy.ir.constants import DTYPES
from shpy.ir.types import Base
from shpy.passes.terms import Term, where

Pair = tuple[Term, Term]
Numbers = Mapping[Base, tuple[float, ...]]

MAGIC: Final = {Base.F: 1.5 * 2.0**23, Base.D: 1.5 * 2.0**52}
"""Adding this number rounds to a whole number, which stands in the lowest bits of the sum."""

TINY: Final = {Base.F: 2.0**-13, Base.D: 2.0**-28}
"""Up to here an odd function with a slope of 1 is x; its sum with a product would lose the sign of -0."""

_SPLITTER: Final = {Base.F: 2.0**12 + 1, Base.D: 2.0**27 + 1}


def constants(like: Term, numbers: Numbers) -> tuple[float, ...]:
    """Return the numbers of the term's base, exactly as it holds them."""
    base = like.type.base
    return tuple(float(DTYPES[base](number)) for number in numbers[base])


def halves_of(number: float) -> tuple[float, float]:
    """Return a binary32 as two numbers of twelve bits."""
    spread = np.float32(number) * np.float32(_SPLITTER[Base.F])
    high = float(spread - (spread - np.float32(number)))
    return high, number - high


def polynomial(z: Term, coefficients: Numbers) -> Term:
    """c[0] + z * (c[1] + z * (c[2] + ...))."""
    *others, last = coefficients[z.type.base]
    total = z * last
    for c in others[:0:-1]:
        total = plus(total, c) * z
    return plus(total, others[0]).named("series")


def plus(x: Term, number: float) -> Term:
    """Return x + number, written as x - |number| for a negative number."""
    return x - (-number) if number < 0 else x + number


def two_sum(a: Term, b: Term) -> Pair:
    """Return the rounded sum and what rounding lost (Knuth 1969)."""
    total = (a + b).named("sum")
    back = (total - a).named("back")
    return total, ((a - (total - back)) + (b - back)).named("sum_low")


def fast_two_sum(a: Term | float, b: Term) -> Pair:
    """Return the rounded sum and its error for |a| >= |b| (Dekker 1971)."""
    total = (a + b).named("sum")
    return total, (b - (total - a)).named("sum_low")


def split(a: Term) -> Pair:
    """Two parts with half the bits each (Veltkamp 1968)."""
    spread = a * _SPLITTER[a.type.base]
    high = (spread - (spread - a)).named("upper")
    return high, (a - high).named("lower")


def two_product(a: Term, b: Term) -> Pair:
    """Return the rounded product and what rounding lost (Dekker 1971); neither factor near the ends of the range."""
    product = (a * b).named("product")
    (a_high, a_low), (b_high, b_low) = split(a), split(b)
    rest = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low
    return product, rest.named("product_low")


def exact_quotient_rest(n: Term, d: Term, q: Term) -> Term:
    """n - q * d, where q is n / d rounded: exact."""
    product, rest = two_product(q, d)
    return (n - product) - rest


def square_root(t: Term, low: Term) -> Pair:
    """Return the square root of t + low in two parts."""
    root = t.op("sqrt").named("root")
    square, lost = two_product(root, root)
    rest = ((t - square) - lost) + low
    return root, where(root > 0, rest / (root + root), 0.0).named("root_low")


def whole_and_shifted(x: Term) -> Pair:
    """Return the whole number nearest to x, never -0, and that number plus MAGIC; |x| must be below 2**21."""
    shifted = x + MAGIC[x.type.base]
    return shifted - MAGIC[x.type.base], shifted


def scaled_by(x: Term, shifted: Term) -> Term:
    """x * 2**n, rounded once, for n plus MAGIC: by two powers of two, both of which are there."""
    if x.type.base is Base.D:
        return x.op("ldexp", (shifted - MAGIC[Base.D]).based(Base.I))
    bits = shifted.op("bits_from_float").named("bits")
    first = (bits >> 1).named("first")
    # The bits of MAGIC leave on the left.
    return (x * _power_of_two(first)) * _power_of_two(bits - first)


def _power_of_two(n: Term) -> Term:
    """Return the binary32 2**n, for -127 < n < 128 in the low bits of a uint."""
    return ((n + 127) << 23).op("float_from_bits").named("power")


def sign_bit(x: Term) -> Term:
    """Return whether x is negative, or -0; a binary64 has the sign of the nearest binary32."""
    bits = x.op("bits_from_float")
    return bits >= bits.constant(2**31)
