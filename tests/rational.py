"""Fused multiply-adds in rational arithmetic, rounded by the definition: what every fast one is compared with."""

from fractions import Fraction

import numpy as np


def rounded(exact: Fraction, dtype) -> float:
    """Return the number of a dtype that is nearest to a fraction other than 0, half to even."""
    numbers = np.finfo(dtype)
    size = abs(exact)
    exponent = size.numerator.bit_length() - size.denominator.bit_length()
    exponent -= size < Fraction(2) ** exponent
    step = Fraction(2) ** (max(exponent, int(numbers.minexp)) - int(numbers.nmant))
    whole = round(exact / step) * step  # Python rounds a fraction half to even
    if abs(whole) >= Fraction(2) ** int(numbers.maxexp):
        return float("inf") if exact > 0 else float("-inf")
    return float(whole) if whole else (-0.0 if exact < 0 else 0.0)


def fused(a, b, c):
    """Return a * b + c of three numbers of one dtype, rounded once."""
    if not (np.isfinite(a) and np.isfinite(b)):
        return a * b + c
    if not np.isfinite(c):
        return c
    exact = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
    if exact:
        return a.dtype.type(rounded(exact, a.dtype))
    negative = np.signbit(a) != np.signbit(b) and np.signbit(c) and not (a and b)  # a sum of two negative zeros
    return a.dtype.type(-0.0 if negative else 0.0)


def each(a, b, c):
    """Return `fused` of the elements of arrays, which are broadcast."""
    a, b, c = np.broadcast_arrays(a, b, c)
    with np.errstate(all="ignore"):
        results = [fused(*three) for three in zip(a.ravel(), b.ravel(), c.ravel(), strict=True)]
    return np.array(results, a.dtype).reshape(a.shape)
