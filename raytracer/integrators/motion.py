"""The meshes of a renderer's scene, with the moves and deformations made so far, and their layered depth cubes.

Stage: render. A `Renderer` asks for what has changed before each picture.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raytracer.accel.bvh import MANY
from raytracer.accel.space import frame_of
from raytracer.arrays import is_whole
from raytracer.errors import SceneError
from raytracer.integrators.integrator import Integrator, structure_of
from raytracer.layered.cube import HasMeshes, LayeredCube, cube_of, is_layered
from raytracer.layered.placed import Meshes, PlacedCubes
from raytracer.meshes.folder import named
from raytracer.meshes.mesh import Mesh, PlacedMesh, affine, flattens, unplaced
from raytracer.scene.layout import Change, Layout
from raytracer.scene.scene import Scene

_AT_VERTICES = ("normals", "colors", "uv")


class Motion:
    """The meshes of a scene at their places; `changed` are the numbers of those that the picture does not show yet.

    Each has the mesh that was given or deformed last, in `untransformed`, and the matrix by which it is transformed.
    """

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        self.meshes = list(meshes)
        self.changed: set[int] = set()
        self.untransformed = list(meshes)
        self._shown = list(meshes)
        self._transforms: dict[int, NDArray[np.float64]] = {}
        self._bounds: dict[int, NDArray[np.float64]] = {}
        self._used: dict[int, tuple[Any, Any]] = {}

    def move(self, name: str | int, transform: ArrayLike) -> None:
        """Transform all meshes of a name, or the one of a number, as they were given."""
        matrix, numbers = affine(transform), self.numbers(name)
        placed = {number: self.untransformed[number].transformed(matrix) for number in numbers}
        for number, mesh in placed.items():
            self._transforms[number] = matrix
            self._take(number, mesh)

    def deform(self, name: str | int, vertices: ArrayLike, normals: ArrayLike | None) -> None:
        """Give the mesh of a name or number other vertices, before it is transformed."""
        number, *others = self.numbers(name)
        if others:
            places = ", ".join(map(str, [number, *others]))
            raise SceneError(f"there are {len(others) + 1} meshes {name!r}: deform one of them by its number, {places}")
        mesh = self.untransformed[number]
        if normals is not None and mesh.normals is None:
            raise SceneError(f"{mesh.name}: the mesh is flat, and has no normals: deform it without normals")
        deformed = mesh.with_vertices(vertices, normals)
        if normals is None and mesh.normals is not None:
            deformed = deformed.smoothed()
        transform = self._transforms.get(number)
        placed = deformed if transform is None else deformed.transformed(transform)
        self.untransformed[number] = deformed
        self._take(number, placed)

    def suit(self, meshes: Sequence[Mesh], *, still: bool) -> bool:
        """Return whether `follow` may take other meshes: they are alike, and with `still` none has moved."""
        if len(meshes) != len(self.meshes) or not all(map(_alike, meshes, self.meshes)):
            return False
        return not still or all(map(_equal, meshes, self.meshes))

    def follow(self, meshes: Sequence[Mesh]) -> None:
        """Replace the meshes by others that `suit`."""
        for number, (mesh, before) in enumerate(zip(meshes, self.meshes, strict=True)):
            self.untransformed[number] = mesh
            self._transforms.pop(number, None)
            if _equal(mesh, before):
                self.meshes[number] = mesh  # its material may be another one
            else:
                self._take(number, mesh)

    def numbers(self, name: str | int) -> list[int]:
        """Return the numbers of the meshes of a name, or the number itself; SceneError where there is none."""
        if isinstance(name, str):
            numbers = [number for number, mesh in enumerate(self.meshes) if mesh.name == name]
        else:
            numbers = [int(name)] if is_whole(name, 0, len(self.meshes) - 1) else []
        if not numbers:
            names = list(dict.fromkeys(mesh.name for mesh in self.meshes))
            raise SceneError(f"the scene has no mesh {name!r}: its meshes are {named(names) or 'none'}")
        return numbers

    def transform(self, number: int) -> NDArray[np.float64]:
        """Return the matrix by which a mesh is transformed."""
        return self._transforms.get(number, np.eye(4))

    @property
    def changes(self) -> dict[int, tuple[Mesh, Mesh]]:
        """The meshes that changed by their numbers, each with the one that the picture shows."""
        return {number: (self.meshes[number], self._shown[number]) for number in sorted(self.changed)}

    def accept(self) -> None:
        """Take the meshes for those that the picture shows."""
        self._shown = list(self.meshes)
        self.changed.clear()

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The corners of the box round all triangles."""
        boxes = [self._box(number) for number, mesh in enumerate(self.meshes) if len(mesh)]
        return np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)

    def _take(self, number: int, mesh: Mesh) -> None:
        self.meshes[number] = mesh
        self._bounds.pop(number, None)
        if len(mesh):
            self.changed.add(number)

    def _box(self, number: int) -> Any:
        if number not in self._bounds:
            mesh = self.meshes[number]
            if isinstance(mesh, PlacedMesh):
                return mesh.box
            by_axis = mesh.vertices[self._used_by(number)].T.copy()  # min and max of contiguous numbers are faster
            self._bounds[number] = np.stack([by_axis.min(axis=1), by_axis.max(axis=1)])
        return self._bounds[number]

    def _used_by(self, number: int) -> Any:
        """Return the index of the vertices that faces have, kept as long as the array of faces is the same."""
        faces, used = self._used.get(number, (None, None))
        mesh = self.meshes[number]
        if faces is not mesh.faces:
            is_used = np.zeros(len(mesh.vertices), bool)
            is_used[mesh.faces] = True
            used = slice(None) if is_used.all() else np.flatnonzero(is_used)
            self._used[number] = mesh.faces, used
        return used


