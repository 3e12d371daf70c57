"""Bounds of numbers in kernels: the largest distance, and the lower and the higher of numbers that are never NaN.

Stage: accelerate. Comparisons cost less than `sh.min` and `sh.max`, which have to look for NaN.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np

import shpy as sh

FAR = 3.0e38
"""Farther than anything: as good as infinity, but `FAR * 0` is 0."""


def far(kind: Any = sh.Attrib1u) -> Any:
    """Return FAR in a kernel of any precision, as a vector where `kind` is Attrib3u; at f16 it is infinite."""
    return rounded(FAR, kind)


def rounded(number: float, kind: Any = sh.Attrib1u) -> Any:
    """Return a number in a kernel of any precision, where f16 refuses a literal that it does not hold.

    Its bits, a constant of `kind`, are those of f32. The kernel converts them to its precision, as it does data.
    """
    return sh.float_from_bits(kind(int(np.float32(number).view(np.uint32))))


def lower(a: Any, b: Any) -> Any:
    """Return the lower of two numbers that are never NaN, which costs less than `min`."""
    return sh.cond(a < b, a, b)


def higher(a: Any, b: Any) -> Any:
    """Return the higher of two numbers that are never NaN."""
    return sh.cond(a < b, b, a)


def lowest(*numbers: Any) -> Any:
    """Return the lowest of numbers that are never NaN."""
    return reduce(lower, numbers)


def highest(*numbers: Any) -> Any:
    """Return the highest of numbers that are never NaN."""
    return reduce(higher, numbers)
