"""Faces of any number of corners as triangles.

Stage: scene description. Takes the corners of all faces, one face after the other, and the number of corners of each
face. A face whose fan of triangles about its first corner covers it keeps that fan: all convex ones, planar or not.
Others are cut into ears (`mapbox_earcut`): concave ones, and those with holes that a bridge of two equal edges joins to
the outline. `triangles_of` first leaves out the faces that a file has wrong, and counts them.

>>> square = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
>>> triangles = triangulated(square, np.arange(4), np.array([4]))
>>> triangles.corners.tolist(), triangles.faces.tolist()
([[0, 1, 2], [0, 2, 3]], [0, 0])
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.errors import SceneError
from raytracer.meshes.folder import Fault, Notices
from raytracer.meshes.lines import Floats, Ints

Mask = NDArray[np.bool_]
MOST_CORNERS: Final = 1 << 14
"""Corners of a face that is cut into ears: a face that crosses itself takes time in proportion to their square."""
_TOO_LARGE: Final = Fault(
    f"face is not convex and has more than {MOST_CORNERS:,} corners",
    f"faces are not convex and have more than {MOST_CORNERS:,} corners",
)
_TINY: Final = 1e-12
"""The share of a face's area below which a triangle that is turned over counts as one without area."""
_CROSSED: Final = 1e-6
"""The share of a face's area by which the areas of its ears differ from it where it crosses itself."""
LACKING: Final = Fault("face names a vertex that the file lacks", "faces name a vertex that the file lacks")
BROKEN: Final = Fault("vertex is not three finite numbers", "vertices are not three finite numbers")
UV_BROKEN: Final = Fault("texture vertex is not finite numbers", "texture vertices are not finite numbers")
NORMAL_BROKEN: Final = Fault("normal is not three finite numbers", "normals are not three finite numbers")
COLOR_BROKEN: Final = Fault("colour of a vertex is not finite", "colours of vertices are not finite")
AT_BROKEN: Final = Fault("face has a corner at such a vertex", "faces have a corner at such a vertex")
SMALL: Final = Fault("face has fewer than three corners", "faces have fewer than three corners")
ILLEGIBLE: Final = Fault("face has a word that is not an index", "faces have a word that is not an index")
SHORT: Final = Fault("face ends before its last number", "faces end before their last number")


class Triangles(NamedTuple):
    """The triangles of faces.

    `corners` (T, 3) are indices of the given places, and `faces` (T,) those of the faces, in order. `too_large` are
    the faces that are left out because they are not convex and have more than `MOST_CORNERS` corners, and `crossed` is
    the number of faces that cross themselves, such as bow ties: they keep their fans, whose triangles overlap.
    """

    corners: Ints
    faces: Ints
    too_large: Ints
    crossed: int

    def report(self, notices: Notices, where: Callable[[int], str]) -> None:
        """Count the faces that are left out, and those that cross themselves; `where` gives the place of a face."""
        if len(self.too_large):
            notices.leave_out(_TOO_LARGE, len(self.too_large), where(int(self.too_large[0])))
        notices.ignore("overlaps of faces that cross themselves", self.crossed)


def triangulated(vertices: NDArray[Any], corners: NDArray[Any], sizes: Ints) -> Triangles:
    """Return the triangles of faces.

    `vertices` (V, 3) are places, and finite where a face has one. `corners` (C,) are the vertices at the corners of the
    faces, and `sizes` (F,) the numbers of corners of each face.
    """
    none = np.zeros(0, np.int64)
    if (sizes == 3).all():
        return Triangles(np.arange(len(corners)).reshape(-1, 3), np.arange(len(sizes)), none, 0)
    places = vertices[corners]
    begins, counts = np.cumsum(sizes) - sizes, np.maximum(sizes - 2, 0)
    faces = np.repeat(np.arange(len(sizes)), counts)
    second = np.arange(len(faces)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    fans = begins[faces][:, None] + np.stack([np.zeros_like(second), second, second + 1], axis=1)
    many = np.flatnonzero(sizes > 3)
    wrong = many[~_covered(places, fans, faces, many, counts)]
    quads = wrong[sizes[wrong] == 4]
    first = (np.cumsum(counts) - counts)[quads]
    turned = begins[quads][:, None, None] + np.array([[1, 2, 3], [1, 3, 0]])
    right = _covered(places, turned.reshape(-1, 3), np.repeat(quads, 2), quads, np.where(counts, 2, 0))
    for k in (0, 1):  # the other diagonal of a quadrilateral whose corner 1 or 3 points inwards
        fans[first[right] + k] = turned[right, k]
    return _with_ears(places, fans, faces, np.setdiff1d(wrong, quads[right]), begins, sizes)


def _covered(places: NDArray[Any], corners: Ints, faces: Ints, chosen: Ints, counts: Ints) -> Mask:
    """Return which of the `chosen` faces their triangles cover: none is turned over.

    `corners` and `faces` may be those of more faces, `counts` are the numbers of triangles by face.
    """
    if not len(chosen):
        return np.zeros(0, bool)
    is_chosen = np.zeros(len(counts), bool)
    is_chosen[chosen] = True
    at = places[corners[is_chosen[faces]]].astype(np.float64)
    doubled = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])  # twice the area of each triangle, as a vector
    begins = np.cumsum(counts[chosen]) - counts[chosen]
    whole = np.add.reduceat(doubled, begins)
    size = np.einsum("ij,ij->i", whole, whole)
    along = np.einsum("ij,ij->i", doubled, np.repeat(whole, counts[chosen], axis=0))
    least = np.minimum.reduceat(along, begins)
    crossing = (size == 0) & np.add.reduceat(doubled.any(axis=1), begins).astype(bool)  # such as a bow tie
    return np.asarray((least >= -_TINY * size) & ~crossing)


