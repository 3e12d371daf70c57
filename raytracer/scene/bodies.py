"""The bodies of a scene's clear materials: their contents, and which of them can hold a ray at the same time.

Stage: layout. A shell is a connected surface. A body is a shell whose triangles face outward, with the hollows in it:
shells of the same material that face inward. Bodies are numbered by their volume, the largest first, so that of the
bodies that hold a point the one of the largest number is the innermost. `kernels.media` reads the tables.

>>> from raytracer import Material, Scene
>>> from raytracer.meshes.shapes import box
>>> from raytracer.scene.layout import Layout
>>> glass = Material(transmission=1.0)
>>> bodies = Bodies.of(Layout.of(Scene([box((2, 2, 2), glass), box((1, 1, 1), glass)])), [True])
>>> bodies.rows[:, 3].tolist(), bodies.slots
([1.0, 1.5, 1.5], 2)
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

import shpy as sh

if TYPE_CHECKING:
    from raytracer.scene.layout import Layout

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

MOST_SLOTS = 16
"""Bodies that a ray can be in at once: each takes a register."""
_CELL = 2.0**-18 * 0.7371
"""The size, as a part of the mesh, within which corners are one vertex: rounding moves the poles of a sphere apart."""
_TOUCHING = 2.0**-16
"""The part of a box by which it is grown before boxes are compared: bodies that touch meet."""
_MOST_COMPARED = 256
"""Bodies whose triangles are compared where their boxes meet."""
_MOST_PAIRS = 1 << 28
"""Boxes of bodies and triangles that are compared; more are taken to meet, which costs rays a few operations."""


class Shells(NamedTuple):
    """The shells of the clear `triangles` (n,), sorted: `shell` (n,) is the number of each one's shell.

    `closed` and `material` are those of each shell. Motion changes none of it.
    """

    triangles: Ints
    shell: Ints
    closed: NDArray[np.bool_]
    material: Ints

    @classmethod
    def of(cls, layout: Layout, clear: Sequence[bool]) -> Shells:
        """Return the shells of the materials that are `clear`, a flag for each material."""
        triangles = np.flatnonzero(np.asarray(clear)[layout.material_of[: layout.settled]])
        objects = layout.object_of[triangles]
        faces = _vertices(corners_of(layout, triangles), objects)
        shell = _joined(int(faces.max()) + 1, faces)[faces[:, 0]]
        _, shell = np.unique(shell, return_inverse=True)
        count = int(shell.max()) + 1
        closed = np.ones(count, bool)
        closed[shell[_faces_at_open_edges(faces)]] = False
        material = np.empty(count, np.int64)
        material[shell] = layout.material_of[triangles]
        return cls(triangles, shell, closed, material)


def corners_of(layout: Layout, triangles: Ints) -> Floats:
    """Return the corners (n, 3, 3) of triangles in the kernel's coordinates."""
    rows = layout.triangles.reshape(-1, 3, 4)[triangles, :, :3]
    return np.asarray(rows, np.float64)


def _vertices(corners: Floats, objects: NDArray[np.int32]) -> Ints:
    """Return the numbers (n, 3) of the vertices of triangles: corners of an object at the same place share one."""
    starts = np.flatnonzero(np.diff(objects, prepend=-1))
    sizes = np.diff(starts, append=len(objects))
    low = np.minimum.reduceat(corners.min(axis=1), starts)
    high = np.maximum.reduceat(corners.max(axis=1), starts)
    cell = np.maximum((high - low).max(axis=1), np.finfo(np.float64).tiny) * _CELL
    places = (corners - np.repeat(low, sizes, axis=0)[:, None]) / np.repeat(cell, sizes)[:, None, None]
    # Two grids, one of them moved by half a cell: equal corners on a border of one lie within a cell of the other.
    number, other = (_groups(np.floor(places + shift).reshape(-1, 3), np.repeat(objects, 3)) for shift in (0.0, 0.5))
    first = np.empty(int(other.max()) + 1, np.int64)
    first[other] = number
    return _joined(int(number.max()) + 1, np.stack([number, first[other]], axis=1))[number].reshape(-1, 3)


def _groups(cells: Floats, objects: NDArray[np.int32]) -> Ints:
    """Return a number for each row of cells (n, 3) that equal rows of the same object share."""
    x, y, z = (cells + 1).astype(np.int64).T
    key = (x << 42) | (y << 21) | z
    order = np.lexsort((key, objects))
    fresh = (np.diff(key[order], prepend=-1) != 0) | (np.diff(objects[order], prepend=-1) != 0)
    numbers = np.empty(len(key), np.int64)
    numbers[order] = np.cumsum(fresh) - 1
    return numbers


