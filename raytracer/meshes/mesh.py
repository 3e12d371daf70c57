"""A triangle mesh: vertices, faces, and the attributes of corners.

Stage: scene description. `layout` takes its `corners`, `face_normals`, `normals` and `colors` into tables.

>>> mesh = Mesh(vertices=[[0, 0, 0], [1, 0, 0], [0, 1, 0]], faces=[[0, 1, 2]])
>>> mesh.face_normals.tolist()
[[0.0, 0.0, 1.0]]
"""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from os import PathLike
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raytracer.accel.planes import lengths_of, normals_of, unit
from raytracer.appearance.materials import PLAIN, Triple
from raytracer.appearance.metallic_roughness import AnyMaterial
from raytracer.arrays import array_of, finite_number, finite_triple, numbers
from raytracer.errors import SceneError, warn
from raytracer.memory import INSTANCE, TRIANGLE, check_triangles
from raytracer.meshes.smoothing import normals_at_corners

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
SMOOTH_BELOW = 45.0
"""Two faces that meet at a smaller angle than this, in degrees, are taken for parts of one curved surface."""


FARTHEST = 1e36
"""The largest coordinate of a vertex: distances between some are still numbers in binary32."""
_ROWS = 1 << 12
"""Rows that are multiplied by a matrix or measured at once, at most."""
_AT_ONCE = 1 << 12
"""Triangles that are searched for an area at once: the first ones have some, as a rule."""
LOADERS: dict[str, Callable[..., Mesh]] = {}
"""The functions behind `Mesh.load` and `Mesh.from_trimesh`, which need Mesh: their modules enter them."""
MANY: Final = 1 << 20
"""Triangles of instances from which on a scene is laid out in two levels, or a warning says that it is not."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one material.

    `vertices` (V, 3), `faces` (F, 3) vertex numbers, `normals` None (flat) or (V, 3) or, one per corner, (F, 3, 3),
    `colors` None or linear RGB in the same shapes, `uv` None or coordinates on textures, (V, 2) or (F, 3, 2), of which
    (0, 0) is the lower left corner of a picture. Copies are kept, as float64 and int64; normals, colors and uv always
    per corner. Normals may have any length; they are kept with length 1. A zero one becomes the triangle's own.
    Raises SceneError for wrong shapes, numbers that are not finite, vertices beyond 1e36, faces without their vertices.
    """

    vertices: Any
    faces: Any
    normals: Any = None
    colors: Any = None
    material: AnyMaterial = PLAIN
    name: str = "mesh"
    uv: Any = None

    def __post_init__(self) -> None:
        _checked(self.material)
        if not isinstance(self.name, str):
            raise SceneError(f"the name of a mesh is a str, not {self.name!r}")
        vertices = self._places(self.vertices)
        faces = array_of(f"{self.name}: faces", self.faces)
        if faces.size == 0:
            faces = np.zeros((0, 3), dtype=np.int64)
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise SceneError(f"{self.name}: faces are integers (F, 3), not {faces.dtype} {faces.shape}")
        if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
            wrong = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))[0])
            raise SceneError(f"{self.name}: face {wrong} names a vertex that is not among the {len(vertices)}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces.astype(np.int64))
        for what, size in (("normals", 3), ("colors", 3), ("uv", 2)):
            if getattr(self, what) is not None:
                object.__setattr__(self, what, self._at_corners(what, getattr(self, what), size))
        if self.normals is not None:
            object.__setattr__(self, "normals", self._of_unit_length(self.normals))

    def with_vertices(self, vertices: ArrayLike, normals: ArrayLike | None) -> Mesh:
        """Return the mesh with other vertices (V, 3), as many as before, and other normals, as those of a `Mesh`.

        Only these are checked; faces, colors and uv are the same arrays. Raises SceneError as `Mesh` does.
        """
        shape = array_of(f"{self.name}: vertices", vertices).shape
        if shape != self.vertices.shape:
            raise SceneError(f"{self.name}: other vertices are {self.vertices.shape}, as before, not {shape}")
        mesh = self._with(vertices=self._places(vertices), normals=None)
        if normals is None:
            return mesh
        return mesh._with(normals=mesh._of_unit_length(self._at_corners("normals", normals, 3)))

    def _places(self, values: ArrayLike) -> Floats:
        """Return vertices (V, 3), checked."""
        vertices = self._array("vertices", values).reshape(-1, 3)
        farthest = float(np.abs(vertices).max(initial=0))
        if farthest > FARTHEST:
            reach = f"within {FARTHEST:g} of 0, not at {farthest:.3g}"
            raise SceneError(f"{self.name}: vertices lie {reach}; scale the mesh")
        return vertices

    def _array(self, what: str, values: ArrayLike, size: int = 3) -> Floats:
        array = numbers(f"{self.name}: {what}", values).astype(np.float64)  # a copy: callers keep their own
        if array.size and array.shape[-1:] != (size,):
            raise SceneError(f"{self.name}: {what} have {size} components, not shape {array.shape}")
        if not np.all(np.isfinite(array)):
            raise SceneError(f"{self.name}: {what} contain NaN or infinity")
        return array

    def _at_corners(self, what: str, values: ArrayLike, size: int) -> Floats:
        array = self._array(what, values, size)
        if array.shape == (len(self.vertices), size):
            return np.asarray(array[self.faces])
        if array.shape != (len(self.faces), 3, size):
            raise SceneError(f"{self.name}: {what} are (V, {size}) or (F, 3, {size}), not {array.shape}")
        return array

    def _of_unit_length(self, normals: Floats) -> Floats:
        """Divide normals (F, 3, 3) by their lengths; where they are zero, take those of the faces.

        Normals whose length is 1 within a rounding to binary32 stay unchanged.
        """
        parts = (normals[start : start + _ROWS] for start in range(0, len(normals), _ROWS))  # each fits a cache
        if all(_has_unit_length(part).all() for part in parts):
            return normals
        return np.where(normals.any(axis=-1, keepdims=True), of_unit_length(normals), self.face_normals[:, None])

    def __repr__(self) -> str:
        parts = [part for part in ("normals", "colors", "uv") if getattr(self, part) is not None]
        return f"<Mesh {self.name}: {', '.join([f'{len(self):,} triangles', *parts])}>"

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.faces)

    @property
    def corners(self) -> Floats:
        """The corners of the triangles, (F, 3, 3)."""
        return np.asarray(self.vertices.take(self.faces, axis=0))  # several times as fast as an index

    @property
    def used_vertices(self) -> Floats:
        """The vertices (N, 3) that triangles have, each once."""
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        return np.asarray(self.vertices if used.all() else self.vertices[used])

    @property
    def face_normals(self) -> Floats:
        """Unit normals of the triangles, (F, 3), by the right-hand rule; zero for a triangle without area."""
        return normals_of(self.corners)

    @property
    def has_area(self) -> bool:
        """Return True if any triangle has an area above 0."""
        parts = (self.faces[start : start + _AT_ONCE] for start in range(0, len(self), _AT_ONCE))
        return any(normals_of(self.vertices[part]).any() for part in parts)

    def with_material(self, material: AnyMaterial, name: str | None = None) -> Mesh:
        """Return the same mesh of another material, and under another name if there is one."""
        mesh = self._with(material=_checked(material))
        return mesh if name is None else mesh._with(name=name)

    def _with(self, **values: Any) -> Mesh:
        """Return the mesh with other attributes, which are checked already; all others are the same arrays."""
        mesh = copy.copy(self)
        for name, value in values.items():
            object.__setattr__(mesh, name, value)
        return mesh

    def moved(self, offset: Triple = (0, 0, 0), *, scale: float = 1.0, turn: float = 0.0, tilt: float = 0.0) -> Mesh:
        """Scale, tilt about x and turn about y (degrees), then move by `offset`.

        A negative scale mirrors, so it turns the faces over, as `transformed` does.
        """
        arguments = {"scale": scale, "turn": turn, "tilt": tilt}
        scale, *angles = (finite_number(f"{self.name}: a {what}", value) for what, value in arguments.items())
        a, b = np.radians(angles)
        about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
        matrix = about_y @ about_x
        placed = self._turned_over() if scale < 0 else self
        normals = None if placed.normals is None else placed.normals @ matrix.T * (-1.0 if scale < 0 else 1.0)
        vertices = self.vertices @ matrix.T * scale + finite_triple(f"{self.name}: an offset", offset)
        return dataclasses.replace(placed, vertices=vertices, normals=normals)

    def transformed(self, matrix: ArrayLike) -> Mesh:
        """Transform by a matrix (4, 4) that multiplies columns (x, y, z, 1), as glTF's and trimesh's do.

        Normals stay across their surfaces, and a matrix that mirrors turns the faces over, so that the outside stays
        outside. Raises SceneError for other shapes, numbers that are not finite, and a last row that is not 0 0 0 1.
        """
        matrix = affine(matrix)
        if np.array_equal(matrix, np.eye(4)):
            return self
        turn = matrix[:3, :3]
        mirrors = bool(np.linalg.det(turn) < 0)
        with np.errstate(over="ignore", invalid="ignore"):  # Mesh refuses numbers that are not finite
            vertices = product(self.vertices, turn.T) + matrix[:3, 3]
        placed, normals = self._turned_over() if mirrors else self, None
        if placed.normals is not None:
            normals = product(placed.normals, _cofactors(turn, mirrors))
        return placed.with_vertices(vertices, normals)

    def _turned_over(self) -> Mesh:
        """Return the mesh with the corners of each triangle in the opposite order."""
        at = {name: getattr(self, name) for name in ("faces", "normals", "colors", "uv")}
        other: dict[str, Any] = {name: a if a is None else a[:, ::-1] for name, a in at.items()}
        return dataclasses.replace(self, **other)

    def smoothed(self, below: float = SMOOTH_BELOW) -> Mesh:
        """Give each corner a normal: the mean of the faces that meet there at less than `below` degrees.

        Faces are weighed by their area; vertices at the same place count as one. Where more than 64 faces meet, the
        angles are taken between groups of faces whose normals differ by a few degrees.
        """
        return smoothed([self], below)[0]

    @classmethod
    def load(cls, path: str | PathLike[str], *, material: AnyMaterial | None = None, strict: bool = False) -> Mesh:
        """Read an OBJ, PLY, STL, GLB, glTF or OFF file, all its parts as one mesh; see `loading.load_mesh`.

        With `strict` a bad entry of the file is a SceneError; otherwise it is left out, and a warning counts them.
        """
        return LOADERS["file"](path, material=material, strict=strict)

    @classmethod
    def from_trimesh(cls, part: Any, *, material: AnyMaterial | None = None, name: str | None = None) -> Mesh:
        """Convert a trimesh.Trimesh with its material, uv coordinates and colours; see `from_trimesh.mesh_of`."""
        return LOADERS["trimesh"](part, material=material, name=name)