def _alike(mesh: Mesh, before: Mesh) -> bool:
    """Return whether meshes have as many vertices and faces, the same name, and data of the same kinds."""
    if mesh is before:
        return True
    one, other = unplaced(mesh), unplaced(before)
    kinds = all((getattr(one, name) is None) == (getattr(other, name) is None) for name in _AT_VERTICES)
    sizes = one.vertices.shape == other.vertices.shape and len(mesh) == len(before)
    return kinds and mesh.name == before.name and sizes


def _equal(mesh: Mesh, before: Mesh) -> bool:
    """Return whether meshes that are alike are equal but for their materials."""
    if isinstance(mesh, PlacedMesh) and isinstance(before, PlacedMesh):
        return np.array_equal(mesh.transform, before.transform) and _equal(mesh.source, before.source)
    names = ("vertices", "faces", *_AT_VERTICES)
    both = ((getattr(mesh, name), getattr(before, name)) for name in names)
    return all(array is other or np.array_equal(array, other) for array, other in both)


@contextmanager
def all_or_nothing(changed: object) -> Iterator[None]:
    """Give an object back the attributes that it had if what is done within fails."""
    before = dict(changed.__dict__)
    try:
        yield
    except BaseException:
        changed.__dict__.clear()
        changed.__dict__.update(before)
        raise


@contextmanager
def moving(owner: object, motion: Motion, name: str | int, transform: ArrayLike) -> Iterator[None]:
    """Place meshes, as `Motion.move` does, of which `owner` makes tables within.

    If that fails, the owner has the attributes that it had. Raises SceneError for a mesh without triangles.
    """
    with all_or_nothing(owner):
        motion.move(name, transform)
        if not motion.changed:
            raise SceneError(f"the mesh {name!r} has no triangles: there is nothing to move")
        yield
    motion.accept()


def moved_rows(motion: Motion, moving: Sequence[int], layout: Layout, precision: str) -> list[Change] | None:
    """Move the objects `moving` in a layout; return the changes, or None if the scene must be rebuilt.

    Tables stay where these objects alone have moved, the scene's coordinates stay, and so do the cubes of objects.
    """
    origin, scale = frame_of(*motion.bounds, precision)
    stays = motion.changed <= set(moving) and np.array_equal(origin, layout.origin) and scale == layout.scale
    return layout.put(moving, motion.changes, precision) if stays and follow(motion, layout) else None


