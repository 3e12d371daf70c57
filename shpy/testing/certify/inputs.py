"""Inputs of the sweeps: the same on every machine, made by arithmetic on integers alone.

Stage: test. numpy's random numbers and functions may change with its version and with the processor.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shpy.testing.arrays import Array

MANTISSAS = 2048
"""Mantissas for each exponent and sign."""
PARTS = 64
"""Parts of all float32 numbers, by the first six bits."""
_PART = (1 << 32) // PARTS
_CHUNK = 1 << 22


def scattered(count: int, seed: int) -> Array:
    """Return `count` uint32 numbers that look drawn at random."""
    with np.errstate(over="ignore"):
        x = np.arange(1, count + 1, dtype=np.uint32) * np.uint32(0x9E3779B9) + np.uint32(seed * 0x85EBCA6B % 2**32)
        for shift, factor in ((16, 0x21F0AAAD), (15, 0x735A2D97)):
            x = (x ^ (x >> np.uint32(shift))) * np.uint32(factor)
        return x ^ (x >> np.uint32(15))


def fractions(count: int, seed: int) -> Array:
    """Return `count` float32 numbers in [0, 1): multiples of 2**-24."""
    return (scattered(count, seed) >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-24)


def no_denormals(*arrays: Array) -> tuple[Array, ...]:
    """Return the elements of which no component is a denormal."""
    kept = np.ones(arrays[0].shape, np.bool_)
    for a in arrays:
        kept &= (np.abs(a) >= np.finfo(a.dtype).tiny) | (a == 0) | np.isnan(a)
    return tuple(a[kept] for a in arrays)


def sweep(mantissas: int = MANTISSAS) -> Array:
    """Return float32 numbers of every exponent and sign, `mantissas` of each, infinities, NaN, no denormals."""
    low = scattered(512 * mantissas, 1) & np.uint32(0x7FFFFF)
    low[::mantissas] = 0  # the powers of two, the zeros and the infinities
    low[1::mantissas] = 0x7FFFFF  # and the numbers just below them
    high = np.repeat(np.arange(512, dtype=np.uint32) << np.uint32(23), mantissas)
    return no_denormals((high | low).view(np.float32))[0]


def pairs(count: int, seed: int, arity: int = 2) -> tuple[Array, ...]:
    """Return `arity` arrays of any float32 numbers in the first half, numbers beside 1 in the second; no denormals."""
    arrays = []
    for k in range(arity):
        bits = scattered(count, seed + k)
        moderate = (bits & np.uint32(0x87FFFFFF)) + np.uint32(0x3C000000)  # from 2**-7 to 2**9, of either sign
        arrays.append(np.where(np.arange(count) < count // 2, bits, moderate).astype(np.uint32).view(np.float32))
    return no_denormals(*arrays)


def everything(part: int) -> Iterator[Array]:
    """Yield the float32 numbers of a part that are no denormals, in chunks."""
    for first in range(part * _PART, (part + 1) * _PART, _CHUNK):
        x = np.arange(first, first + _CHUNK, dtype=np.uint64).astype(np.uint32).view(np.float32)
        kept = no_denormals(x)[0]
        if len(kept):
            yield kept