def joined(meshes: Sequence[Mesh], name: str = "mesh") -> Mesh:
    """Join meshes to one of the first one's material; make up normals, colours or uv that one of them lacks."""
    normals: Floats | None = None
    colors: Floats | None = None
    uv: Floats | None = None
    if any(m.normals is not None for m in meshes):
        flat = [np.repeat(m.face_normals[:, None], 3, axis=1) if m.normals is None else m.normals for m in meshes]
        normals = np.concatenate(flat)
    if any(m.colors is not None for m in meshes):
        colors = np.concatenate([np.ones((len(m), 3, 3)) if m.colors is None else m.colors for m in meshes])
    if any(m.uv is not None for m in meshes):
        uv = np.concatenate([np.zeros((len(m), 3, 2)) if m.uv is None else m.uv for m in meshes])
    vertices, faces = _in_one_table(meshes)
    return Mesh(vertices, faces, normals, colors, meshes[0].material, name, uv)


def smoothed(meshes: Sequence[Mesh], below: float = SMOOTH_BELOW) -> list[Mesh]:
    """Give meshes normals as `Mesh.smoothed` does, together: faces of several meet at the same place, too."""
    below = finite_number(f"{meshes[0].name}: an angle" if meshes else "an angle", below)
    if not any(map(len, meshes)):
        return list(meshes)
    vertices, faces = meshes[0].vertices, meshes[0].faces
    if len(meshes) > 1:
        vertices, faces = _in_one_table(meshes)
    ends = np.cumsum([len(mesh) for mesh in meshes])[:-1]
    normals = np.split(normals_at_corners(vertices, faces, below), ends)
    return [mesh._with(normals=own) for mesh, own in zip(meshes, normals, strict=True)]


