"""Normals at the corners of triangles: means of the faces that meet there at small angles.

Stage: scene description. Takes vertices (V, 3) and faces (F, 3). A place is a number for all vertices with the same
coordinates. At most places all faces are near each other, and one sum serves all corners; the others compare pairs.

>>> roof = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, -1]])
>>> normals_at_corners(roof, np.array([[0, 2, 1], [0, 1, 3]]), 45.0)[:, 0].tolist()
[[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.planes import Vector, by_components, by_parts, normals_of, parts, unit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_MARGIN = 1e-6
"""How much nearer to the mean than half the angle, by the cosine, the faces at a place with one sum are.

For two unit vectors the cosine between them is then above the limit by 1e-12 at least, and products round by 1e-15.
"""
_CROWDED = 64
"""Faces at a place from which on those with nearly the same normal are taken together."""
_STEPS = 16
"""Into how many steps components of normals are cut for that."""
_CORNERS_AT_ONCE = 1 << 18
"""Corners whose pairs are compared at once, at most, but for those of a single place."""
_PAIRS_AT_ONCE = 1 << 20


def normals_at_corners(vertices: Floats, faces: Ints, below: float) -> Floats:
    """Return normals (F, 3, 3): the mean, by area, of the faces that meet at less than `below` degrees at each corner.

    Where faces cancel each other a corner has the normal of its own face, which is zero for one without area.
    """
    widest = float(np.cos(np.radians(below)))
    weighted = by_parts(lambda some: _across(vertices.take(some, axis=0)), faces)
    units = unit(weighted)
    place = _places(vertices)[faces].reshape(-1)
    crowded = np.bincount(place) > _CROWDED
    # The order is that of `_grouped`, so that a place has the same bits in either way.
    means = unit(_sums(weighted, place, backwards=bool(crowded.any())))
    is_mixed = crowded | _mixed(means, units, place, widest)
    normals = means.take(place, axis=0)
    mixed = np.flatnonzero(is_mixed[place]) if is_mixed.any() else place[:0]
    for chosen in _by_places(mixed, place[mixed]):
        face = chosen // 3
        normals[chosen] = _means_of_near(place[chosen], weighted[face], units[face], crowded, widest)
    normals = normals.reshape(-1, 3, 3)
    for part in parts(len(faces)):
        empty = ~(
            normals[part, :, 0].astype(bool) | normals[part, :, 1].astype(bool) | normals[part, :, 2].astype(bool)
        )
        if empty.any():
            own = units[part]
            own = np.where(own.any(axis=1, keepdims=True), own, normals_of(vertices.take(faces[part], axis=0)))
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


def _sums(weighted: Floats, place: Ints, *, backwards: bool) -> Floats:
    """Return the sums of the faces at each place, added in the order of their corners, or in the opposite one."""
    way = slice(None, None, -1 if backwards else 1)
    columns = [np.bincount(place[way], weights=np.repeat(weighted[way, axis], 3)) for axis in range(3)]
    return np.stack(columns, axis=1)


def _mixed(means: Floats, units: Floats, place: Ints, widest: float) -> NDArray[np.bool_]:
    """Return at which places a face is farther from the mean than half the angle.

    Two faces that are nearer are nearer to each other than the angle. A face without area counts as far.
    """
    least = np.cos(np.arccos(widest) / 2) + _MARGIN
    found = np.zeros(len(means), bool)
    corners = place.reshape(-1, 3)
    for part in parts(len(units)):
        some, (x, y, z) = corners[part], np.ascontiguousarray(units[part].T)
        for column in np.ascontiguousarray(some.T):
            along = means.take(column, axis=0).T
            found[column[~(along[0] * x + along[1] * y + along[2] * z > least)]] = True
    return found


def _by_places(corners: Ints, place: Ints) -> Iterator[Ints]:
    """Yield corners in parts, in order, all those of a place in the same one."""
    order = np.argsort(place, kind="stable")
    ends = np.append(np.flatnonzero(np.diff(place[order])) + 1, len(order))
    begin = 0
    while begin < len(order):
        whole = ends[(ends > begin) & (ends <= begin + _CORNERS_AT_ONCE)]
        end = int(whole[-1] if len(whole) else ends[ends > begin][0])
        chosen = corners[order[begin:end]]
        chosen.sort()
        yield chosen
        begin = end


def _means_of_near(place: Ints, weighted: Floats, units: Floats, crowded: NDArray[np.bool_], widest: float) -> Floats:
    """Return the normals at corners, each the mean of the faces at its place at less than an angle to its own.

    `weighted` and `units` are those of the faces of the corners, `crowded` says it of each place.
    """
    group, first = _grouped(place, units, crowded)
    held = _added(weighted, group, len(first))
    direction, place = units[first], np.unique(place, return_inverse=True)[1].reshape(-1)[first]
    sums = np.zeros_like(held)
    for chosen, one, other in _sharing(place):
        near = np.einsum("ij,ij->i", direction[chosen].take(one, axis=0), direction.take(other, axis=0)) > widest
        sums[chosen] = _added(held.take(other[near], axis=0), one[near], len(chosen))
    return np.asarray(unit(sums)[group])


def _grouped(place: Ints, units: Floats, crowded: NDArray[np.bool_]) -> tuple[Ints, Ints]:
    """Group corners at one place with similar normals: return each corner's group, and each group's first corner.

    Where few corners meet, each is a group of its own. These come last to first where a place is crowded.
    """
    order = np.arange(len(place))
    if not crowded.any():
        return order, order
    steps = np.rint(units * _STEPS).astype(np.int64) + _STEPS
    base = 2 * _STEPS + 1
    key = ((place * base + steps[:, 0]) * base + steps[:, 1]) * base + steps[:, 2]
    _, first, group = np.unique(np.where(crowded[place], key, -1 - order), return_index=True, return_inverse=True)
    return group.reshape(-1), first


def _added(vectors: Floats, number: Ints, count: int) -> Floats:
    """Add the vectors (N, 3) of each number, (count, 3)."""
    columns = [np.bincount(number, weights=vectors[:, axis], minlength=count) for axis in range(3)]
    return np.stack(columns, axis=1)


def _sharing(place: Ints) -> Iterator[tuple[Ints, Ints, Ints]]:
    """Yield all ordered pairs at the same place, each with itself too; about as many at once as fit in memory.

    They are given as some of the corners, the places among these of the first ones, and the second ones.
    """
    order = np.argsort(place, kind="stable")
    counts = np.bincount(place)
    starts = np.cumsum(counts) - counts
    mates = counts[place[order]]
    ends = np.cumsum(mates)
    begin = 0
    while begin < len(order):
        past = ends[begin] - mates[begin] + _PAIRS_AT_ONCE
        end = max(begin + 1, int(np.searchsorted(ends, past, side="right")))
        part = slice(begin, end)
        one = np.repeat(np.arange(end - begin), mates[part])
        within = np.arange(len(one)) - np.repeat(ends[part] - mates[part] - (ends[begin] - mates[begin]), mates[part])
        yield order[part], one, order[np.repeat(starts[place[order[part]]], mates[part]) + within]
        begin = end
