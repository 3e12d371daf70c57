"""The entries of a glTF document: their parts, checked, and the reason where one of them is bad.

Stage: scene description. An entry is an object of JSON. What is wrong with it is a SceneError that names the part.

>>> numbers_of({"scale": [1, 2, 3]}, "scale", (1, 1, 1))
[1.0, 2.0, 3.0]
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from raytracer.arrays import is_whole, one_float
from raytracer.errors import SceneError
from raytracer.meshes.folder import shown

BROKEN: Final = (SceneError, KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError)
"""The exceptions by which a reader meets a bad entry."""


def needed(entry: Mapping[str, Any], key: str) -> Any:
    """Return a part that an entry must have; SceneError where it is missing."""
    if key not in entry:
        raise SceneError(f"it has no {key}")
    return entry[key]


def table(entry: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Return a part that is an object, {} where it is missing; SceneError for anything else."""
    part = entry.get(key, {})
    if not isinstance(part, dict):
        raise SceneError(f"its {key} is {shown(str(part))}, not an object")
    return part


def rows(entry: Mapping[str, Any], key: str) -> list[Any]:
    """Return a part that is a list, [] where it is missing; SceneError for anything else."""
    part = entry.get(key, [])
    if not isinstance(part, list):
        raise SceneError(f"its {key} is {shown(str(part))}, not a list")
    return part


def count_of(entry: Mapping[str, Any], key: str, default: int | None = None) -> int:
    """Return a part that is a number of elements or bytes; SceneError for anything else."""
    part = needed(entry, key) if default is None else entry.get(key, default)
    if not is_whole(part, 0):
        raise SceneError(f"its {key} is {shown(str(part))}, not a whole number from 0 on")
    return part


def number_of(entry: Mapping[str, Any], key: str, default: float) -> float:
    """Return a part that is a finite number; SceneError for anything else."""
    return _finite(entry.get(key, default), key)


def numbers_of(entry: Mapping[str, Any], key: str, default: Sequence[float]) -> list[float]:
    """Return a part that is a list of finite numbers, as many as the default has; SceneError for anything else."""
    part = entry.get(key, default)
    if not isinstance(part, list | tuple) or len(part) != len(default):
        raise SceneError(f"its {key} is {shown(str(part))}, not {len(default)} numbers")
    return [_finite(value, key) for value in part]


def _finite(value: Any, key: str) -> float:
    number = None if isinstance(value, bool) else one_float(value)
    if number is None or not math.isfinite(number):
        raise SceneError(f"its {key} has {shown(str(value))}, which is not a finite number")
    return number


def reason_of(error: BaseException) -> str:
    """Return the cause of a fault that a reader met: the words of our own errors, and no others."""
    if isinstance(error, SceneError):
        return str(error)
    return f"it lacks {error}" if isinstance(error, KeyError) else "a part of it is of the wrong kind"