def _in_one_table(meshes: Sequence[Mesh]) -> tuple[Floats, Ints]:
    """Return the vertices of all meshes, and their faces with the numbers of these."""
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    vertices = np.concatenate([m.vertices for m in meshes])
    return vertices, np.concatenate([m.faces + start for m, start in zip(meshes, starts[:-1], strict=True)])


def _checked(material: AnyMaterial) -> AnyMaterial:
    """Return a material; SceneError for anything else."""
    if not isinstance(material, AnyMaterial):
        raise SceneError(f"the material of a mesh is a Material, such as Material((1, 0, 0)), not {material!r}")
    return material


def affine(matrix: ArrayLike) -> Floats:
    """Copy a matrix (4, 4) to f64; SceneError if it has another shape, is not finite, or ends not in 0 0 0 1."""
    try:
        transform = np.array(matrix, dtype=np.float64)  # a copy, as for a Mesh
    except (TypeError, ValueError):
        transform = np.zeros(0)
    if (
        transform.shape != (4, 4)
        or not np.all(np.isfinite(transform))
        or not np.array_equal(transform[3], (0, 0, 0, 1))
    ):
        text = " ".join(str(matrix).split())[:80]
        raise SceneError(f"a transform is a matrix (4, 4) of finite numbers whose last row is 0 0 0 1, not {text}")
    return transform


