"""The planes of triangles: unit normals, and distances from 0 along them.

Stage: accelerate. Takes corners (N, 3, 3), in whatever coordinates.

>>> normals_of(np.array([[[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]]])).tolist()
[[0.0, 0.0, 1.0]]
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Functions(NamedTuple):
    """Functions of two numbers, of a condition and two numbers, and of a number, all on components of many triangles.

    One definition serves numpy's arrays and values of the language, with the same bits: each operation rounds alike.
    """

    min: Callable[[Any, Any], Any]
    max: Callable[[Any, Any], Any]
    cond: Callable[[Any, Any, Any], Any]
    sqrt: Callable[[Any], Any]


ARRAYS = Functions(np.minimum, np.maximum, np.where, np.sqrt)
Vector = Any
"""A sequence of three components: arrays, or values of the language."""


def plane_of(a: Vector, b: Vector, c: Vector, on: Functions = ARRAYS) -> tuple[Vector, Any, Vector, Vector]:
    """Return the unit normal of a triangle, its plane's distance from 0, its box's lower corner, and the upper negated.

    The normal follows the right-hand rule, and is zero for a triangle without area.
    """
    normal = _normal_of(a, b, c, on)
    low, high = ([join(join(a[k], b[k]), c[k]) for k in range(3)] for join in (on.min, on.max))
    return normal, _level_of(a, b, c, normal, on), low, [-side for side in high]


def normals_of(corners: Floats) -> Floats:
    """Return the unit normals (N, 3) of triangles (N, 3, 3), as `plane_of` does."""

    def normal_of(some: Floats) -> Vector:
        a, b, c = _vectors(some)
        return _normal_of(a, b, c, ARRAYS)

    return by_parts(normal_of, corners)


def levels_of(corners: Floats, normals: Floats) -> Floats:
    """Return the distances of the planes of triangles (N, 3, 3) from 0 along their unit normals (N, 3)."""
    a, b, c = _vectors(corners)
    return np.asarray(_level_of(a, b, c, normals.T, ARRAYS))


def _vectors(corners: Floats) -> list[Vector]:
    return [corner.T for corner in by_components(corners)]


def _normal_of(a: Vector, b: Vector, c: Vector, on: Functions) -> Vector:
    # Each edge by itself, so that the product of tiny ones does not vanish.
    edges = ([x - y for x, y in zip(other, a, strict=True)] for other in (b, c))
    (ax, ay, az), (bx, by, bz) = (_scaled(edge, on) for edge in edges)
    return _unit([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], on)


def _level_of(a: Vector, b: Vector, c: Vector, normal: Vector, on: Functions) -> Any:
    # The corner nearest to 0, of which the products are rounded least.
    size, other, last = (_largest(corner, on) for corner in (a, b, c))
    is_b, is_c = other < size, last < on.min(size, other)
    x, y, z = (on.cond(is_c, c[k], on.cond(is_b, b[k], a[k])) * normal[k] for k in range(3))
    return x + y + z


def _unit(vector: Vector, on: Functions) -> Vector:
    safe = _scaled(vector, on)
    return _divided(safe, _length(safe, on), on)


def _scaled(vector: Vector, on: Functions) -> Vector:
    return _divided(vector, _largest(vector, on), on)


def _divided(vector: Vector, by: Any, on: Functions) -> Vector:
    """Divide a vector; zero stays zero."""
    divisor = on.cond(by > 0, by, 1.0)
    return [x / divisor for x in vector]


def _length(vector: Vector, on: Functions) -> Any:
    x, y, z = vector
    return on.sqrt(x * x + y * y + z * z)


def _largest(vector: Vector, on: Functions) -> Any:
    x, y, z = map(abs, vector)
    return on.max(on.max(x, y), z)


def by_components(corners: NDArray[Any]) -> NDArray[Any]:
    """Return the first, second and third corners (3, N, 3) of triangles (N, 3, 3).

    The numbers of one component lie side by side: arithmetic with them takes half the time.
    """
    return np.ascontiguousarray(corners.transpose(1, 2, 0)).transpose(0, 2, 1)


def copy_columns(target: NDArray[Any], values: NDArray[Any]) -> None:
    """Copy vectors (N, n) into the first columns of a table (N, m), each column by itself.

    It takes a half to a third of the time of one assignment, in which numpy goes from one short row to the next.
    """
    for axis in range(values.shape[1]):
        target[:, axis] = values[:, axis]


AT_ONCE = 1 << 13
"""Triangles that are computed at once: from 8,000 to 16,000 took the least time with 1 MiB of cache for each core."""


def parts(count: int) -> Iterator[slice]:
    """Yield slices that cover `count` triangles, AT_ONCE in each but the last."""
    for start in range(0, count, AT_ONCE):
        yield slice(start, start + AT_ONCE)


def by_parts(vector_of: Callable[[Any], Vector], items: NDArray[Any]) -> Floats:
    """Return the vectors (N, 3) of N items, some thousands of which are computed at once."""
    vectors = np.empty((len(items), 3))
    for part in parts(len(items)):
        for axis, column in enumerate(vector_of(items[part])):
            vectors[part, axis] = column
    return vectors


def constant(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array read-only and return it: an `sh.Table` with `copy=False` shares it."""
    array.flags.writeable = False
    return array


def unit(vectors: Floats) -> Floats:
    """Divide each vector (..., 3) by its length; zero stays zero."""
    flat = vectors.reshape(-1, 3)
    return by_parts(lambda some: _unit(np.ascontiguousarray(some.T), ARRAYS), flat).reshape(vectors.shape)


def lengths_of(vectors: Floats) -> Floats:
    """Return the lengths of vectors (..., 3), to the bit those of `np.linalg.norm`, several times as fast."""
    return np.asarray(_length(np.moveaxis(vectors, -1, 0), ARRAYS))


def largest_of(vectors: NDArray[np.floating]) -> Floats:
    """Return the largest magnitude among the three components of each vector (..., 3)."""
    return np.asarray(_largest(np.moveaxis(vectors, -1, 0), ARRAYS))
