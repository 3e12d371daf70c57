"""Choose the backend of the kernels that build a hierarchy. Every backend gives the same hierarchy.

Stage: accelerate.

>>> target_for(1000, "opencl"), target_for(10**6, "opencl")
('numpy', 'opencl')
"""

from __future__ import annotations

MANY = 1 << 16
"""Triangles from which on a backend that compiles the kernels takes less time than numpy."""


def target_for(triangles: int, backend: str) -> str:
    """Return the backend that builds a hierarchy over `triangles`: `backend` from `MANY` on, numpy below."""
    return backend if triangles >= MANY else "numpy"