def _cofactors(matrix: Floats, mirrors: bool) -> Floats:
    """Return the matrix for rows of normals where `matrix` transforms the places: its cofactors, transposed.

    They equal the inverse up to a factor, and singular matrices have them, too, such as a scale by (1, 1, 0).
    """
    matrix = matrix / (np.abs(matrix).max() or 1)
    x, y, z = matrix.T
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)])
    return np.asarray(-cofactors if mirrors else cofactors)


def of_unit_length(vectors: Floats) -> Floats:
    """Divide vectors by their lengths; normals whose length is 1 within a rounding to binary32 stay unchanged."""
    return np.where(_has_unit_length(vectors)[..., None], vectors, unit(vectors))


def _has_unit_length(vectors: Floats) -> NDArray[np.bool_]:
    """Return which vectors have length 1, but for rounding to binary32."""
    return np.asarray(np.abs(lengths_of(vectors) - 1) <= 1e-6)


def product(vectors: Floats, matrix: Floats) -> Floats:
    """Return vectors (..., 3) times a matrix (3, N).

    A product of many rows takes a tenth of the time of many of three rows. With `_ROWS` BLAS starts no threads, which
    would wait for each other on a machine that does other work. Parts are alike, as BLAS rounds a single row otherwise.
    """
    products = np.empty((*vectors.shape[:-1], matrix.shape[1]))
    count = vectors.size // 3 // _ROWS + 1
    sides = (np.array_split(rows.reshape(-1, rows.shape[-1]), count) for rows in (vectors, products))
    for part, place in zip(*sides, strict=True):
        np.matmul(part, matrix, out=place)
    return products


@dataclass(frozen=True, eq=False)
class Instance:
    """A mesh that is moved into place by `transform`.

    `transform` (4, 4) multiplies columns (x, y, z, 1); it may scale, shear and mirror. `name` is the mesh's own if none
    is given. Many instances of a mesh share its triangles and its accelerator in pictures: see docs/raytracer-files.md.
    Raises SceneError for arguments of other types and shapes.
    """

    mesh: Mesh
    transform: Any
    name: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.mesh, Mesh):
            raise SceneError(f"an Instance is one of a Mesh, not of a {type(self.mesh).__name__}")
        object.__setattr__(self, "transform", affine(self.transform))

    @property
    def placed(self) -> Mesh:
        """The transformed mesh, with the name of the instance if it has one.

        Its arrays are computed when they are first read, but where the transform flattens the mesh.
        """
        mesh = self.mesh
        if not isinstance(mesh, PlacedMesh):
            mesh = PlacedMesh.of(mesh, np.eye(4), mesh.name, mesh.material)
        moved = mesh.transformed(self.transform)
        return moved if self.name is None else moved._with(name=self.name)


