"""Arrays of a run, compared and shown: leaves of an output, bits and denormals.

Stage: test. Takes what kernels take and give.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "bits_differ", "differing", "flat_leaves", "is_denormal"]

Array = NDArray[Any]


def flat_leaves(outputs: Any) -> list[Array]:
    """The arrays of an output, whatever its structure."""
    if isinstance(outputs, np.ndarray | np.generic):
        return [np.asarray(outputs)]
    parts: Any = outputs
    if isinstance(outputs, dict):
        parts = outputs.values()
    elif not isinstance(outputs, tuple | list):
        parts = vars(outputs).values()
    return [leaf for part in parts for leaf in flat_leaves(part)]


def differing(a: Array, b: Array) -> Array:
    """Where two arrays differ in any bit; NaNs are all the same."""
    if a.dtype.kind != "f":
        return np.asarray(a != b)
    equal = (a == b) & (np.signbit(a) == np.signbit(b))
    return np.asarray(~(equal | (np.isnan(a) & np.isnan(b))))


def bits_differ(a: Any, b: Any) -> bool:
    """Whether two values differ in any bit; NaNs are all the same."""
    return bool(differing(np.asarray(a), np.asarray(b)).any())


def is_denormal(value: Any) -> bool:
    """Whether a component is a denormal, or the least number that is none: a device may flush before it rounds."""
    array = np.asarray(value)
    if array.dtype.kind != "f":
        return False
    return bool(((array != 0) & (np.abs(array) <= np.finfo(array.dtype).tiny)).any())