def _joined(count: int, groups: Ints) -> Ints:
    """Return for each of `count` things the least one with which rows of `groups` (n, k) join it."""
    labels = np.arange(count)
    while True:
        least = labels[groups].min(axis=1)
        joined = labels.copy()
        for column in groups.T:
            np.minimum.at(joined, column, least)
            np.minimum.at(joined, labels[column], least)
        joined = joined[joined]
        if np.array_equal(joined, labels):
            return joined
        labels = joined


def _faces_at_open_edges(faces: Ints) -> Ints:
    """Return the faces, by vertices (n, 3), with an edge that is not run through as often one way as the other."""
    a, b = faces, np.roll(faces, -1, axis=1)
    key = (np.minimum(a, b) * (int(faces.max()) + 1) + np.maximum(a, b)).ravel()
    _, edge = np.unique(key, return_inverse=True)
    balance = np.bincount(edge, np.sign(b - a).ravel())
    return np.flatnonzero((balance != 0)[edge].reshape(-1, 3).any(axis=1))


@dataclass(frozen=True, eq=False)
class Bodies:
    """The bodies of a scene, numbered from 1; 0 is the empty space around them.

    `rows` (1 + B, 4) are the absorption and the refractive index of each; `body_of` (N,) int32 is the body to whose
    surface a triangle belongs, 0 for a thin wall, -1 for what is opaque. `slots` is how many bodies can hold a ray at
    once, at least 1. `low` and `high` (1 + B, 3) are their boxes, in the kernel's coordinates, infinite for open
    meshes. `touches` says whether one may touch another, or something opaque.
    """

    shells: Shells
    corners: Floats
    rows: Floats
    body_of: NDArray[np.int32]
    slots: int
    low: Floats
    high: Floats
    touches: bool

    @classmethod
    def of(cls, layout: Layout, clear: Sequence[bool], shells: Shells | None = None) -> Bodies:
        """Return the bodies of the materials that are `clear`; `shells` are those of the layout, if they are known.

        A mesh that is open and has neither a refractive index nor absorption is a thin wall, and no body.
        """
        shells = shells or Shells.of(layout, clear)
        corners = corners_of(layout, shells.triangles)
        glass = layout.glass.reshape(-1, 2, 4)
        medium = np.concatenate([glass[:, 1, :3], glass[:, 0, 1:2]], axis=1)
        low, high, volume = _extents(corners, shells.shell)
        body_of_shell, volume = _hollows(shells, corners, low, high, volume)
        empty = (medium[shells.material] == (0, 0, 0, 1)).all(axis=1)
        endless = ~shells.closed | (volume <= 0)
        own = (body_of_shell == np.arange(len(volume))) & ~(empty & ~shells.closed)
        heads = np.flatnonzero(own)
        size = np.where(endless, inf, volume).astype(np.float32)[heads]
        heads = heads[np.lexsort((heads, -size))]
        number = np.zeros(len(volume), np.int64)
        number[heads] = np.arange(1, len(heads) + 1)
        body_of = np.full(len(layout.material_of), -1, np.int32)
        body_of[shells.triangles] = number[body_of_shell[shells.shell]]
        rows = np.concatenate([[(0.0, 0.0, 0.0, 1.0)], medium[shells.material[heads]]])
        low = np.where(endless[:, None], -inf, low)[heads]
        high = np.where(endless[:, None], inf, high)[heads]
        bodies = body_of[shells.triangles]
        slots = _slots(low, high, [corners[bodies == body] for body in range(1, min(len(heads), _MOST_COMPARED) + 1)])
        return cls(
            shells, corners, rows, body_of, slots,
            np.concatenate([np.full((1, 3), -inf), low]), np.concatenate([np.full((1, 3), inf), high]),
            slots > 1 or _meet_opaque(layout, body_of, low, high),
        )  # fmt: skip

    def around(self, point: Floats) -> list[int]:
        """Return the bodies, of closed meshes, in which a point lies, the innermost first."""
        near = (self.low <= point).all(axis=1) & (point <= self.high).all(axis=1) & np.isfinite(self.low).all(axis=1)
        bodies = self.body_of[self.shells.triangles]
        return [int(body) for body in np.flatnonzero(near)[::-1] if winding(self.corners[bodies == body], point) > 0.5]

    def has(self, first: int, past: int) -> bool:
        """Return whether triangles `first` to `past` - 1 belong to clear meshes."""
        begin, end = np.searchsorted(self.shells.triangles, [first, past])
        return bool(end > begin)

    def cut(self, low: Floats, high: Floats) -> bool:
        """Return whether the surface of a body may come into a box."""
        body = self.body_of[self.shells.triangles] > 0
        inside = (self.corners.min(axis=1) <= high) & (low <= self.corners.max(axis=1))
        return bool((inside.all(axis=1) & body).any())


