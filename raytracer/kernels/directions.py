"""Unit vectors about an axis, the mirrored ray, and the largest channel of a colour.

Stage: kernel.
"""

from __future__ import annotations

from math import pi
from typing import Any

import shpy as sh


def around(axis: Any, cosine: Any, turn: Any) -> Any:
    """Return the unit vector at an angle of this cosine to the unit `axis`, turned about it by `turn` of a circle."""
    across, beside = frame(axis)
    angle = (2 * pi) * turn
    sine = sh.sqrt(sh.max(1 - cosine * cosine, 0.0))
    return sh.normalize((sine * sh.cos(angle)) * across + (sine * sh.sin(angle)) * beside + cosine * axis)


def frame(axis: Any) -> tuple[Any, Any]:
    """Return two unit vectors across a unit vector and each other (Duff and others 2017)."""
    sign = sh.cond(axis.z < 0, -1.0, 1.0)
    a = -1 / (sign + axis.z)
    b = axis.x * axis.y * a
    across = sh.Vector3f(1 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x)
    return across, sh.Vector3f(b, sign + axis.y * axis.y * a, -axis.y)


def mirrored(surface: Any) -> Any:
    """Return the mirrored ray, turned back outside where an interpolated normal would send it into the surface."""
    mirrored = sh.reflect(-surface.view, surface.normal)
    below = sh.min(sh.dot(mirrored, surface.face), 0.0)
    return mirrored - (2 * below) * surface.face


def largest(color: Any) -> Any:
    """Return the largest of a colour's components."""
    return sh.max(color.x, color.y, color.z)