def moved_instances(motion: Motion, layout: Layout) -> Layout | None:
    """Return a layout in two levels after instances have moved; None where more than their places has changed."""
    bounds = motion.bounds
    origin, scale = frame_of(*bounds, "f32")
    if not (np.array_equal(origin, layout.origin) and scale == layout.scale):
        return None
    placed = {}
    for number, (mesh, before) in motion.changes.items():
        if not (isinstance(mesh, PlacedMesh) and isinstance(before, PlacedMesh) and _equal(mesh.source, before.source)):
            return None
        placed[number] = mesh.transform
    return layout.placed(placed, np.stack(bounds))


def laid_out(
    integrator: Integrator, scene: Scene, motion: Motion, moving: tuple[int, ...], backend: str, before: Any
) -> Layout:
    """Return the tables of a scene, with the cubes for secondary rays, some of them those of `before`."""
    structure = integrator.structure if moving else structure_of(integrator, scene)
    layout = Layout.of(scene, structure, integrator.precision, integrator.grid, moving, backend)
    if not has_cubes(integrator):
        return layout
    if moving:
        cubes: Any = object_cubes(integrator, motion, moving, layout, backend, before)
    else:
        cubes = scene_cube(integrator, scene, backend)
    return replace(layout, secondary=cubes)


def runs_kernels(integrator: Integrator, scene: Scene) -> bool:
    """Return whether `laid_out` may take its backend's kernels; the tables of other scenes are soon there."""
    return has_cubes(integrator) or not 0 < scene.triangles < MANY


def has_cubes(integrator: Integrator) -> bool:
    """Return whether secondary rays go through layered depth cubes."""
    accel = integrator.accel
    return getattr(integrator, "secondary", None) is not None or (accel is not None and is_layered(accel))


def scene_cube(integrator: Integrator, scene: HasMeshes, backend: str) -> LayeredCube:
    """Return the cube of a scene in which no object moves: the integrator's own cube, or a new one with its options."""
    own_cube: LayeredCube | None = getattr(integrator, "secondary", None)
    return _build_cube(integrator, scene, backend) if own_cube is None else own_cube


def object_cubes(
    integrator: Integrator, motion: Motion, moving: Sequence[int], layout: Layout, backend: str, before: Any
) -> PlacedCubes:
    """Make a cube for each object that moves, and one for the others; those of `before` that are of the same stay."""
    poses = {number: _pose(motion, number) for number in moving}
    meshes = {
        number: poses[number][0] if number in poses else mesh for number, mesh in enumerate(motion.meshes) if len(mesh)
    }
    cubes_by_part = dict(zip(before.parts, before.cubes, strict=True)) if isinstance(before, PlacedCubes) else {}
    cubes = PlacedCubes.of(
        meshes, moving, lambda part: cubes_by_part.get(part) or _build_cube(integrator, Meshes(part), backend)
    )
    cubes.place({number: matrix for number, (_, matrix) in poses.items()}, layout.origin, layout.scale)
    return cubes


def follow(motion: Motion, layout: Layout) -> bool:
    """Place a layout's cubes where the objects are; return False if one of these needs another cube."""
    cubes = layout.secondary
    if not isinstance(cubes, PlacedCubes):
        return True
    poses = {number: _pose(motion, number) for number in cubes.moving}
    if any(mesh is not before for (mesh, _), before in zip(poses.values(), cubes.objects, strict=True)):
        return False
    cubes.place({number: matrix for number, (_, matrix) in poses.items()}, layout.origin, layout.scale)
    return True


def _build_cube(integrator: Integrator, part: HasMeshes, backend: str) -> LayeredCube:
    own_cube: LayeredCube | None = getattr(integrator, "secondary", None)
    if own_cube is not None:
        return LayeredCube.of(part, backend=backend, **own_cube.options)
    assert integrator.accel is not None  # else there are no cubes
    return cube_of(integrator.accel, part, backend)


def _pose(motion: Motion, number: int) -> tuple[Mesh, NDArray[np.float64]]:
    """Return the mesh of which an object's cube is made, and its pose (4, 4).

    A transform that flattens the mesh has no inverse: then the mesh is transformed first, and the pose is the identity.
    """
    matrix = motion.transform(number)
    if flattens(matrix):
        return motion.meshes[number], np.eye(4)
    return motion.untransformed[number], matrix