class PlacedMesh(Mesh):
    """The mesh of an `Instance` in its place: `source`, moved by `transform`.

    Its arrays are computed when they are first read, and kept from then on. Another material, name or place leaves it a
    PlacedMesh; any other change makes a Mesh of its own.
    """

    source: Mesh
    transform: Floats

    def __new__(cls, *arguments: Any, **fields: Any) -> Mesh:  # type: ignore[misc]
        """Return a Mesh: `dataclasses.replace` makes a copy with other arrays by the class of the original."""
        return Mesh(*arguments, **fields)

    @classmethod
    def of(cls, source: Mesh, transform: Floats, name: str, material: AnyMaterial) -> PlacedMesh:
        """Return a mesh in the place to which a matrix (4, 4) with an inverse moves it."""
        mesh: PlacedMesh = object.__new__(cls)
        vars(mesh).update(source=source, transform=transform, name=name, material=material)
        return mesh

    @functools.cached_property
    def _moved(self) -> Mesh:
        return self.source.transformed(self.transform)

    vertices = property(attrgetter("_moved.vertices"))
    faces = property(attrgetter("_moved.faces"))
    normals = property(lambda self: None if self.source.normals is None else self._moved.normals)
    colors = property(lambda self: None if self.source.colors is None else self._moved.colors)
    uv = property(lambda self: None if self.source.uv is None else self._moved.uv)

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.source)

    def __reduce__(self) -> Any:
        return PlacedMesh.of, (self.source, self.transform, self.name, self.material)

    @property
    def used_vertices(self) -> Floats:
        """The vertices (N, 3) that triangles have, each once. They are not kept."""
        return product(self.source.used_vertices, self.transform[:3, :3].T) + self.transform[:3, 3]

    @functools.cached_property
    def box(self) -> Floats:
        """The corners (2, 3) of the box round its triangles, at least one; it is kept for all scenes of the mesh."""
        vertices = self.used_vertices
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])

    @property
    def has_area(self) -> bool:
        """Return True if any triangle has an area above 0."""
        return self.source.has_area

    def transformed(self, matrix: ArrayLike) -> Mesh:
        """Transform as other meshes; it stays a PlacedMesh unless the matrix flattens it."""
        transform = affine(matrix) @ self.transform
        if flattens(transform) or not _stays_near(self.source, transform):
            return super().transformed(matrix)
        return PlacedMesh.of(self.source, transform, self.name, self.material)

    def _with(self, **values: Any) -> Mesh:
        if values.keys() - {"material", "name"}:
            return self._moved._with(**{"material": self.material, "name": self.name} | values)
        mesh: PlacedMesh = object.__new__(PlacedMesh)
        vars(mesh).update(vars(self) | values)
        return mesh


FLAT: Final = 2.0**-20
"""The determinant below which a matrix, its largest entry 1, is taken for one that has no inverse."""


def flattens(matrix: Floats) -> bool:
    """Return whether a matrix (4, 4) flattens what it moves, so that there is no way back."""
    turn = matrix[:3, :3]
    with np.errstate(all="ignore"):
        return not abs(np.linalg.det(turn / (np.abs(turn).max() or 1))) >= FLAT


def _stays_near(mesh: Mesh, matrix: Floats) -> bool:
    """Return whether all vertices have places that `Mesh` accepts after a matrix has moved them."""
    largest = np.abs(mesh.vertices).max(axis=0, initial=0.0)
    with np.errstate(all="ignore"):
        return bool((np.abs(matrix[:3, :3]) @ largest + np.abs(matrix[:3, 3]) <= FARTHEST).all())


def unplaced(mesh: Mesh) -> Mesh:
    """Return the mesh that an instance places elsewhere; other meshes unchanged."""
    return mesh.source if isinstance(mesh, PlacedMesh) else mesh


def placed_all(parts: Iterable[Mesh | Instance]) -> list[Mesh]:
    """Return meshes as they are, and instances in their places.

    Raises SceneError where the triangles exceed the memory, of which those of instances count once.
    """
    parts = list(parts)
    sources = [unplaced(part.mesh if isinstance(part, Instance) else part) for part in parts]
    meshes = {id(source): source for source in sources}
    check_triangles(INSTANCE * len(parts) + sum(map(len, meshes.values())))
    return [part.placed if isinstance(part, Instance) else part for part in parts]


def check_expansion(name: str, meshes: Sequence[Mesh]) -> None:
    """Warn where many triangles of instances are about to get places of their own; SceneError beyond the memory."""
    instances = [mesh for mesh in meshes if isinstance(mesh, PlacedMesh)]
    check_triangles(sum(map(len, meshes)))
    shared = {id(mesh.source): len(mesh) for mesh in instances}
    total, different = sum(map(len, instances)), sum(shared.values())
    if total >= MANY and total >= 2 * different:
        plural = "" if len(shared) == 1 else "es"
        warn(
            f"{name}: each of {len(instances):,} instances of {len(shared):,} mesh{plural} gets triangles of its own, "
            f"{total:,} where {different:,} are different: they take {total * TRIANGLE / 2**30:.1f} GiB of memory or "
            "more, and are prepared one by one"
        )
