"""Functions of numbers and vectors that numpy and shading languages have.

Stage: record. Each is composed of operations of the table, so every backend gives the same bits.
"""

from __future__ import annotations

from typing import Any

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.lang.values.builtins import hypot, isinf, isnan, log10, mix
from shpy.lang.values.matrix import MATRICES
from shpy.lang.values.value import CLASSES, Value
from shpy.library.operands import vector

__all__ = ["hypot", "isfinite", "lerp", "log10", "outer"]


def lerp(a: Any, b: Any, t: Any) -> Any:
    """Interpolate from a at t = 0 to b at t = 1: a * (1 - t) + b * t, which is sh.mix. Both ends are exact.

    The order is that of HLSL; Sh's is lerp(t, b, a).
    """
    return mix(a, b, t)


def isfinite(x: Any) -> Any:
    """Return whether x is neither infinite nor NaN, component-wise."""
    return ~(isnan(x) | isinf(x))


def outer(a: Any, b: Any) -> Any:
    """Return the matrix of the products a[r] * b[c] of two vectors of 2 to 4 components.

    It is numpy's outer and GLSL's outerProduct. Raises ShpyTypeError for vectors of two sizes.
    """
    rows, columns = (vector(v, (2, 3, 4), "sh.library.outer") for v in (a, b))
    if rows.size != columns.size:
        raise ShpyTypeError(
            f"sh.library.outer takes two vectors of one size, not {rows.size} and {columns.size} components",
            loc=here(),
            cure="sh.library.outer(a.xyz, b.xyz)",
        )
    return MATRICES[f"Matrix{rows.size}f"](*(rows[r] * _plain(columns) for r in range(rows.size)))


def _plain(v: Value) -> Any:
    return CLASSES["Attrib", v.size, v.base](v)
