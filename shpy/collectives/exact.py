"""Exact sums of floats: integers of as many bits as a sum can have, rounded once.

Stage: run. The host adds the integer significands of each exponent in a bin of 64 bits, without an error: significands
of 24 bits, or halves of 53 bits, of fewer than 2**31 elements fit. All bins together are one integer, in units of the
least denormal. A device sums blocks of 32-bit floats (`programs.accumulating`), and the host adds these sums.
Source: Malcolm, On accurate floating-point summation, CACM 14 (1971); Kulisch's long accumulator.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.collectives.programs import SPECIAL, WORDS

_BLOCK = 1 << 18
"""The number of elements whose significands are split together, so that temporary arrays fit into the cache."""


@np.errstate(all="ignore")
def exact_sums(array: NDArray[Any]) -> NDArray[Any]:
    """Return the exact sum of each row of (rows, n) floats, rounded once to their dtype; +0 where it is zero.

    A NaN, or infinities of both signs, give NaN; else infinities give infinity, as does a sum that is too large.
    """
    rows, n = array.shape
    sums = np.zeros(rows, array.dtype)
    if n > _BLOCK:
        for row in range(rows):
            blocks = (array[row : row + 1, k : k + _BLOCK] for k in range(0, n, _BLOCK))
            parts = [_bins(block) for block in blocks]
            sums[row] = _rounded(sum(bins for bins, _ in parts)[0], sum(s for _, s in parts)[0], array.dtype)
        return sums
    step = max(1, _BLOCK // max(n, 4096))
    for first in range(0, rows, step):
        bins, special = _bins(array[first : first + step])
        for row in range(len(bins)):
            sums[first + row] = _rounded(bins[row], special[row], array.dtype)
    return sums


def sums_of_blocks(words: NDArray[Any]) -> NDArray[Any]:
    """Return the float32 sum of each row of (rows, blocks, WORDS + 1) words from `programs.accumulating`."""
    columns = words[..., :WORDS].sum(axis=1, dtype=np.uint64)
    negative = (words[..., WORDS - 1] >> np.uint32(31)).sum(axis=1, dtype=np.int64)
    flags = np.bitwise_or.reduce(words[..., WORDS], axis=1)
    sums = np.zeros(len(words), np.float32)
    for row in range(len(words)):
        total = sum(int(n) << 32 * k for k, n in enumerate(columns[row])) - (int(negative[row]) << 32 * WORDS)
        infinity, minus_infinity, nan = (bool(flags[row] & flag) for flag in SPECIAL)
        if nan or (infinity and minus_infinity):
            sums[row] = np.nan
        elif infinity or minus_infinity:
            sums[row] = np.inf if infinity else -np.inf
        else:
            sums[row] = _nearest(total, -149, np.dtype(np.float32))
    return sums


def _bins(array: NDArray[Any]) -> tuple[Any, Any]:
    """Return (rows, halves, exponents) sums of significands, and (rows,) sums of the infinities and NaN."""
    wide = array.astype(np.float32) if array.dtype == np.float16 else np.ascontiguousarray(array)
    mantissa, exponents, word = (52, 2048, np.int64) if wide.dtype == np.float64 else (23, 256, np.int32)
    bits: Any = wide.view(word)
    exponent = (bits >> mantissa) & (exponents - 1)
    finite = exponent < exponents - 1
    significand = bits & ((1 << mantissa) - 1) | (exponent > 0).astype(word) << mantissa
    signed = np.where(finite, np.where(bits < 0, -significand, significand), 0)
    halves = [signed] if mantissa == 23 else [signed & ((1 << 26) - 1), signed >> 26]
    rows = len(array)
    place = (np.arange(rows)[:, None] * exponents + exponent).ravel()
    sums = [np.bincount(place, h.ravel(), rows * exponents).reshape(rows, exponents).astype(np.int64) for h in halves]
    special = np.where(finite, np.zeros((), wide.dtype), wide).sum(axis=1)
    return np.stack(sums, axis=1), special


def _rounded(bins: NDArray[Any], special: Any, dtype: np.dtype[Any]) -> Any:
    """Return the sum of the bins (halves, exponents) rounded to a dtype, or `special` unless that is 0."""
    if special != 0:  # NaN != 0 holds too
        return special
    total = 0
    for half, exponent in zip(*np.nonzero(bins), strict=True):
        total += int(bins[half, exponent]) << (26 * int(half) + max(int(exponent), 1) - 1)
    return _nearest(total, -1074 if dtype == np.float64 else -149, dtype)


def _nearest(total: int, unit: int, dtype: np.dtype[Any]) -> Any:
    """Return the number of a dtype that is nearest to total * 2**unit, half to even."""
    info = np.finfo(dtype)
    size = abs(total)
    dropped = max(size.bit_length() - info.nmant - 1, info.minexp - info.nmant - unit)
    if dropped > 0:
        kept, rest = size >> dropped, size & ((1 << dropped) - 1)
        half_unit = 1 << (dropped - 1)
        size = (kept + (rest > half_unit or (rest == half_unit and kept & 1))) << dropped
    try:
        value = _scaled(size, unit)
    except OverflowError:
        value = math.inf
    with np.errstate(over="ignore"):
        return dtype.type(-value if total < 0 else value)


def _scaled(size: int, unit: int) -> float:
    """Return size * 2**unit, which a float of 64 bits holds exactly."""
    shift = max(size.bit_length() - 53, 0)
    return math.ldexp(float(size >> shift), shift + unit)
