"""Faces as lists of vertices, checked and cut into triangles.

Stage: scene description. Takes vertices (V, 3), and the corners of faces one after the other. PLY and OFF files have
them; their elements are numbered from 0. A face that has a bad entry is left out and counted.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.meshes.folder import Fault, Notices
from raytracer.meshes.lines import Floats, Ints
from raytracer.meshes.polygons import triangulated

Mask = NDArray[np.bool_]
LACKING: Final = Fault("face names a vertex that the file lacks", "faces name a vertex that the file lacks")
BROKEN: Final = Fault("vertex is not three finite numbers", "vertices are not three finite numbers")
AT_BROKEN: Final = Fault("face has a corner at such a vertex", "faces have a corner at such a vertex")
SMALL: Final = Fault("face has fewer than three corners", "faces have fewer than three corners")
ILLEGIBLE: Final = Fault("face has a word that is not an index", "faces have a word that is not an index")
SHORT: Final = Fault("face ends before its last number", "faces end before their last number")


class Triangles(NamedTuple):
    """The triangles of faces: `vertices` (T, 3), `places` (T, 3) among all corners of the file, and `faces` (T,)."""

    vertices: Ints
    places: Ints
    faces: Ints


def leave_out_broken(vertices: Floats, notices: Notices) -> Mask:
    """Return which vertices (V, 3) are not finite, and count them."""
    broken: Mask = np.asarray(~np.isfinite(vertices).all(axis=1))
    leave_out(BROKEN, broken, "vertex", notices)
    return broken


def leave_out(fault: Fault, wrong: Mask, element: str, notices: Notices, cause: str = "") -> None:
    """Count the elements that are wrong; the first one is named by its number."""
    if wrong.any():
        notices.leave_out(fault, int(wrong.sum()), f"{element} {int(np.argmax(wrong)):,}", cause)


def triangles_of(
    vertices: Floats, broken: Mask, corners: NDArray[Any], sizes: Ints, short: Ints, notices: Notices
) -> Triangles:
    """Return the triangles of faces.

    `corners` (C,) are the numbers that the file has for the vertices of faces, `sizes` (F,) the lengths of their lists,
    `broken` (V,) says which vertices are not finite, and `short` are the faces that end early.
    """
    face = np.repeat(np.arange(len(sizes)), sizes)
    with np.errstate(invalid="ignore"):
        index = np.where(np.isfinite(corners), corners, 0).astype(np.int64)
        illegible = _faces_of(index != corners, face, len(sizes))
    ends_early = np.zeros(len(sizes), bool)
    ends_early[short] = True
    kept = ~ends_early & ~illegible
    leave_out(SHORT, ends_early, "face", notices)
    leave_out(ILLEGIBLE, illegible & ~ends_early, "face", notices)
    leave_out(SMALL, kept & (sizes < 3), "face", notices)
    kept &= sizes >= 3
    beyond = (index < 0) | (index >= len(vertices))
    lacking = _faces_of(beyond, face, len(sizes)) & kept
    if lacking.any():
        number = index[beyond & (face == np.argmax(lacking))][0]
        leave_out(LACKING, lacking, "face", notices, f"a face names vertex {number}, and there are {len(vertices)}")
    kept &= ~lacking
    if broken.any():
        at_broken = _faces_of(broken[np.where(beyond, 0, index)] & ~beyond, face, len(sizes)) & kept
        leave_out(AT_BROKEN, at_broken, "face", notices)
        kept &= ~at_broken
    places = np.flatnonzero(np.repeat(kept, sizes))
    numbers = np.flatnonzero(kept)
    triangulation = triangulated(vertices, index[places], sizes[kept])
    triangulation.report(notices, lambda face: f"face {numbers[face]:,}")
    return Triangles(index[places][triangulation.corners], places[triangulation.corners], numbers[triangulation.faces])


def _faces_of(corner: Any, face: Ints, count: int) -> Mask:
    mask = np.zeros(count, bool)
    mask[face[corner]] = True
    return mask
