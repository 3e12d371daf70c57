"""Arrays and numbers of the user, checked: numpy would refuse some with errors of its own, and misread others.

>>> numbers("vertices", [[0, 0, 1]]).dtype
dtype('float64')
"""

from __future__ import annotations

import math
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError


def array_of(what: str, values: Any) -> NDArray[Any]:
    """Return an array of any type; SceneError for rows of different lengths, and for a masked array."""
    # numpy imports np.ma when it is first named, which takes 12 ms: plain arrays and lists need not wait for it.
    if type(values) is not np.ndarray and isinstance(values, np.ndarray) and isinstance(values, np.ma.MaskedArray):
        raise SceneError(f"{what} are real numbers, not a masked array")
    try:
        return np.asarray(values)
    except ValueError:
        raise SceneError(f"{what} are rows of different lengths: give an array of numbers") from None


def numbers(what: str, values: Any) -> NDArray[np.floating[Any]]:
    """Return an array of f32 or f64 with all digits; raise SceneError unless `values` are real numbers."""
    array = array_of(what, values)
    if array.dtype.kind not in "biufO":
        raise SceneError(f"{what} are real numbers, not {array.dtype}")
    if array.dtype in (np.float32, np.float16):
        return array.astype(np.float32, copy=False)
    try:
        return array.astype(np.float64, copy=False)
    except (TypeError, ValueError):
        raise SceneError(f"{what} are real numbers, not {array.dtype}") from None


def three_floats(values: Any) -> tuple[float, float, float] | None:
    """Return three numbers as floats; None for anything else."""
    try:
        x, y, z = map(one_float, values)
    except (TypeError, ValueError):
        return None
    return None if x is None or y is None or z is None else (x, y, z)


def one_float(value: Any) -> float | None:
    """Return a number as a float; None for strings, other objects, and numbers beyond binary64."""
    try:
        return None if isinstance(value, str) else float(value)
    except (TypeError, ValueError, OverflowError):
        return None


def finite_triple(what: str, values: Any) -> tuple[float, float, float]:
    """Return three finite numbers as floats; otherwise raise a SceneError that begins with `what`."""
    triple = three_floats(values)
    if triple is None or not all(map(math.isfinite, triple)):
        raise SceneError(f"{what} is three finite numbers, not {values!r}")
    return triple


def finite_number(what: str, value: Any) -> float:
    """Return a finite number as a float; otherwise raise a SceneError that begins with `what`."""
    number = one_float(value)
    if number is None or not math.isfinite(number):
        raise SceneError(f"{what} is a finite number, not {value!r}")
    return number


def real(word: str) -> float:
    """Read a number as files and commands write it; raise ValueError for other words."""
    return float(_plain(word))


def whole(word: str) -> int:
    """Read a whole number as files write it; raise ValueError for other words."""
    return int(_plain(word))


def _plain(word: str) -> str:
    """Return a word; raise ValueError for numbers of Python alone: with _ between digits, or in other scripts."""
    if "_" in word or not word.isascii():
        raise ValueError(f"{word[:40]!r} is no number")
    return word


def is_whole(value: object, low: int, high: float = math.inf) -> TypeGuard[int]:
    """Return whether a value is an int of Python or numpy in a range, both ends included; a bool is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and low <= int(value) <= high
