"""The functions in mpmath, and how its numbers round to binary32: what the oracle itself is compared with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp

_BY_NAME = ("sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "log10", "sinh", "cosh", "tanh",
            "asinh", "acosh", "atanh", "erf", "erfc", "sinpi", "cospi", "expm1", "log1p")  # fmt: skip

EXACT: dict[str, Callable[[Any], Any]] = {
    **{name: getattr(mp, name) for name in _BY_NAME},
    "cbrt": lambda x: mp.sign(x) * mp.cbrt(abs(x)),
    "exp10": lambda x: mp.power(10, x),
    "exp2": lambda x: mp.power(2, x),
    "log2": lambda x: mp.log(x) / mp.log(2),
    "rsqrt": lambda x: 1 / mp.sqrt(x),
}
"""Each function in the working precision of mpmath."""


def nearest(value: Any) -> float:
    """Return the binary32 nearest to a number, denormals included; ties go to the even mantissa."""
    step = max(mp.frexp(value)[1] - 24, -149)
    rounded = float(mp.ldexp(mp.nint(mp.ldexp(value, -step)), step))
    return rounded if abs(rounded) < 2.0**128 else float("inf") * (1 if rounded > 0 else -1)