def _extents(corners: Floats, shell: Ints) -> tuple[Floats, Floats, Floats]:
    """Return the box of each shell, (S, 3) each, and its volume (S,), negative where triangles face inward."""
    order = np.argsort(shell, kind="stable")
    starts = np.flatnonzero(np.diff(shell[order], prepend=-1))
    low = np.minimum.reduceat(corners.min(axis=1)[order], starts)
    high = np.maximum.reduceat(corners.max(axis=1)[order], starts)
    a, b, c = (corners - ((low + high) / 2)[shell][:, None]).swapaxes(0, 1)
    return low, high, np.bincount(shell, np.einsum("ij,ij->i", a, np.cross(b, c))) / 6


def _hollows(shells: Shells, corners: Floats, low: Floats, high: Floats, volume: Floats) -> tuple[Ints, Floats]:
    """Return for each shell the one whose body it bounds, and the volumes of bodies without their hollows.

    A hollow bounds the smallest body of its material around it.
    """
    body, left = np.arange(len(volume)), volume.copy()
    for hollow in np.flatnonzero(shells.closed & (volume < 0)):
        around = (low <= low[hollow]).all(axis=1) & (high[hollow] <= high).all(axis=1)
        around &= shells.closed & (volume > -volume[hollow]) & (shells.material == shells.material[hollow])
        point = corners[shells.shell == hollow][0, 0]
        for shell in sorted(np.flatnonzero(around), key=lambda k: volume[k]):
            if winding(corners[shells.shell == shell], point) > 0.5:
                body[hollow] = shell
                left[shell] += volume[hollow]
                break
    return body, left


def _slots(low: Floats, high: Floats, corners: Sequence[Floats]) -> int:
    """Return how many bodies can hold a point at once, an upper bound, by their boxes (B, 3) and their triangles.

    The last of such a set meets all others, which are before it. `corners` are those of the first bodies: the boxes of
    two may meet where the bodies do not.
    """
    grown = np.where(np.isfinite(high - low), (high - low) * _TOUCHING, 0.0)
    low, high = low - grown, high + grown
    most = 1
    for k in range(1, len(low)):
        meet = np.flatnonzero(((low[:k] <= high[k]) & (low[k] <= high[:k])).all(axis=1))
        if k < len(corners):
            meet = meet[[_may_meet(low, high, corners, k, int(other)) for other in meet]]
        most = max(most, 1 + len(meet))
    if most > MOST_SLOTS:
        warnings.warn(
            f"the boxes round {most} bodies of clear materials meet, and a ray knows of {MOST_SLOTS} bodies in which "
            "it is: where more of them really overlap, it forgets one",
            sh.ShpyWarning,
            stacklevel=2,
        )
    return min(most, MOST_SLOTS)


def _may_meet(low: Floats, high: Floats, corners: Sequence[Floats], k: int, other: int) -> bool:
    """Return whether one of two boxes lies in the other, or triangles of both come to where the boxes meet."""
    least, most = np.maximum(low[k], low[other]), np.minimum(high[k], high[other])
    if any((least == low[n]).all() and (most == high[n]).all() for n in (k, other)):
        return True
    return all(
        ((corners[n].min(axis=1) <= most) & (least <= corners[n].max(axis=1))).all(axis=1).any() for n in (k, other)
    )


def _meet_opaque(layout: Layout, body_of: NDArray[np.int32], low: Floats, high: Floats) -> bool:
    """Return whether the box of an opaque triangle meets one of the boxes (B, 3) of bodies that have an end."""
    ends = np.isfinite(low[:, 0])
    grown = (high[ends] - low[ends]) * _TOUCHING
    low, high = low[ends] - grown, high[ends] + grown
    opaque = np.flatnonzero(body_of[: layout.settled] < 0)
    corners = layout.triangles.reshape(-1, 3, 4)[opaque, :, :3]
    least, most = corners.min(axis=1), corners.max(axis=1)
    if layout.instanced is not None:
        boxes = layout.instanced.boxes
        least, most = np.concatenate([least, boxes[:, 0]]), np.concatenate([most, boxes[:, 1]])
    if not (len(low) and len(least)):
        return False
    near = ((least <= high.max(axis=0)) & (low.min(axis=0) <= most)).all(axis=1)
    least, most = least[near], most[near]
    if len(low) * len(least) > _MOST_PAIRS:
        return True
    return any(((least <= b) & (a <= most)).all(axis=1).any() for a, b in zip(low, high, strict=True))


def winding(corners: Floats, point: Floats) -> float:
    """Return how often triangles (n, 3, 3) go round a point: 1 within a closed surface that faces outward, 0 outside.

    It is the sum of solid angles (Van Oosterom and Strackee 1983) over 4 pi.
    """
    a, b, c = (corners - point).swapaxes(0, 1)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    across = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", v, w) for v, w in ((a, b), (b, c), (c, a)))
    return float(np.arctan2(across, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi))