def _with_ears(places: NDArray[Any], corners: Ints, faces: Ints, wrong: Ints, begins: Ints, sizes: Ints) -> Triangles:
    """Return the triangles, in which ears replace the fans of the faces `wrong`."""
    too_large = wrong[sizes[wrong] > MOST_CORNERS]
    crossed, triangles, owners = 0, [], [too_large[:0]]
    for face in wrong[sizes[wrong] <= MOST_CORNERS].tolist():
        first, count = int(begins[face]), int(sizes[face])
        ears = _ears(places[first : first + count].astype(np.float64))
        if ears is None:
            crossed += 1
        else:
            triangles.append(first + ears)
            owners.append(np.full(len(ears), face))
    if triangles or len(too_large):
        fans = ~np.isin(faces, np.concatenate([*owners, too_large]))
        corners, faces = np.concatenate([corners[fans], *triangles]), np.concatenate([faces[fans], *owners])
        order = np.argsort(faces, kind="stable")
        corners, faces = corners[order], faces[order]
    return Triangles(corners, faces, too_large, crossed)


def _ears(outline: Floats) -> Ints | None:
    """Return the triangles (T, 3) of one face by its corners (N, 3); None if it crosses itself.

    The corners are seen along the axis nearest to the normal of Newell (Sutherland et al. 1974), which changes no
    coordinate: the two ends of a bridge stay equal.
    """
    try:
        from mapbox_earcut import triangulate_float64
    except ImportError as error:
        needed = sh.packages.install("mapbox-earcut")
        raise SceneError(f"a face that is not convex needs mapbox-earcut: {needed}") from error
    moved = outline - outline[0]
    normal = np.cross(moved, np.roll(moved, -1, axis=0)).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    flat = np.ascontiguousarray(np.delete(outline, axis, axis=1))
    ears = triangulate_float64(flat, np.array([len(flat)], np.uint32)).astype(np.int64).reshape(-1, 3)
    sides = np.diff(flat[ears], axis=1)
    areas = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    signed_area = float(normal[axis]) * (-1 if axis == 1 else 1)  # (x, z) is a left-handed pair
    over = areas * signed_area < 0
    ears[over] = ears[over, ::-1]
    total = float(np.abs(areas).sum())
    return ears if len(ears) and abs(total - abs(signed_area)) <= _CROSSED * total else None


class FaceTriangles(NamedTuple):
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
) -> FaceTriangles:
    """Return the triangles of faces.

    `corners` (C,) are the numbers that the file has for the vertices of faces, `sizes` (F,) the lengths of their lists,
    `broken` (V,) says which vertices are not finite, and `short` are the faces that end early.
    """
    face = np.repeat(np.arange(len(sizes)), sizes)
    with np.errstate(invalid="ignore"):
        index = np.where(np.isfinite(corners), corners, 0).astype(np.int64)
        illegible = faces_of(index != corners, face, len(sizes))
    ends_early = np.zeros(len(sizes), bool)
    ends_early[short] = True
    kept = ~ends_early & ~illegible
    leave_out(SHORT, ends_early, "face", notices)
    leave_out(ILLEGIBLE, illegible & ~ends_early, "face", notices)
    leave_out(SMALL, kept & (sizes < 3), "face", notices)
    kept &= sizes >= 3
    beyond = (index < 0) | (index >= len(vertices))
    lacking = faces_of(beyond, face, len(sizes)) & kept
    if lacking.any():
        number = index[beyond & (face == np.argmax(lacking))][0]
        leave_out(LACKING, lacking, "face", notices, f"a face names vertex {number}, and there are {len(vertices)}")
    kept &= ~lacking
    if broken.any():
        at_broken = faces_of(broken[np.where(beyond, 0, index)] & ~beyond, face, len(sizes)) & kept
        leave_out(AT_BROKEN, at_broken, "face", notices)
        kept &= ~at_broken
    places = np.flatnonzero(np.repeat(kept, sizes))
    numbers = np.flatnonzero(kept)
    triangulation = triangulated(vertices, index[places], sizes[kept])
    triangulation.report(notices, lambda face: f"face {numbers[face]:,}")
    of_file = places[triangulation.corners]
    return FaceTriangles(index[of_file], of_file, numbers[triangulation.faces])


def faces_of(corner: Any, face: Ints, count: int) -> Mask:
    """Return which of `count` faces have one of these corners, whose faces are `face`."""
    mask = np.zeros(count, bool)
    mask[face[corner]] = True
    return mask
