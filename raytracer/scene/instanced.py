"""The meshes of a scene as distinct parts and their instances.

Stage: layout. Takes a `Scene`, gives `Parts`: the meshes that stand in the scene's coordinates, those that stand at
several places, and where. `Layout` makes tables of them.

>>> import numpy as np
>>> from raytracer import Instance, Scene
>>> from raytracer.meshes.shapes import box, floor
>>> cube, away = box(), np.eye(4) + np.diag([3.0], 3)
>>> parts = Parts.of(Scene([floor(9), *(Instance(cube, place) for place in (np.eye(4), away))]))
>>> len(parts.settled), len(parts.sources), parts.number_of.tolist()
(1, 1, [-1, 1, 2])
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.space import Rows, to_kernel
from raytracer.accel.two_levels import TwoLevels
from raytracer.appearance.metallic_roughness import AnyMaterial
from raytracer.appearance.programs import examine_surface
from raytracer.errors import SceneError
from raytracer.meshes.mesh import MANY, Mesh, PlacedMesh
from raytracer.scene.scene import Scene

BEGINNING = 4000
"""Triangles in whose time a hierarchy is begun: each one takes 3 to 5 ms, and 1 microsecond for a triangle."""
_MOST = 2**31 - 1
"""Triangles of all instances, at most: each has a number of 32 bits."""
_LEAST = 1e-30
"""The largest entry of an instance's matrix, at least: binary32 holds its inverse."""


