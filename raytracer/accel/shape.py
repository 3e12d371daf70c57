"""The tables of the triangles of one object that moves or is deformed, computed anew between two pictures.

Stage: accelerate. Takes the vertices (V, 3) of an object in a kernel's coordinates, rounded to its working precision,
and faces (F, 3); a `Shape` keeps the tables of them. A few thousand triangles at a time are computed, whose numbers the
processor's cache holds, and the memory stays: pages that a process has just got take longer than the arithmetic.

>>> shape = Shape(1, np.dtype(np.float32))
>>> shape.take(np.eye(3), np.array([[0, 1, 2]]), np.empty((3, 4)))
>>> shape.corners.shape, shape.levels.round(3).tolist(), shape.sides.tolist()
((1, 3, 3), [0.577], [[0.0, 0.0, 0.0, -1.0, -1.0, -1.0]])
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.planes import copy_columns, levels_between, normals_between, parts
from raytracer.accel.space import Rows


class Shape:
    """The tables of an object of n triangles for kernels that work in `dtype`.

    `rows` (3n, 4) are those of `triangle_rows`, `levels` (n,) how far their planes are from 0. `sides` (n, 6) are the
    lower corners of the boxes around the triangles and the upper ones with the opposite sign: one minimum joins boxes.
    """

    def __init__(self, count: int, dtype: np.dtype[Any]) -> None:
        self.rows: NDArray[np.floating] = np.empty((0, 4))
        self.levels = np.empty(count)
        self.sides = np.empty((count, 6), dtype)

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.levels)

    @property
    def corners(self) -> Rows:
        """The corners of the triangles, (n, 3, 3)."""
        return self.rows[:, :3].astype(np.float64).reshape(-1, 3, 3)

    def take(self, vertices: Rows, faces: NDArray[np.int64], rows: NDArray[np.floating]) -> None:
        """Compute all tables anew from vertices (V, 3) and faces (n, 3); `rows` is the memory for those."""
        self.rows, columns = rows, np.ascontiguousarray(vertices.T)
        places = rows.reshape(-1, 3, 4)
        for part in parts(len(self)):
            a, b, c = _gathered(columns, faces[part])
            normals = normals_between(a, b, c)
            self.levels[part] = levels_between(a, b, c, normals)
            copy_columns(self.sides[part], np.minimum(np.minimum(a, b), c))
            copy_columns(self.sides[part, 3:], -np.maximum(np.maximum(a, b), c))
            for corner, place in enumerate((a, b, c)):
                copy_columns(places[part, corner], place)
            copy_columns(places[part, :, 3], normals)


def _gathered(columns: Rows, faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the corners of triangles as `by_components` does; `columns` (3, V) are the vertices' components."""
    held = np.empty((3, 3, len(faces)))
    for corner in range(3):
        numbers = np.ascontiguousarray(faces[:, corner])
        for axis in range(3):
            columns[axis].take(numbers, out=held[corner, axis], mode="clip")  # without "clip" numpy fills a copy
    return held.transpose(0, 2, 1)
