"""Numbers in two parts, polynomials and powers of two, from which the elementary functions are built.

Stage: improve. A number that needs more digits than one float holds is the sum of two floats, the second far smaller.
No operation here needs a fused multiply-add.

    high, low = two_product(a, b)           # high + low is exactly a * b
    polynomial(z, SIN)                      # with the coefficients of z's base
    horner(z, (c0, c1, c2))                 # c0 + z * (c1 + z * c2)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from shpy.ir.constants import DTYPES
from shpy.ir.types import Base
from shpy.passes.formulas.terms import Term, where

Pair = tuple[Term, Term]
Numbers = Mapping[Base, tuple[float, ...]]

MAGIC: Final = {Base.F: 1.5 * 2.0**23, Base.D: 1.5 * 2.0**52}
"""The number that, added to a float, rounds it to a whole number and leaves that in the lowest bits of the sum."""

TINY: Final = {Base.F: 2.0**-13, Base.D: 2.0**-28}
"""The bound below which an odd function with slope 1 at 0 returns x itself: its formula would lose the sign of -0."""

_SPLITTER: Final = {Base.F: 2.0**12 + 1, Base.D: 2.0**27 + 1}


def constants(like: Term, numbers: Numbers) -> tuple[float, ...]:
    """Return the numbers for the base of `like`, rounded to that base."""
    base = like.type.base
    return tuple(float(DTYPES[base](number)) for number in numbers[base])


def halves_of(number: float) -> tuple[float, float]:
    """Return a binary32 as the sum of two numbers of twelve bits each."""
    spread = np.float32(number) * np.float32(_SPLITTER[Base.F])
    high = float(spread - (spread - np.float32(number)))
    return high, number - high


def polynomial(z: Term, coefficients: Numbers) -> Term:
    """Return c[0] + z * (c[1] + z * (c[2] + ...)), with the coefficients c for the base of z."""
    *others, last = coefficients[z.type.base]
    total = z * last
    for c in others[:0:-1]:
        total = plus(total, c) * z
    return plus(total, others[0]).named("series")


def horner(z: Term, coefficients: Sequence[float]) -> Term:
    """Return the polynomial with these coefficients, lowest power first; fused where the device is quick at that."""
    *others, last = coefficients
    total = z.constant(last)
    for c in reversed(others):
        total = total.mul_add(z, c)
    return total.named("series")


def whole(x: Term) -> Term:
    """Return the nearest whole number, for a binary64 below 2**51 in size."""
    return (x + MAGIC[Base.D]) - MAGIC[Base.D]


def plus(x: Term, number: float) -> Term:
    """Return x + number, written as x - |number| for a negative number."""
    return x - (-number) if number < 0 else x + number


def two_sum(a: Term, b: Term) -> Pair:
    """Return the rounded sum and its rounding error (Knuth 1969)."""
    total = (a + b).named("sum")
    back = (total - a).named("back")
    return total, ((a - (total - back)) + (b - back)).named("sum_low")


def fast_two_sum(a: Term | float, b: Term) -> Pair:
    """Return the rounded sum and its rounding error, for |a| >= |b| (Dekker 1971)."""
    total = (a + b).named("sum")
    return total, (b - (total - a)).named("sum_low")


def split(a: Term) -> Pair:
    """Return a as the sum of two parts with half the bits each (Veltkamp 1968)."""
    spread = a * _SPLITTER[a.type.base]
    high = (spread - (spread - a)).named("upper")
    return high, (a - high).named("lower")


def two_product(a: Term, b: Term) -> Pair:
    """Return the rounded product and its rounding error (Dekker 1971), for factors far from the ends of the range."""
    product = (a * b).named("product")
    (a_high, a_low), (b_high, b_low) = split(a), split(b)
    rest = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low
    return product, rest.named("product_low")


def exact_quotient_rest(n: Term, d: Term, q: Term) -> Term:
    """Return n - q * d exactly, where q is n / d rounded."""
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
    """Return x * 2**n, rounded once, for shifted = n + MAGIC; 2**n is split into two factors that do not overflow."""
    if x.type.base is Base.D:
        return x.op("ldexp", (shifted - MAGIC[Base.D]).based(Base.I))
    bits = shifted.op("bits_from_float").named("bits")
    first = (bits >> 1).named("first")
    # `_power_of_two` shifts the bits of MAGIC out at the left.
    return (x * _power_of_two(first)) * _power_of_two(bits - first)


def _power_of_two(n: Term) -> Term:
    """Return the binary32 2**n, for -127 < n < 128 in the low bits of a uint."""
    return ((n + 127) << 23).op("float_from_bits").named("power")


def sign_bit(x: Term) -> Term:
    """Return whether x is negative, or -0; a binary64 has the sign of the nearest binary32."""
    bits = x.op("bits_from_float")
    return bits >= bits.constant(2**31)
