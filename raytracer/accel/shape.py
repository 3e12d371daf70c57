"""The tables of the triangles of one object that moves or is deformed, computed anew between two pictures.

Stage: accelerate. Takes the vertices (V, 3) of an object in a kernel's coordinates, rounded to its working precision,
and faces (F, 3); a `Shape` keeps the tables of them. The planes of many triangles are computed by a kernel, those of
few with numpy, which gives the same numbers: 70,000 triangles take 2.9 ms of CPU time instead of 5.0 ms. Numpy does a
few thousand triangles at a time, whose numbers the processor's cache holds. The memory stays: pages that a process has
just got take longer than the arithmetic.

>>> shape = Shape(1, np.dtype(np.float32))
>>> shape.take(np.eye(3), np.array([[0, 1, 2]]), np.empty((3, 4)))
>>> shape.corners.shape, shape.levels.round(3).tolist(), shape.sides.tolist()
((1, 3, 3), [0.577], [[0.0, 0.0, 0.0, -1.0, -1.0, -1.0]])
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.planes import Functions, constant, copy_columns, parts, plane_of
from raytracer.accel.space import Rows

MANY = 20_000
"""Triangles from which on a kernel takes less time than numpy.

In times of numpy: 3.62 for 1,024 triangles, 1.07 for 16,384, 0.87 for 25,600 and 0.34 for 69,696 (OpenCL on two cores).
"""


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


class Shape:
    """The tables of an object of n triangles for kernels that work in `dtype`.

    `rows` (3n, 4) are those of `triangle_rows`, `levels` (n,) how far their planes are from 0. `sides` (n, 6) are the
    lower corners of the boxes around the triangles and the upper ones with the opposite sign: one minimum joins boxes.
    The `backend` that computes them makes no difference to them.
    """

    def __init__(self, count: int, dtype: np.dtype[Any], backend: str = "numpy") -> None:
        self.rows: NDArray[np.floating] = np.empty((0, 4))
        self.levels = np.empty(count)
        self.sides = np.empty((count, 6), dtype)
        self.kernel = plane_kernel(backend) if count >= MANY else None
        self._faces: tuple[Any, Any] = None, None
        self._vertices: sh.Table[Any] | None = None

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.levels)

    @property
    def corners(self) -> Rows:
        """The corners of the triangles, (n, 3, 3)."""
        return self.rows[:, :3].astype(np.float64).reshape(-1, 3, 3)

    def take(self, vertices: Rows, faces: NDArray[np.int64], rows: NDArray[np.floating]) -> None:
        """Compute all tables anew from vertices (V, 3) and faces (n, 3); `rows` is the memory for those."""
        self.rows = rows
        padded = np.zeros((len(vertices), 4), rows.dtype)
        copy_columns(padded, vertices)
        padded.take(faces.reshape(-1), axis=0, out=rows, mode="clip")  # without "clip" numpy fills a copy
        if self.kernel is None:
            self._compute(vertices, faces)
        else:
            self._run(vertices, faces)

    def _compute(self, vertices: Rows, faces: NDArray[np.int64]) -> None:
        columns, normals_at = np.ascontiguousarray(vertices.T), self._normals
        for part in parts(len(self)):
            normal, self.levels[part], low, high = plane_of(*_gathered(columns, faces[part]))
            for axis, column in enumerate((*low, *high)):
                self.sides[part, axis] = column
            for axis, column in enumerate(normal):
                normals_at[part, axis] = column

    def _run(self, vertices: Rows, faces: NDArray[np.int64]) -> None:
        if self._faces[0] is not faces:
            self._faces = faces, constant(faces.astype(np.int32))
        if self._vertices is None or len(self._vertices) != len(vertices):
            self._vertices = sh.Table(vertices, sh.Attrib3f, "vertices")
        else:
            self._vertices.update(vertices)
        assert self.kernel is not None
        normals, self.levels[:], low, high = self.kernel(self._faces[1], self._vertices)
        self._normals[:] = normals
        copy_columns(self.sides, low)
        copy_columns(self.sides[:, 3:], high)

    @property
    def _normals(self) -> NDArray[np.floating]:
        """The place of the normals (n, 3) in the rows."""
        return self.rows.reshape(-1, 3, 4)[:, :, 3]


def _gathered(columns: Rows, faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the corners of triangles, (3, 3, n), each by its components, from those of the vertices, (3, V)."""
    corners = np.empty((3, 3, len(faces)))
    for corner in range(3):
        numbers = np.ascontiguousarray(faces[:, corner])
        for axis in range(3):
            columns[axis].take(numbers, out=corners[corner, axis], mode="clip")  # without "clip" numpy fills a copy
    return corners
