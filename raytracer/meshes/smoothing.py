"""Normals at the corners of triangles: means of the faces that meet there at small angles.

Stage: scene description. Takes vertices (V, 3) and faces (F, 3). A place is a number for all vertices with the same
coordinates. At most places all faces are near each other, and one sum serves all corners; the others compare pairs.

>>> roof = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, -1]])
>>> normals_at_corners(roof, np.array([[0, 2, 1], [0, 1, 3]]), 45.0)[:, 0].tolist()
[[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.planes import Vector, by_components, by_parts, normals_of, parts, unit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_MARGIN = 1e-6
"""The least difference between the cosine to the mean and the cosine of half the angle, for faces that share one sum.

For two unit vectors the cosine between them is then above the limit by 1e-12 at least, and products round by 1e-15.
"""
_CROWDED = 64
"""Faces at a place from which on those with nearly the same normal are taken together."""
_STEPS = 16
"""Into how many steps components of normals are cut for that."""
_PAIRS_AT_ONCE = 1 << 15
"""Pairs of faces that are compared at once: a processor's cache holds their vectors."""


def normals_at_corners(vertices: Floats, faces: Ints, below: float) -> Floats:
    """Return normals (F, 3, 3): the mean, by area, of the faces that meet at less than `below` degrees at each corner.

    Where faces cancel each other, a corner has the normal of its own face, which is zero for a face without area.
    """
    widest = float(np.cos(np.radians(below)))
    weighted = by_parts(lambda some: _across(vertices.take(some, axis=0)), faces)
    units = unit(weighted)
    place = _places(vertices)[faces].reshape(-1)
    crowded = np.bincount(place) > _CROWDED
    order = -1 if crowded.any() else 1  # the order of faces decides the last bits of each sum
    means = unit(_sums(weighted, place, order))
    is_mixed = crowded | _mixed(means, units, place, widest)
    normals = means.take(place, axis=0)
    for chosen in _by_places(is_mixed & ~crowded, place):
        face = chosen[:, ::order] // 3
        corner_normals = _means_of_near(units.take(face, axis=0), weighted.take(face, axis=0), widest)
        normals[chosen[:, ::order].reshape(-1)] = corner_normals.reshape(-1, 3)
    if crowded.any():
        chosen = np.flatnonzero(crowded[place])
        face = chosen // 3
        normals[chosen] = _means_of_groups(place[chosen], units[face], weighted[face], widest)
    normals = normals.reshape(-1, 3, 3)
    for part in parts(len(faces)):
        empty = ~(
            normals[part, :, 0].astype(bool) | normals[part, :, 1].astype(bool) | normals[part, :, 2].astype(bool)
        )
        if empty.any():
            own = np.where(units[part].any(axis=1, keepdims=True), units[part], normals_of(vertices[faces[part]]))
            normals[part] = np.where(empty[..., None], own[:, None], normals[part])
    return normals


def _across(corners: Floats) -> Vector:
    """Return normals of triangles (N, 3, 3) whose lengths are twice the areas."""
    a, b, c = (corner.T for corner in by_components(corners))
    (ax, ay, az), (bx, by, bz) = b - a, c - a
    return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]


def _places(vertices: Floats) -> Ints:
    """Return a number for each vertex (V, 3), the same for those at the same place."""
    order = np.lexsort(vertices.T)
    ordered = vertices[order]
    number = np.zeros(len(order), np.int64)
    number[order[1:]] = np.cumsum((ordered[1:] != ordered[:-1]).any(axis=1))
    return number


def _sums(weighted: Floats, place: Ints, order: int) -> Floats:
    """Return the sums of the faces at each place, added in the order of their corners, for -1 from the last."""
    columns = [np.bincount(place[::order], weights=np.repeat(weighted[::order, axis], 3)) for axis in range(3)]
    return np.stack(columns, axis=1)


def _mixed(means: Floats, units: Floats, place: Ints, widest: float) -> NDArray[np.bool_]:
    """Return at which places a face is farther from the mean than half the angle.

    Two faces that are nearer are nearer to each other than the angle. A face without area counts as far.
    """
    least = np.cos(np.arccos(widest) / 2) + _MARGIN
    mask = np.zeros(len(means), bool)
    corners = place.reshape(-1, 3)
    for part in parts(len(units)):
        some, (x, y, z) = corners[part], np.ascontiguousarray(units[part].T)
        for column in np.ascontiguousarray(some.T):
            along = means.take(column, axis=0).T
            mask[column[~(along[0] * x + along[1] * y + along[2] * z > least)]] = True
    return mask


def _by_places(chosen: NDArray[np.bool_], place: Ints) -> Iterator[Ints]:
    """Yield the corners of chosen places, as (P, m) for some places where m corners meet, in order in each."""
    if not chosen.any():
        return
    corners = np.flatnonzero(chosen[place])
    corners = corners[np.argsort(place[corners], kind="stable")]
    counts = np.bincount(place)[chosen]
    begins = np.cumsum(counts) - counts
    for count in np.unique(counts).tolist():
        alike = begins[counts == count][:, None] + np.arange(count)
        step = max(1, _PAIRS_AT_ONCE // count**2)
        for first in range(0, len(alike), step):
            yield corners[alike[first : first + step]]


def _means_of_near(units: Floats, weighted: Floats, widest: float) -> Floats:
    """Return the mean direction (P, m, 3) of those of m faces at a place at less than an angle to each of them.

    The faces have the unit normals `units` and the normals `weighted` of some length, both (P, m, 3).
    """
    (x, y, z), across = (np.ascontiguousarray(vectors.transpose(2, 1, 0)) for vectors in (units, weighted))
    sums = np.zeros_like(across)
    step = max(1, _PAIRS_AT_ONCE // x.size)
    for first in range(0, len(x), step):
        own = slice(first, first + step)
        near = (x[own, None] * x + z[own, None] * z) + y[own, None] * y > widest
        for other in range(len(x)):
            sums[:, own] += near[:, other] * across[:, other, None]
    return unit(sums.transpose(2, 1, 0))


def _means_of_groups(place: Ints, units: Floats, weighted: Floats, widest: float) -> Floats:
    """Return the normals at the corners of crowded places, at which faces with similar normals form groups.

    The angle of a group is that of its first face.
    """
    steps = np.rint(units * _STEPS).astype(np.int64) + _STEPS
    base = 2 * _STEPS + 1
    key = ((place * base + steps[:, 0]) * base + steps[:, 1]) * base + steps[:, 2]
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    group = group.reshape(-1)
    sums: Floats = np.stack([np.bincount(group, weights=weighted[:, axis]) for axis in range(3)], axis=1)
    normals, direction = np.empty_like(sums), units[first]
    at, number = np.unique(place[first], return_inverse=True)
    for some in _by_places(np.ones(len(at), bool), number.reshape(-1)):
        normals[some] = _means_of_near(direction[some], sums[some], widest)
    return normals[group]