@dataclass(frozen=True, eq=False)
class Instanced:
    """The two `levels` of a layout, and the meshes of I instances.

    `settled` is the number of triangles, the first ones of the layout, that lie in the scene's coordinates; those of
    parts follow. `meshes` (I, 2) int32 are the number of the mesh of each instance and its material; 0 for the instance
    of the settled triangles, which have their own. `frames` are the origin and the scale of the coordinates of each
    part but that of the settled triangles. `box` (2, 3) are the corners of the box round all triangles.
    """

    levels: TwoLevels
    settled: int
    meshes: NDArray[np.int32]
    frames: Sequence[tuple[Rows, float]]
    box: Rows

    @property
    def boxes(self) -> NDArray[np.floating]:
        """The corners (n, 2, 3) of the boxes of instances but that of the settled triangles."""
        return self.levels.boxes[int(self.settled > 0) :]

    def moved(self, transforms: Mapping[int, Rows], box: Rows, origin: Rows, scale: float) -> Instanced | None:
        """Return the instances after meshes of these numbers have moved; None where one of them is no instance.

        `box` is that round all triangles after it, `origin` and `scale` are those of the layout.
        """
        own = int(self.settled > 0)
        instance_of = {int(number): own + k for k, number in enumerate(self.meshes[own:, 0])}
        if not transforms.keys() <= instance_of.keys():
            return None
        instances = np.array([instance_of[number] for number in transforms])
        frames = [self.frames[part - own] for part in self.levels.part_of[instances]]
        matrices = _matrices(list(transforms.values()), frames, origin, scale)
        if not (np.abs(matrices).max(axis=(1, 2)) > _LEAST).all():
            return None
        return replace(self, levels=self.levels.moved(instances, matrices), box=box)

    def materials_of(self, object_of: NDArray[np.int32], material_of: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the material of each mesh of the scene; `object_of` and `material_of` are those of triangles."""
        own, settled = self.meshes[int(self.settled > 0) :], slice(self.settled)
        materials = np.zeros(1 + max(object_of[settled].max(initial=0), own[:, 0].max(initial=0)), np.int32)
        materials[object_of[settled]] = material_of[settled]
        materials[own[:, 0]] = own[:, 1]
        return materials

    def places(self, sizes: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return the first triangle of each mesh, of `sizes` triangles, and its instance; 0 for an empty mesh."""
        firsts, instances = np.zeros((2, len(sizes)), np.int32)
        levels = self.levels
        places = np.searchsorted(levels.order[: self.settled], np.cumsum(sizes) - sizes)
        firsts[:] = np.where(places < self.settled, places, 0)
        own = int(self.settled > 0)
        numbers = self.meshes[own:, 0]
        firsts[numbers] = levels.starts[levels.part_of[own:]]
        instances[numbers] = np.arange(own, len(self.meshes))
        return firsts, instances


@dataclass(frozen=True, eq=False)
class Parts:
    """The `settled` meshes of a scene, and the distinct `sources` of others; meshes without triangles are in neither.

    `number_of` (I,) are the meshes of the instances, -1 for that of all settled ones, which comes first if there are
    any; `source_of` (I,) the places of their sources among `sources`.
    """

    scene: Scene
    settled: list[int]
    sources: list[Mesh]
    number_of: NDArray[np.int64]
    source_of: NDArray[np.int64]

    @classmethod
    def of(cls, scene: Scene) -> Parts:
        """Return the parts of a scene: meshes at one place alone, those that shine, and glass are settled."""
        shared: dict[Any, list[int]] = {}
        settled = []
        materials = _settling(scene.meshes)
        for number, mesh in enumerate(scene.meshes):
            if isinstance(mesh, PlacedMesh) and mesh.material not in materials:
                shared.setdefault(_key(mesh), []).append(number)
            elif len(mesh):
                settled.append(number)
        alone = [numbers[0] for numbers in shared.values() if len(numbers) == 1 and len(scene.meshes[numbers[0]])]
        groups = [numbers for numbers in shared.values() if len(numbers) > 1 and len(scene.meshes[numbers[0]])]
        settled = sorted(settled + alone)
        places = np.repeat(np.arange(len(groups)), list(map(len, groups)))
        numbers = np.array([number for group in groups for number in group], np.int64)
        order = np.argsort(numbers)
        first = [-1] * bool(settled)
        sources = [scene.meshes[group[0]] for group in groups]
        return cls(
            scene, settled,
            [mesh.source.with_material(mesh.material) for mesh in sources if isinstance(mesh, PlacedMesh)],
            np.concatenate([first, numbers[order]]).astype(np.int64),
            np.concatenate([first, places[order]]).astype(np.int64),
        )  # fmt: skip

    @property
    def meshes(self) -> list[Mesh]:
        """The meshes whose triangles a layout has, in order."""
        return [*(self.scene.meshes[number] for number in self.settled), *self.sources]

    def placed(
        self, corners: Rows, box: Rows, origin: Rows, scale: float, backend: str, material_of: Sequence[int]
    ) -> tuple[Rows, Instanced]:
        """Return the corners of all parts as kernels hold them, and the instances.

        `corners` (n, 3, 3) are those of the settled triangles in the kernel's coordinates, `box` is that round all,
        `material_of` the material of each mesh of the scene.
        """
        meshes = self.scene.meshes
        count = np.array([len(mesh) for mesh in meshes])
        firsts = np.cumsum(count) - count
        if int(count.sum()) > _MOST:
            raise SceneError(f"{self.scene.name}: {int(count.sum()):,} triangles of instances exceed {_MOST:,}")
        parts, matrices = [corners] if len(corners) else [], np.tile(np.eye(4)[:3], (len(self.number_of), 1, 1))
        local = [to_kernel(source.corners, "f32") for source in self.sources]
        parts += [corners for corners, *_ in local]
        frames = [(middle, size) for _, middle, size in local]
        own = int(bool(self.settled))
        placed = [mesh.transform for number in self.number_of[own:] if isinstance(mesh := meshes[number], PlacedMesh)]
        matrices[own:] = _matrices(placed, [frames[source] for source in self.source_of[own:]], origin, scale)
        if not (np.abs(matrices).max(axis=(1, 2)) > _LEAST).all():
            raise SceneError(f"{self.scene.name}: an instance is more than 10**30 times smaller than the scene")
        order = [np.arange(firsts[number], firsts[number] + count[number]) for number in self.settled]
        order += [np.arange(len(source)) for source in self.sources]
        whose = np.maximum(self.number_of, 0)
        rows = np.stack([whose, np.array(material_of)[whose], firsts[whose]], axis=1)
        rows[self.number_of < 0] = 0
        part_of = self.source_of + bool(self.settled)
        levels = TwoLevels.of(parts, part_of, matrices, np.concatenate(order), rows[:, 2], backend)
        instanced = Instanced(levels, len(corners), rows[:, :2].astype(np.int32), frames, box)
        return np.concatenate(parts), instanced


def _matrices(transforms: Sequence[Rows], frames: Sequence[tuple[Rows, float]], origin: Rows, scale: float) -> Rows:
    """Return the matrices (n, 3, 4) from the coordinates of parts to those of the scene's kernel.

    `frames` are those of the parts, `origin` and `scale` those of the scene.
    """
    matrices = np.empty((len(transforms), 3, 4))
    for matrix, transform, (middle, size) in zip(matrices, transforms, frames, strict=True):
        turn = transform[:3, :3]
        matrix[:, :3] = turn * (scale / size)
        matrix[:, 3] = (turn @ middle + transform[:3, 3] - origin) * scale
    return matrices


def shares_many(scene: Scene) -> bool:
    """Return whether the instances have at least MANY triangles, and at least twice those that two levels store."""
    placed = [mesh for mesh in scene.meshes if isinstance(mesh, PlacedMesh)]
    if sum(map(len, placed)) < MANY:
        return False
    materials = _settling(scene.meshes)
    placed = [mesh for mesh in placed if mesh.material not in materials]
    different = {id(mesh.source): len(mesh) + BEGINNING for mesh in placed}
    total = sum(map(len, placed))
    return total >= MANY and total >= 2 * sum(different.values())


def _settling(meshes: Sequence[Mesh]) -> set[AnyMaterial]:
    """Return the materials whose meshes are settled: those that shine, since rays aim at them, and glass."""
    return {material for material in {mesh.material for mesh in meshes} if settles(material)}


def settles(material: AnyMaterial) -> bool:
    """Return whether meshes of a material that stand at several places get triangles of their own."""
    decided = frozenset() if material.surface is None else examine_surface(material.surface).gives
    return any(material.glow) or material.is_clear or not decided.isdisjoint(("emission", "transmission"))


def _key(mesh: PlacedMesh) -> Any:
    """Return what meshes share whose triangles are the same; the colours of a table have the material's in them."""
    source = mesh.source
    arrays = tuple(id(array) for array in (source.vertices, source.faces, source.normals, source.colors, source.uv))
    return arrays, None if source.colors is None else mesh.material
