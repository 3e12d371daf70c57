"""Arrays of a run, compared and shown: leaves of an output, bits and denormals.

Stage: test. Takes the inputs and outputs of kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.units import steps

Array = NDArray[Any]


def flat_leaves(outputs: Any) -> list[Array]:
    """Return the arrays of an output, whatever its structure."""
    if isinstance(outputs, np.ndarray | np.generic):
        return [np.asarray(outputs)]
    parts: Any = outputs
    if isinstance(outputs, dict):
        parts = outputs.values()
    elif not isinstance(outputs, tuple | list):
        parts = vars(outputs).values()
    return [leaf for part in parts for leaf in flat_leaves(part)]


def differing(a: Array, b: Array) -> Array:
    """Return a mask of the elements that differ in any bit; all NaNs are equal."""
    if a.dtype.kind != "f":
        return np.asarray(a != b)
    equal = (a == b) & (np.signbit(a) == np.signbit(b))
    return np.asarray(~(equal | (np.isnan(a) & np.isnan(b))))


@dataclass(frozen=True)
class Bound:
    """The largest distance of two results: `ulp` numbers, or atol + rtol * |first|; all 0 asks for the same bits."""

    ulp: float = 0
    atol: float = 0
    rtol: float = 0

    def __post_init__(self) -> None:
        """Raise ShpyTypeError for anything but numbers from 0 on."""
        for name, number in vars(self).items():
            if not (isinstance(number, float | int | np.number) and number >= 0):
                raise ShpyTypeError(f"{name}={number!r} is no distance of results", loc=here(), cure=f"{name}=2")

    @property
    def exact(self) -> bool:
        """Return whether it asks for the same bits."""
        return not (self.ulp or self.atol or self.rtol)

    def exceeded(self, a: Array, b: Array) -> Array:
        """Return a mask of the elements whose distance exceeds the bound."""
        wrong = differing(a, b)
        if a.dtype.kind == "f" and not self.exact:
            with np.errstate(all="ignore"):
                away = np.abs(a.astype(np.float64) - b.astype(np.float64))
                near = away <= self.atol + self.rtol * np.abs(a.astype(np.float64))
            wrong &= ~((steps(a, b) <= self.ulp) | near)
        return wrong

    def parts(self, a: Any, b: Any) -> bool:
        """Return whether two values are further apart in any component."""
        return bool(self.exceeded(np.atleast_1d(a), np.atleast_1d(b)).any())


EXACT = Bound()
"""The same bits."""


def is_denormal(value: Any) -> bool:
    """Return whether a component is a denormal or the least normal number: a device may flush before it rounds."""
    array = np.asarray(value)
    if array.dtype.kind != "f":
        return False
    return bool(((array != 0) & (np.abs(array) <= np.finfo(array.dtype).tiny)).any())
