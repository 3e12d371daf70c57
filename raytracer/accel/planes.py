"""The planes of triangles: unit normals, and distances from 0 along them.

Stage: accelerate. Takes corners (N, 3, 3), in whatever coordinates.

>>> normals_of(np.array([[[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]]])).tolist()
[[0.0, 0.0, 1.0]]
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def normals_of(corners: Floats) -> Floats:
    """Return the unit normals (N, 3) of triangles (N, 3, 3), by the right-hand rule; zero for one without area."""
    return np.ascontiguousarray(normals_between(*by_components(corners)))


def normals_between(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return the unit normals (N, 3) of triangles with these corners, (N, 3) each, as `by_components` gives them."""
    # Each edge by itself, so that the product of tiny ones does not vanish.
    (ax, ay, az), (bx, by, bz) = scaled(b - a).T, scaled(c - a).T
    across = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    return unit(across.T)


def levels_of(corners: Floats, normals: Floats) -> Floats:
    """Return the distances of the planes of triangles (N, 3, 3) from 0 along their unit normals (N, 3)."""
    a, b, c = by_components(corners)
    return levels_between(a, b, c, normals)


def levels_between(a: Floats, b: Floats, c: Floats, normals: Floats) -> Floats:
    """Return what `levels_of` does, of corners (N, 3) each, as `by_components` gives them."""
    size, other, last = map(largest_of, (a, b, c))
    is_b, is_c = other < size, last < np.minimum(size, other)
    # The corner nearest to 0, of which the products are rounded least. Each sum by itself: what einsum gives depends on
    # how arrays lie in memory.
    x, y, z = (np.where(is_c, c.T[k], np.where(is_b, b.T[k], a.T[k])) * normals[:, k] for k in range(3))
    return np.asarray(x + y + z)


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
    """Yield slices of so many triangles, each of as many as a processor's cache holds with all that follows of them."""
    for start in range(0, count, AT_ONCE):
        yield slice(start, start + AT_ONCE)


def constant(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array read-only and return it: an `sh.Table` takes it without a copy."""
    array.flags.writeable = False
    return array


def unit(vectors: Floats) -> Floats:
    """Divide each vector by its length; zero stays zero."""
    safe = scaled(vectors)
    length = lengths_of(safe)[..., None]
    return np.asarray(safe / np.where(length > 0, length, 1))


def scaled(vectors: Floats) -> Floats:
    """Divide each vector by its largest component; zero stays zero."""
    largest = largest_of(vectors)[..., None]
    return np.asarray(vectors / np.where(largest > 0, largest, 1))


def lengths_of(vectors: Floats) -> Floats:
    """Return the lengths of vectors (..., 3), to the bit those of `np.linalg.norm`."""
    x, y, z = (vectors[..., axis] for axis in range(3))
    return np.asarray(np.sqrt(x * x + y * y + z * z))  # several times as fast as a sum along an axis of three


def largest_of(vectors: NDArray[np.floating]) -> Floats:
    """Return the largest magnitude among the three components of each vector."""
    x, y, z = (np.abs(vectors[..., axis]) for axis in range(3))
    return np.asarray(np.maximum(np.maximum(x, y), z))  # several times as fast as max along an axis of three
