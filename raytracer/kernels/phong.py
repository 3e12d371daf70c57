"""Phong's reflection model (Phong 1975): the light that a lit point sends to the viewer.

Stage: kernel. Recorded into the tracer, once.
"""

from __future__ import annotations

from typing import Any

import shpy as sh


def diffuse_lobe(normal: Any, light: Any) -> Any:
    """Return the cosine between the unit vectors `normal` and `light`; 0 for a light behind the surface."""
    return sh.max(sh.dot(normal, light), 0.0)


def highlight(view: Any, normal: Any, light: Any, shininess: Any) -> Any:
    """Return the share of a light that a shiny surface mirrors to the viewer; `view` and `light` point away from it."""
    mirrored = sh.reflect(-light, normal)
    along = sh.dot(mirrored, view)
    strength = sh.pow(sh.saturate(along), shininess)  # a cosine that rounding makes greater than 1 has large powers
    return sh.cond((sh.dot(normal, light) > 0) & (along > 0), strength, 0.0)
