"""PLY files as meshes: faces of any number of corners or strips, colours, normals, uv coordinates, and pictures.

Stage: scene description. Elements are numbered from 0, as faces number vertices.

    for mesh, picture in read_ply(data, "bunny", notices): ...      # the name of a picture's file, or None
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.textures import decoded
from raytracer.errors import SceneError
from raytracer.meshes.folder import Fault, Notices
from raytracer.meshes.lines import Floats, Ints
from raytracer.meshes.mesh import Mesh
from raytracer.meshes.ply_elements import File, Lists, read_elements
from raytracer.meshes.polygons import (
    COLOR_BROKEN,
    NORMAL_BROKEN,
    UV_BROKEN,
    FaceTriangles,
    Mask,
    leave_out,
    leave_out_broken,
    triangles_of,
)

Columns = dict[str, Any]
ALL: Final = slice(None)
_READ: Final = {
    "vertex": frozenset("x y z nx ny nz red green blue alpha texture_u texture_v u v s t".split()),
    "face": frozenset("vertex_index vertex_indices red green blue alpha texcoord texnumber".split()),
    "tristrips": frozenset(("vertex_index", "vertex_indices")),
}
"""The properties of each element that are read."""
_RGB: Final = ("red", "green", "blue")
_UV: Final = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))
_TEXCOORD: Final = Fault(
    "face has not two texture coordinates for each corner", "faces have not two texture coordinates for each corner"
)
_COLORS: Final = {
    "vertex": COLOR_BROKEN,
    "face": Fault("colour of a face is not finite", "colours of faces are not finite"),
}
_PICTURE: Final = Fault("face names a picture that the file lacks", "faces name a picture that the file lacks")
_SHORT: Final = Fault("vertex ends before its last number", "vertices end before their last number")
_STRIP: Final = Fault("strip names a vertex that the file lacks", "strips name a vertex that the file lacks")


def read_ply(data: bytes, name: str, notices: Notices) -> Iterator[tuple[Mesh, str | None]]:
    """Yield the triangles of a file, those of each picture as one mesh, with the name of the picture."""
    file = read_elements(data)
    _note(file, notices)
    vertex, face = file.columns.get("vertex", {}), file.columns.get("face", {})
    if not all(isinstance(vertex.get(axis), np.ndarray) for axis in "xyz"):
        raise SceneError("its vertices lack x, y or z")
    places = _stacked(vertex, "xyz")
    broken = leave_out_broken(places, notices)
    short = np.zeros(len(broken), bool)
    short[file.short["vertex"]] = True
    leave_out(_SHORT, short & ~broken, "vertex", notices)
    faces, strips = _faces(file, places, broken, notices), _strips(file, places, broken, notices)
    vertices = np.concatenate([faces.vertices, strips])
    attributes = _at_corners(file, faces, vertices, broken, notices)
    for picture, chosen in _by_picture(file, face, faces.faces, len(vertices), notices):
        own: Columns = {key: None if rows is None else rows[chosen] for key, rows in attributes.items()}
        if picture is None and chosen is ALL and not broken.any():
            used, triangles = places, vertices
        else:
            index, triangles = np.unique(vertices[chosen], return_inverse=True)
            used, triangles = places[index], triangles.reshape(-1, 3)
        yield Mesh(used, triangles, name=name, **own), picture


def _note(file: File, notices: Notices) -> None:
    """Note the elements and properties that are not read."""
    for part in file.elements:
        if part.name not in _READ:
            notices.ignore(f"elements {part.name}", part.count)
        for each in part.properties:
            if each.name not in _READ.get(part.name, (each.name,)):
                notices.ignore(f"{each.name} of each {part.name}", part.count)


def _at_corners(file: File, faces: FaceTriangles, vertices: Ints, broken: Mask, notices: Notices) -> Columns:
    """Return normals, colours and uv coordinates at the corners of triangles, None where the file has none."""
    vertex, face = file.columns["vertex"], file.columns.get("face", {})
    uv = [_of_vertices(vertex, names, broken, UV_BROKEN, notices) for names in _UV if _has(vertex, names)]
    attributes = {
        "normals": _of_vertices(vertex, ("nx", "ny", "nz"), broken, NORMAL_BROKEN, notices),
        "colors": _colors(file, "vertex", broken, notices),
        "uv": uv[0] if uv else None,
    }
    columns: Columns = {key: None if rows is None else rows[vertices] for key, rows in attributes.items()}
    if columns["colors"] is None and _has(face, _RGB):
        of_faces: Any = _colors(file, "face", np.zeros(len(face["red"]), bool), notices)
        colors = np.ones((len(vertices), 3, 3))
        colors[: len(faces.faces)] = of_faces[faces.faces][:, None]
        columns["colors"] = colors
    if isinstance(face.get("texcoord"), Lists) and len(faces.faces) and len(face["texcoord"].values):
        places = np.zeros((len(vertices), 3, 2))
        places[: len(faces.faces)] = _texcoord(face["texcoord"], _corners(face), faces, notices)
        columns["uv"] = places
    return columns


def _has(columns: Columns, names: tuple[str, ...]) -> bool:
    return all(isinstance(columns.get(name), np.ndarray) for name in names)


def _stacked(columns: Columns, names: Iterable[str]) -> Floats:
    return np.stack([columns[name].astype(np.float64) for name in names], axis=1)


def _of_vertices(
    vertex: Columns, names: tuple[str, ...], broken: Mask, fault: Fault, notices: Notices
) -> Floats | None:
    """Return properties of vertices (V, N), zero where they are not finite; None where the file has none."""
    if not _has(vertex, names):
        return None
    rows = _stacked(vertex, names)
    wrong = ~np.isfinite(rows).all(axis=1)
    leave_out(fault, wrong & ~broken, "vertex", notices)
    rows[wrong] = 0
    return rows


def _colors(file: File, element: str, broken: Mask, notices: Notices) -> Floats | None:
    """Return linear colours (N, 3), white where they are not finite; None where the file has none."""
    columns = file.columns[element]
    if not _has(columns, _RGB):
        return None
    rows = _stacked(columns, _RGB)
    wrong: Mask = np.asarray(~np.isfinite(rows).all(axis=1))
    leave_out(_COLORS[element], wrong & ~broken, element, notices)
    alpha = columns.get("alpha")
    if isinstance(alpha, np.ndarray) and (alpha < _white(file.kind(element, "alpha"), alpha)).any():
        notices.ignore(f"alpha of {element} colours")
    white = _white(file.kind(element, "red"), rows[~wrong])
    rows[wrong] = white
    return decoded(np.clip(rows / white, 0, 1))


def _white(kind: np.dtype[Any], rows: Floats) -> float:
    """Return the number of full intensity for colours of a type.

    That is 255 for uchar and 65535 for ushort. Floats are shares, or up to 255 where one is above 2. In signed and
    larger types the largest number tells: 255 or 65535 where it is not above, or else the type's own.
    """
    most = float(rows.max(initial=0))
    if kind.kind == "f":
        return 1.0 if most <= 2 else 255.0
    if kind.kind == "u" and kind.itemsize <= 2:
        return float(np.iinfo(kind).max)
    own = float(np.iinfo(kind).max)
    return next((white for white in (255.0, 65535.0) if most <= white < own), own)


def _corners(face: Columns) -> Lists:
    """Return the vertices of faces."""
    none = Lists(np.zeros(0), np.zeros(0, np.int64))
    return next((face[n] for n in ("vertex_indices", "vertex_index") if isinstance(face.get(n), Lists)), none)


def _faces(file: File, places: Floats, broken: Mask, notices: Notices) -> FaceTriangles:
    corners = _corners(file.columns.get("face", {}))
    short = file.short.get("face", np.zeros(0, np.int64))
    return triangles_of(places, broken, corners.values, corners.sizes, short[short < len(corners.sizes)], notices)


def _strips(file: File, places: Floats, broken: Mask, notices: Notices) -> Ints:
    """Return the triangles (T, 3) of strips, but those with vertices that are not there or not finite."""
    rows = _corners(file.columns.get("tristrips", {}))
    ends = np.cumsum(rows.sizes)
    parts = [_strip(rows.values[end - size : end]) for end, size in zip(ends, rows.sizes, strict=True)]
    lacking = np.array([bool((part >= len(places)).any()) for part in parts], bool)
    if lacking.any():
        worst = int(parts[int(np.argmax(lacking))].max())
        cause = f"a strip names vertex {worst}, and there are {len(places)}"
        leave_out(_STRIP, lacking, "strip", notices, cause)
    triangles: Ints = np.concatenate([np.zeros((0, 3), np.int64), *parts])
    triangles = triangles[(triangles < len(places)).all(axis=1)]
    return np.asarray(triangles[~broken[triangles].any(axis=1)])


def _strip(order: NDArray[Any]) -> Ints:
    """Return the triangles (F, 3) of vertices in strips, between which a negative number stands.

    Each vertex after two others makes a triangle with them; of every second one in a strip two corners change places,
    so that all face one way.
    """
    order = np.where(np.isfinite(order), order, -1).astype(np.int64)
    ends, place = np.flatnonzero(order < 0), np.arange(len(order))
    first = np.concatenate([[0], ends + 1])[np.searchsorted(ends, place)]  # where the strip of each place begins
    last = place[2:][(place[2:] - first[2:] >= 2) & (order[2:] >= 0)]
    odd = (last - first[last]) % 2
    return np.asarray(np.stack([order[last - 2], order[last - 1 + odd], order[last - odd]], axis=1).reshape(-1, 3))


def _texcoord(lists: Lists, corners: Lists, faces: FaceTriangles, notices: Notices) -> Floats:
    """Return uv coordinates at the corners (T, 3, 2) of triangles, zero for faces without any."""
    right: Mask = np.asarray(lists.sizes == 2 * corners.sizes)
    begins = np.cumsum(lists.sizes) - lists.sizes
    leave_out(_TEXCOORD, ~right & (lists.sizes > 0) & (corners.sizes > 2), "face", notices)
    within = faces.places - (np.cumsum(corners.sizes) - corners.sizes)[faces.faces][:, None]
    place = np.where(right[faces.faces][:, None], begins[faces.faces][:, None] + 2 * within, 0)
    values = np.append(lists.values.astype(np.float64), [0, 0])
    uv = np.where(right[faces.faces][:, None, None], values[np.stack([place, place + 1], axis=-1)], 0)
    wrong: Mask = np.asarray(~np.isfinite(uv).all(axis=(1, 2)))
    if wrong.any():
        notices.leave_out(UV_BROKEN, int(wrong.sum()), f"face {faces.faces[np.argmax(wrong)]:,}")
    return np.where(wrong[:, None, None], 0, uv)


def _by_picture(
    file: File, face: Columns, owner: Ints, count: int, notices: Notices
) -> Iterator[tuple[str | None, Any]]:
    """Yield each picture with its triangles, of `count`; `owner` are the faces of the first ones."""
    numbers = face.get("texnumber")
    if not file.pictures or not isinstance(numbers, np.ndarray) or not len(owner):
        notices.ignore("pictures after the first, as faces have no texnumber", max(len(file.pictures) - 1, 0))
        yield (file.pictures[0] if file.pictures else None), ALL
        return
    has_picture: Mask = np.asarray((numbers >= 0) & (numbers < len(file.pictures)) & (numbers == np.floor(numbers)))
    leave_out(
        _PICTURE, ~has_picture & (numbers != -1), "face", notices
    )  # MeshLab writes -1 for faces without a picture
    picture = np.full(count, -1)
    picture[: len(owner)] = np.where(has_picture, numbers, -1)[owner]
    for number in np.unique(picture).tolist():
        yield (None if number < 0 else file.pictures[number]), np.flatnonzero(picture == number)
