"""The kernel that computes the planes and boxes of triangles, with the numbers that `accel.planes` gives.

Stage: accelerate. For objects that change between two pictures: a device computes with several triangles at a time.

>>> import numpy as np
>>> kernel = plane_program().compile("numpy", precision="f64")
>>> plane = kernel(np.array([[0, 1, 2]], np.int32), sh.Table(np.eye(3) + 1, sh.Attrib3f))
>>> plane.level.round(3).tolist(), plane.low.tolist(), plane.high.tolist()
([2.309], [[1.0, 1.0, 1.0]], [[-2.0, -2.0, -2.0]])
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import shpy as sh
from raytracer.accel.planes import Functions, plane_of


class Plane(NamedTuple):
    """A triangle's unit normal, its plane's distance from 0, its box's lower corner, and the upper one negated."""

    normal: sh.Attrib3f
    level: sh.Attrib1f
    low: sh.Attrib3f
    high: sh.Attrib3f


@cache
def plane_kernel(backend: str) -> Any:
    """Return the kernel that takes the vertices' numbers (n, 3), and a table of the vertices, for a `Plane` of each.

    It works in binary64. Return None where a device has none, and on numpy, where functions that are written out in
    `accel.planes` take less time.
    """
    if backend == "numpy":
        return None
    try:
        return plane_program().compile(backend, precision="f64")
    except sh.CompileError as error:
        if error.lacks != "f64":
            raise
        return None


def plane_program() -> Any:
    """Record the program of the kernel."""

    @sh.program
    def plane(face: sh.Attrib3i, vertices: sh.Table[sh.Attrib3f]) -> Plane:
        a, b, c = ([vertices[face[corner]][axis] for axis in range(3)] for corner in range(3))
        normal, level, low, high = plane_of(a, b, c, Functions(sh.min, sh.max, sh.cond, sh.sqrt))
        return Plane(sh.Attrib3f(*normal), level, sh.Attrib3f(*low), sh.Attrib3f(*high))

    return plane
