"""Fused multiply-adds of numpy arrays: a * b + c, rounded once.

Stage: represent; `meaning.fma` calls it. Of binary32 and binary16 the product is exact in binary64. Its sum with c is
rounded to binary64, which changes the second rounding only where it falls on the middle of two narrower numbers. There,
and for binary64, sums and products are taken in two parts without error, and rounded to odd before the last rounding
(Boldo and Melquiond, "Emulation of FMA and correctly rounded sums", IEEE Transactions on Computers 57(4), 2008).

>>> float(multiply_add(*map(np.float64, (1 + 2**-30, 1 - 2**-30, -1))))
-8.673617379884035e-19
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_FEW = 16
"""Numbers of binary64 up to which rational arithmetic is quicker."""


def multiply_add(a: Array, b: Array, c: Array) -> Array:
    """Return a * b + c, rounded once; all are of one dtype of floats."""
    return _of_doubles(a, b, c) if a.dtype == np.float64 else _through_double(a, b, c)


def _through_double(a: Array, b: Array, c: Array) -> Array:
    product = np.multiply(a, b, dtype=np.float64)
    total = np.asarray(np.add(product, c, dtype=np.float64))
    numbers = np.finfo(a.dtype)
    dropped = 52 - int(numbers.nmant)
    middle = (total.view(np.int64) & ((1 << dropped) - 1)) == 1 << (dropped - 1)
    size = np.abs(total)
    middle |= (size < np.float64(numbers.tiny)) & (size > 0)  # a sum of 0 is exact
    if middle.any():
        one, other = (np.broadcast_to(v, total.shape)[middle] for v in (product, np.asarray(c, np.float64)))
        total[middle] = _odd_sum(one, other)
    return total.astype(a.dtype)


def _of_doubles(a: Array, b: Array, c: Array) -> Array:
    if max(np.size(a), np.size(b), np.size(c)) <= _FEW:
        return np.asarray(np.vectorize(_exactly, otypes=[np.float64])(a, b, c))
    product = a * b
    size = np.abs(product)
    largest = max(float(np.max(np.abs(v))) for v in (a, b, c))  # NaN if one is
    if 2.0**-900 < np.min(size) and np.max(size) < 2.0**900 and largest < 2.0**900:
        sums = _rounded_once(a, b, c)
        return np.where(sums == 0, product + c, sums)  # a sum of 0 is exact, and has its own sign
    return _with_edges(*np.broadcast_arrays(a, b, c))


def _with_edges(a: Array, b: Array, c: Array) -> Array:
    """Return a * b + c of binary64, some of which are zeros, very large, very small or no numbers."""
    product, result = a * b, a * b + c
    finite = np.isfinite(a) & np.isfinite(b)
    result = np.where(finite & ~np.isfinite(c), c, result)
    size = np.abs(product)
    moderate = (size > 2.0**-900) & (size < 2.0**900) & (np.maximum(np.abs(a), np.abs(b)) < 2.0**900)
    moderate &= np.abs(c) < 2.0**900
    sums = _rounded_once(a[moderate], b[moderate], c[moderate])
    result[moderate] = np.where(sums == 0, result[moderate], sums)
    rest = finite & np.isfinite(c) & ~moderate & (a != 0) & (b != 0)
    if rest.any():
        result[rest] = np.vectorize(_exactly, otypes=[np.float64])(a[rest], b[rest], c[rest])
    return np.asarray(result)


def _rounded_once(a: Array, b: Array, c: Array) -> Array:
    """Return a * b + c of binary64, where the product is far from underflow and overflow."""
    product, low = _two_product(a, b)
    inner, lowest = _two_sum(c, low)
    high, middle = _two_sum(product, inner)
    return np.asarray(high + _odd_sum(lowest, middle))


def _two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the sum, and its error (Knuth)."""
    total = a + b
    back = total - a
    return total, (a - (total - back)) + (b - back)


def _two_product(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the product, and its error (Dekker 1971)."""
    product = a * b
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _halves(x: Array) -> tuple[Array, Array]:
    scaled = x * 134217729.0  # 2**27 + 1
    high = scaled - (scaled - x)
    return high, x - high


def _odd_sum(a: Array, b: Array) -> Array:
    """Return a + b; where that is not exact, the neighbour of the exact sum whose last bit is odd."""
    total, error = _two_sum(a, b)
    bits = np.asarray(total).view(np.int64)
    away = np.where((error > 0) == (total > 0), np.int64(1), np.int64(-1))
    odd = np.where((error != 0) & (bits & 1 == 0), bits + away, bits)
    return np.asarray(odd.view(np.float64))


def _exactly(a: float, b: float, c: float) -> float:
    """Return a * b + c of three binary64 in rational arithmetic."""
    if not (np.isfinite(a) and np.isfinite(b)):
        return float(a * b + c)
    if not np.isfinite(c):
        return float(c)
    exact = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
    if exact == 0:
        return float(a * b + c)
    try:
        return float(exact)
    except OverflowError:
        return float("inf") if exact > 0 else float("-inf")
