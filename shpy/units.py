"""Distances in units in the last place, and a budget in these units.

Stage: measure. Takes arrays of floats, gives their distances in the last place of the number that is judged.

>>> ulp(np.float32([1.0, 1.0000002]), np.float64([1.0, 1.0]))
array([0., 2.])
>>> ulp(4)
ulp(4)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Budget:
    """The most error that is wanted: `limit` in `unit`, "ulp" or "relative", for every element."""

    limit: float
    unit: str = "ulp"

    def __repr__(self) -> str:
        return f"{self.unit}({self.limit:g})"

    @classmethod
    def parse(cls, text: str) -> Budget:
        """Parse a command line's `2ulp`, or `1e-3` (a relative error); ValueError for anything else."""
        number = text.strip().lower()
        if number.endswith("ulp"):
            return cls(_positive(number.removesuffix("ulp")))
        return cls(_positive(number), "relative")


def _positive(text: str) -> float:
    number = float(text)
    if not number >= 0:
        raise ValueError(f"an error is not negative: {text}")
    return number


@overload
def ulp(found: float) -> Budget: ...
@overload
def ulp(found: Any, exact: Any) -> Array: ...
def ulp(found: Any, exact: Any = None) -> Budget | Array:
    """Return a budget, `ulp(4)`, or the errors of results, `ulp(found, exact)`, in units in the last place.

    `found` is an array of floats, in which ints count as binary64. `exact` has the same shape, and the same type or a
    wider one, such as mpmath's numbers. See `ulps`.
    """
    if exact is None:
        return Budget(found)
    reference = np.asarray(exact)
    with np.errstate(all="ignore"):
        high = reference.astype(np.float64)
        rest = np.where(np.isfinite(high), reference - high, 0).astype(np.float64)
    judged = np.asarray(found)
    return ulps(judged.astype(np.float64) if judged.dtype.kind in "iu" else judged, high, rest=rest)


def ulps(results: Array, exact: Array, *, dtype: Any = None, rest: Array | None = None) -> Array:
    """Return |results - exact| in units in the last place of `exact` in the type of `results` (or in `dtype`), float64.

    The unit is the spacing of the numbers around `exact`: below the least normal number that of the denormals (as in
    OpenCL C 3.0 section 7.4), past the largest finite one that of the largest. Two NaNs are 0 apart, a NaN and a number
    infinitely; an infinity and what rounds to it 0. `rest` is the difference between the exact number and `exact`,
    which is in float64.
    """
    info = np.finfo(dtype or results.dtype)
    with np.errstate(all="ignore"):
        wide = exact.astype(np.float64)
        magnitude = np.clip(np.abs(wide), float(info.tiny), float(info.max))
        unit = np.ldexp(1.0, np.frexp(magnitude)[1] - 1 - info.nmant)
        difference = results.astype(np.float64) - wide
        if rest is not None:
            difference = difference - rest
        away = np.abs(difference) / unit
        rounded = exact.astype(results.dtype)
    same = (results == rounded) & ~np.isfinite(results)
    same |= np.isnan(results) & np.isnan(wide)
    return np.asarray(np.where(same, 0.0, np.where(np.isnan(away), np.inf, away)))


def relative(found: Array, exact: Array) -> Array:
    """|found - exact| / |exact|, float64.

    0 where both are equal, both NaN, or infinite as `exact` rounds; infinite where only one is 0 or NaN or infinite.
    """
    with np.errstate(all="ignore"):
        wide, values = exact.astype(np.float64), found.astype(np.float64)
        away = np.abs(values - wide) / np.abs(wide)
        same = (values == wide) | (np.isnan(values) & np.isnan(wide))
        same |= ~np.isfinite(found) & (found == exact.astype(found.dtype))
    return np.asarray(np.where(same, 0.0, np.where(np.isnan(away), np.inf, away)))


def steps(a: Array, b: Array) -> Array:
    """Count the numbers of their type between two arrays of floats of one type, as float64.

    0 between the two zeros and between NaNs; infinite between a NaN and a number.
    """
    integer: Any = {2: np.int16, 4: np.int32, 8: np.int64}[a.dtype.itemsize]

    def place(x: Array) -> tuple[Array, Array]:
        bits = np.ascontiguousarray(x).view(integer).astype(np.int64).reshape(x.shape)
        return bits < 0, np.asarray(bits & np.int64(np.iinfo(integer).max))

    (minus_a, at_a), (minus_b, at_b) = place(a), place(b)
    # The distance of two doubles of different signs may exceed int64.
    across = at_a.astype(np.float64) + at_b.astype(np.float64)
    apart = np.where(minus_a == minus_b, np.abs(at_a - at_b).astype(np.float64), across)
    nan_a, nan_b = np.isnan(a), np.isnan(b)
    return np.asarray(np.where(nan_a & nan_b, 0.0, np.where(nan_a | nan_b, np.inf, apart)))
