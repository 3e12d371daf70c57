"""Wavefront OBJ files as meshes.

Stage: scene description. They are read here and not by trimesh, which takes a negative number for one from the end of
the file where it counts back from the face, drops the colours of vertices that have uv coordinates, and merges objects.
A part is all faces with one material under one name of `o`, or of `g` without `o`.

    obj = read_obj(data, notices)
    meshes = list(obj.meshes("chair"))
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.planes import unit
from raytracer.appearance.textures import decoded
from raytracer.meshes.folder import Notices
from raytracer.meshes.lines import Floats, Ints
from raytracer.meshes.mesh import Mesh, of_unit_length
from raytracer.meshes.obj_statements import ANGLE, Part, Statements, read_statements
from raytracer.meshes.polygons import triangulated


class _Parts(NamedTuple):
    """The parts of a file, and the part and smoothing group of each triangle."""

    names: list[Part]
    part: Ints
    group: Ints

    def triangles(self) -> Iterator[tuple[Part, Ints | slice]]:
        """Yield each part with the places of its triangles."""
        if len(self.names) < 2:
            yield from ((name, slice(None)) for name in self.names)
            return
        order = np.argsort(self.part, kind="stable")
        ends = np.cumsum(np.bincount(self.part, minlength=len(self.names)))
        yield from zip(self.names, np.split(order, ends[:-1]), strict=True)


def read_obj(data: bytes, default: str, notices: Notices) -> tuple[list[tuple[Part, Mesh]], list[str]]:
    """Return the parts of a file as meshes of the default material, and the names of its libraries of materials.

    Parts without a name are named `default`.
    """
    statements = read_statements(data, notices)
    return list(_meshes(statements, default, notices)), statements.libraries


def _meshes(statements: Statements, default: str, notices: Notices) -> Iterator[tuple[Part, Mesh]]:
    places, colors = _split(statements.tables[0])
    triangulation = triangulated(places, statements.corners[:, 0], statements.sizes)
    triangulation.report(notices, lambda face: f"line {statements.lines[face]}")
    corners = statements.corners[triangulation.corners]
    uv, across = _table(statements.tables[1]), of_unit_length(_table(statements.tables[2]))  # once for all parts
    parts = _parts(statements, triangulation.faces)
    smooth = _smoothed(places, corners[..., 0], parts.group)
    for part, chosen in parts.triangles():
        own = corners[chosen]
        used, faces = _used(own[..., 0], len(places))
        normals = _rows(across, own[..., 2])
        if parts.group[chosen].max(initial=ANGLE) != ANGLE:
            normals = np.zeros((len(own), 3, 3)) if normals is None else normals
            if smooth is not None:
                normals = np.where((own[..., 2] < 0)[..., None], smooth[chosen], normals)
        yield (
            part,
            Mesh(
                places[used],
                faces,
                normals,
                None if colors is None else colors[used],
                name=part.name or default,
                uv=_rows(uv, own[..., 1]),
            ),
        )


def _parts(statements: Statements, faces: Ints) -> _Parts:
    """Return the parts, in the order of their first triangles, whose faces are given."""
    state = np.searchsorted(np.array([begin for begin, _ in statements.states]), faces, side="right") - 1
    numbers: dict[Part, int] = {}
    for number in state[np.flatnonzero(np.diff(state, prepend=-1))].tolist():
        numbers.setdefault(statements.states[number][1].part, len(numbers))
    part = np.array([numbers.get(each.part, -1) for _, each in statements.states])
    return _Parts(list(numbers), part[state], np.array([each.group for _, each in statements.states])[state])


def _split(vertices: Floats) -> tuple[Floats, Floats | None]:
    """Return positions (V, 3) and linear colours (V, 3), None if no vertex has a colour.

    MeshLab and ZBrush write a vertex's colour in sRGB after its position; a vertex without one is white. Where one is
    above 2, some program has written all of them as bytes.
    """
    places, colors = vertices[:, :3], vertices[:, 3:]
    if np.isnan(colors).all():
        return places, None
    white = 255.0 if np.nanmax(colors) > 2 else 1.0
    colors = np.where(np.isnan(colors), white, colors)
    return places, decoded(np.clip(colors / white, 0, 1))


def _table(rows: Floats) -> Floats:
    """Return rows with two more of zeros, those of MISSING and BAD; what is left out is zero."""
    return np.concatenate([np.nan_to_num(rows), np.zeros((2, rows.shape[1]))])


def _rows(table: Floats, index: NDArray[np.int32]) -> Floats | None:
    """Return the rows of a table at the corners (T, 3) of triangles; None if no corner has one."""
    return table[index] if (index >= 0).any() else None


def _used(index: NDArray[np.int32], count: int) -> tuple[Any, NDArray[Any]]:
    """Return which of `count` vertices triangles have, and the triangles with the numbers of these."""
    if index.size < count:  # a small part of a file
        used, faces = np.unique(index, return_inverse=True)
        return used, faces.reshape(-1, 3)
    mask = np.zeros(count, bool)
    mask[index] = True
    if mask.all():
        return slice(None), index
    return np.flatnonzero(mask), (np.cumsum(mask) - 1)[index]


def _smoothed(places: Floats, index: NDArray[np.int32], group: Ints) -> Floats | None:
    """Return normals at the corners (T, 3, 3) of triangles in smoothing groups, zero in others; None without groups.

    A normal is the mean of the faces of its group that have the same vertex, weighed by their angles there (Thürmer and
    Wüthrich 1998), so that it does not depend on how a face is cut into triangles.
    """
    chosen = np.flatnonzero(group > 0)
    if not len(chosen):
        return None
    corners = index[chosen].astype(np.int64)
    at = places[corners]
    sides = unit(np.roll(at, -1, axis=1) - at)
    angles = np.arccos(np.clip(-np.einsum("ijk,ijk->ij", sides, np.roll(sides, 1, axis=1)), -1, 1))
    across = unit(np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]))
    key = group[chosen][:, None] * len(places) + corners
    _, number = np.unique(key, return_inverse=True)
    number = number.reshape(-1)
    weighted = (angles[..., None] * across[:, None]).reshape(-1, 3)
    sums: Floats = np.stack([np.bincount(number, weights=weighted[:, axis]) for axis in range(3)], axis=1)
    normals = np.zeros((len(index), 3, 3))
    normals[chosen] = unit(sums)[number].reshape(-1, 3, 3)
    return normals
