"""A scene as the arrays that the kernels read: triangles, normals, colours, materials, lights.

Stage: layout. Takes a `Scene`, gives a `Layout` in f64, which tables round to a kernel's working precision. Features
that no mesh uses are left out, and `kernels.tracer` records no code for them.

>>> from raytracer import Scene
>>> Layout.of(Scene.builtin("boxes")).triangles.shape
(108, 4)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.bvh import Bvh
from raytracer.accel.choice import INSTANCES, build
from raytracer.accel.forest import Forest, still_of
from raytracer.accel.grid import Grid, build_part
from raytracer.accel.planes import copy_columns
from raytracer.accel.shape import Shape
from raytracer.accel.space import WORKING, Rows, frame_of, rounded, to_kernel, triangle_rows
from raytracer.accel.two_levels import TwoLevels
from raytracer.appearance.metallic_roughness import AnyMaterial, MetallicRoughness
from raytracer.appearance.textures import Texture
from raytracer.errors import SceneError
from raytracer.layered.cube import LayeredCube
from raytracer.layered.placed import PlacedCubes
from raytracer.meshes import Mesh
from raytracer.meshes.mesh import check_expansion, unplaced
from raytracer.scene.instanced import Instanced, Parts, settles
from raytracer.scene.light_tables import cone_rows, kinds_of, light_rows
from raytracer.scene.scene import Scene


class Change(NamedTuple):
    """The triangles `first` to `past` - 1 in another `shape`; `stale` names the other tables of which rows changed."""

    first: int
    past: int
    shape: Shape
    stale: frozenset[str]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The tables of a scene of N triangles, M materials and L lights.

    All positions are relative to `origin` (3,), and multiplied by `scale`, a power of two. `structure` is the
    accelerator, `dtype` the working precision of the kernels, `roundoff` its largest relative error of one rounding.

    `triangles` (3N, 4), see `triangle_rows`; `normals` (3N, 4) the normals at the corners, None if every mesh is flat;
    `colors` (3N, 4) the colours at the corners, those of the materials included unless a texture or program makes
    colours (`is_programmed`), None if no mesh has any. `material_of` and `object_of` (N,) int32 are a triangle's
    material and mesh. `material_rows` (2M, 4): color and reflectivity, then diffuse, specular, shininess. `lights`
    (2L, 4): position and 1, or direction toward the light and 0, then color, and 1 where it falls off by the square of
    the distance. `cones` (2L, 4) are the direction of a spot and 1 / its range, 0 for no end, then the numbers of its
    `ramp`; None where no light has a cone or a range.

    `without_uv` (M,) is the name of a mesh of each of the `materials` that has no uv coordinates, or ""; `uvs` (3N, 2)
    the uv coordinates at the corners, None if no material has textures or programs.

    `secondary` is the cube that all rays but those from the eye go through, or the cubes of objects that move; None
    where they go through `structure`.

    `forest` is the hierarchy of moving objects, of which `structure` is the joined one, or beside which `structure` is
    the grid of the other triangles; None if none moves. Where one does, rows are held in the working precision.

    `instanced` are the instances of a layout in two levels, which are its `structure`: then `triangles` and the other
    tables hold distinct triangles alone, each part's in coordinates of its own. None for other layouts.
    """

    origin: NDArray[np.float64]
    scale: float
    structure: Grid | Bvh | TwoLevels
    dtype: np.dtype[Any]
    triangles: Rows
    normals: Rows | None
    colors: Rows | None
    material_rows: Rows
    material_of: NDArray[np.int32]
    object_of: NDArray[np.int32]
    lights: Rows
    materials: tuple[AnyMaterial, ...] = ()
    without_uv: tuple[str, ...] = ()
    uvs: Rows | None = None
    secondary: LayeredCube | PlacedCubes | None = None
    forest: Forest | None = None
    cones: Rows | None = None
    instanced: Instanced | None = None

    @classmethod
    def of(
        cls,
        scene: Scene,
        accel: str = "bvh",
        precision: str = "f32",
        across: int | None = None,
        moving: Sequence[int] = (),
        backend: str = "numpy",
    ) -> Layout:
        """Return the layout of a scene of at least one triangle, for kernels that work at `precision`; see `build`.

        `moving` are the numbers of the meshes that `put` may replace, where the accelerator is a hierarchy or a grid.
        """
        if accel == INSTANCES:
            return cls._in_two_levels(scene, backend)
        meshes = [mesh for mesh in scene.meshes if len(mesh)]
        check_expansion(scene.name, meshes)
        corners = np.concatenate([mesh.corners for mesh in meshes])
        corners, origin, scale = to_kernel(corners, precision)
        materials, index = _materials(meshes)
        sizes = [len(mesh) for mesh in meshes]
        places = [k for k, mesh in enumerate(scene.meshes) if len(mesh)]
        object_of = np.repeat(places, sizes).astype(np.int32)
        ranges = [_range(object_of, number) for number in moving]
        dtype = np.dtype(WORKING.get(precision, np.float32))
        check_range(scene, materials)
        forest = Forest(corners, ranges, dtype, backend, static=accel != "grid") if moving else None
        structure: Grid | Bvh
        if forest is not None:
            is_grid = accel == "grid"
            structure = build_part(corners, still_of(len(corners), ranges), across) if is_grid else forest.bvh
        else:
            structure = build(accel, corners, precision, across, backend)
        layout = cls(
            structure=structure,
            material_of=np.repeat(index, sizes).astype(np.int32),
            object_of=object_of,
            without_uv=_without_uv(meshes, index, len(materials)),
            forest=forest,
            **_tables(scene, corners, meshes, (origin, scale), dtype, materials),
        )
        return layout if forest is None else layout.in_working_precision()

    @classmethod
    def _in_two_levels(cls, scene: Scene, backend: str) -> Layout:
        """Return the layout of a scene whose instances share their triangles, for kernels that work at f32."""
        parts = Parts.of(scene)
        materials, index = _materials(scene.meshes)
        check_range(scene, materials)
        bounds = scene.bounds
        origin, scale = frame_of(*bounds, "f32")
        settled = [scene.meshes[number] for number in parts.settled]
        check_expansion(scene.name, settled)
        corners = np.concatenate([np.zeros((0, 3, 3)), *(mesh.corners for mesh in settled)])
        corners, box = (rounded((places - origin) * scale, "f32") for places in (corners, np.stack(bounds)))
        corners, instanced = parts.placed(corners, box, origin, scale, backend, index)
        meshes, sizes = parts.meshes, list(map(len, settled))
        own = np.zeros((2, len(corners)), np.int32)
        own[0, : sum(sizes)] = np.repeat([index[number] for number in parts.settled], sizes)
        own[1, : sum(sizes)] = np.repeat(parts.settled, sizes)
        return cls(
            structure=instanced.levels,
            material_of=own[0],
            object_of=own[1],
            without_uv=_without_uv(list(map(unplaced, scene.meshes)), index, len(materials)),
            instanced=instanced,
            **_tables(scene, corners, meshes, (origin, scale), np.dtype(np.float32), materials),
        )

    @property
    def features(self) -> dict[str, bool | int]:
        """The features of a picture that decide how rays find triangles."""
        features: dict[str, bool | int] = {}
        if self.secondary is not None:
            features["layered cube"] = self.secondary.options["resolution"]
        if self.instanced is not None:
            features["instances"] = len(self.instanced.meshes)
        return features

    @property
    def settled(self) -> int:
        """The number of triangles, the first ones, whose rows are in the scene's coordinates."""
        return len(self.material_of) if self.instanced is None else self.instanced.settled

    @property
    def box(self) -> tuple[Rows, Rows]:
        """The corners of the box round all triangles, in the kernel's coordinates."""
        if self.instanced is not None:
            return self.instanced.box[0], self.instanced.box[1]
        # Each column by itself: a twentieth of the time, which every frame of objects that move takes.
        columns = [self.triangles[:, axis] for axis in range(3)]
        low, high = (np.array([end(column) for column in columns], np.float64) for end in (np.min, np.max))
        return low, high

    def in_working_precision(self) -> Layout:
        """Return the layout with rows in the form of tables: rows of objects that move are computed often."""
        normals, colors, uvs = (
            None if rows is None else self.table_rows(rows) for rows in (self.normals, self.colors, self.uvs)
        )
        return replace(self, triangles=self.table_rows(self.triangles), normals=normals, colors=colors, uvs=uvs)

    def exact(self, scene: Scene) -> Layout:
        """Return the layout of the scene as it would be if nothing moved in it, but for its accelerator."""
        meshes = [mesh for mesh in scene.meshes if len(mesh)]
        corners = self.triangles[:, :3].astype(np.float64).reshape(-1, 3, 3)
        uvs = None if self.uvs is None else uv_rows(meshes)
        return replace(
            self,
            triangles=triangle_rows(corners),
            normals=normal_rows(meshes),
            colors=_colors(meshes, self.materials),
            uvs=uvs,
        )

    def put(self, moving: Sequence[int], meshes: Mapping[int, tuple[Mesh, Mesh]], precision: str) -> list[Change]:
        """Take meshes, of as many triangles, in the place of those of these numbers, all of them in `moving`.

        Each comes with the mesh that was in its place. Return what changed. The origin and the scale stay.
        """
        assert self.forest is not None
        self.forest.stale_items.clear()  # left from an interrupted attempt
        changes, places = [], {number: place for place, number in enumerate(moving)}
        for number, (mesh, before) in meshes.items():
            first, past = _range(self.object_of, number)
            vertices = rounded((mesh.vertices - self.origin) * self.scale, precision)
            rows = slice(3 * first, 3 * past)
            place = places[number]
            shape = self.forest.shapes[place]
            shape.take(vertices, mesh.faces, self.triangles[rows])
            stale = set()
            if self.normals is not None:
                copy_columns(self.normals[rows], _corner_normals(mesh).reshape(-1, 3))
                stale.add("normals")
            if self.colors is not None and mesh.colors is not before.colors:
                copy_columns(self.colors[rows], _corner_colors(mesh, self.materials).reshape(-1, 3))
                stale.add("colors")
            if self.uvs is not None and mesh.uv is not before.uv:
                copy_columns(self.uvs[rows], uv_rows([mesh]))
                stale.add("uvs")
            self.forest.change(place)
            changes.append(Change(first, past, shape, frozenset(stale)))
        self.forest.join()
        return changes

    def placed(self, transforms: Mapping[int, Rows], bounds: Rows) -> Layout | None:
        """Return a layout in two levels after meshes of these numbers have moved; None where one is no instance.

        `bounds` (2, 3) are those of the scene after it. The origin and the scale stay.
        """
        assert self.instanced is not None
        box = rounded((bounds - self.origin) * self.scale, "f32")
        instanced = self.instanced.moved(transforms, box, self.origin, self.scale)
        return None if instanced is None else replace(self, structure=instanced.levels, instanced=instanced)

    def table_rows(self, rows: Rows) -> NDArray[Any]:
        """Return rows as a table holds them: in binary32 where kernels work so, which takes half the memory.

        Raises SceneError for numbers that binary32 does not hold.
        """
        table = self._rounded(rows)
        if table is None:
            raise _out_of_range("a colour, a normal or a uv coordinate of the scene", np.abs(rows).max())
        return table

    def _rounded(self, rows: Rows) -> NDArray[Any] | None:
        """Return rows as a table holds them; None for numbers that binary32 does not hold."""
        if self.dtype != np.float32:
            return rows
        try:
            with np.errstate(over="raise"):
                return rows.astype(np.float32, copy=False)
        except FloatingPointError:
            return None

    @property
    def roundoff(self) -> float:
        """The largest relative error of one rounding."""
        return float(np.finfo(self.dtype).eps) / 2

    def painted(self, scene: Scene) -> tuple[Layout, list[tuple[int, int]]] | None:
        """Return the layout of a scene that differs from this one's in numbers of its materials and lights alone.

        The meshes are as many, of as many triangles. The layout comes with the ranges of triangles (first, past) whose
        rows of `colors` differ. Return None for other textures, programs or kinds of lights, for meshes that share
        their materials otherwise, and for colours that the working precision cannot hold. In two levels also for meshes
        that come to shine or to be clear, or no longer do, and for tinted colours at corners.
        """
        places = [place for place, mesh in enumerate(scene.meshes) if len(mesh)]
        meshes = [scene.meshes[place] for place in places]
        materials, index = _materials(meshes if self.instanced is None else scene.meshes)
        if self.instanced is None:
            ranges = [_range(self.object_of, place) for place in places]
            before = self.material_of[[first for first, _ in ranges]]
        else:
            index, ranges = [index[place] for place in places], []
            before = self.instanced.materials_of(self.object_of, self.material_of)[places]
        if not np.array_equal(index, before) or not all(map(_differ_in_numbers, materials, self.materials)):
            return None
        if self.instanced is not None and list(map(settles, materials)) != list(map(settles, self.materials)):
            return None
        check_range(scene, materials)
        lights = light_rows(scene.placed_lights, self.origin, self.scale, self.dtype)
        cones = cone_rows(scene.placed_lights, self.scale)
        if kinds_of(lights) != kinds_of(self.lights) or (cones is None) != (self.cones is None):
            return None
        layout = replace(self, lights=lights, cones=cones, materials=materials, material_rows=_material_rows(materials))
        tinted = [
            number for number, material in enumerate(index) if materials[material].tint != self.materials[material].tint
        ]
        if self.colors is None or not tinted or any(map(is_programmed, materials)):
            return layout, []
        if self.instanced is not None:
            return None
        colors = self.colors.copy()
        for number in tinted:
            first, past = ranges[number]
            copy_columns(colors[3 * first : 3 * past], _corner_colors(meshes[number], materials).reshape(-1, 3))
        if self._rounded(colors) is None:
            return None
        return replace(layout, colors=colors), [ranges[number] for number in tinted]

    @property
    def glass(self) -> Rows:
        """(2M, 4): the transmission and refractive index of each material, then its absorption.

        The third number is 1 for the body of a `MetallicRoughness`.
        """
        rows = [[(m.numbers["transmission"], m.clear_ior, _is_body(m), 0), (*m.absorption, 0)] for m in self.materials]
        return np.array(rows, dtype=np.float64).reshape(-1, 4)

    @property
    def layers(self) -> Rows:
        """(2M, 4): the layers of each `MetallicRoughness`, whose last number is 1 or 2; 0 for other materials."""
        none = (0.0,) * 4
        rows = [m.layers if isinstance(m, MetallicRoughness) else (none, none) for m in self.materials]
        return np.array(rows, dtype=np.float64).reshape(-1, 4)

    @property
    def sheens(self) -> Rows:
        """(M, 4): the colour and the roughness of the sheen of each `MetallicRoughness`; 0 for other materials."""
        rows = [m.sheen if isinstance(m, MetallicRoughness) else (0.0,) * 4 for m in self.materials]
        return np.array(rows, dtype=np.float64).reshape(-1, 4)

    @property
    def brushes(self) -> Rows:
        """(M, 2): the anisotropy of each `MetallicRoughness` and its rotation in degrees; 0 for other materials."""
        rows = [m.brush if isinstance(m, MetallicRoughness) else (0.0, 0.0) for m in self.materials]
        return np.array(rows, dtype=np.float64).reshape(-1, 2)

    @property
    def mirrors(self) -> Rows:
        """(M, 4): the reflectivity of each material as a colour, then 0."""
        return np.array([(*material.mirror, 0.0) for material in self.materials], dtype=np.float64).reshape(-1, 4)


def _tables(
    scene: Scene,
    corners: Rows,
    meshes: Sequence[Mesh],
    frame: tuple[Rows, float],
    dtype: np.dtype[Any],
    materials: tuple[AnyMaterial, ...],
) -> dict[str, Any]:
    """Return the tables of corners in a frame, of their meshes, and of the materials and lights of a scene."""
    origin, scale = frame
    return {
        "origin": origin,
        "scale": scale,
        "dtype": dtype,
        "triangles": triangle_rows(corners),
        "normals": normal_rows(meshes),
        "colors": _colors(meshes, materials),
        "material_rows": _material_rows(materials),
        "materials": materials,
        "lights": light_rows(scene.placed_lights, origin, scale, dtype),
        "cones": cone_rows(scene.placed_lights, scale),
        "uvs": uv_rows(meshes) if any(map(_may_read_uv, materials)) else None,
    }


def check_range(scene: Scene, materials: Sequence[AnyMaterial]) -> None:
    """Raise SceneError for a number of a material, a light or the background that a pixel, in binary32, cannot hold."""
    entries: list[tuple[str, Any]] = [
        ("the background", scene.background),
        *(("a light's color", light.color) for light in scene.lights),
    ]
    for material in materials:
        numbers = [*material.numbers.values(), material.clear_ior, *material.absorption]
        if isinstance(material, MetallicRoughness):
            numbers += material.layers[0]
        entries += [("a number of a material", numbers), ("a colour of a material", material.tint)]
        entries.append(("the emission of a material", material.emission))
    for what, value in entries:
        plain = value is not None and not (isinstance(value, Texture) or callable(value))
        largest = float(np.abs(value).max()) if plain else 0.0
        if largest > float(np.finfo(np.float32).max):
            raise _out_of_range(what, largest)


def _out_of_range(what: str, number: float) -> SceneError:
    return SceneError(f"{what} is {number:.3g}, out of the range of binary32: choose smaller numbers")


def _range(object_of: NDArray[np.int32], number: int) -> tuple[int, int]:
    """Return the range (first, past) of the triangles of a mesh."""
    first, past = np.searchsorted(object_of, [number, number + 1])
    return int(first), int(past)


def _materials(meshes: Sequence[Mesh]) -> tuple[tuple[AnyMaterial, ...], list[int]]:
    """Return the distinct materials, and for each mesh the index of its material."""
    numbers: dict[AnyMaterial, int] = {}
    index = [numbers.setdefault(mesh.material, len(numbers)) for mesh in meshes]
    return tuple(numbers), index


def _differ_in_numbers(material: AnyMaterial, other: AnyMaterial) -> bool:
    """Return whether materials are of the same model and have the same textures and programs."""
    programs = material.surface is other.surface and material.shade is other.shade
    return type(material) is type(other) and programs and material.textures == other.textures


def _material_rows(materials: Sequence[AnyMaterial]) -> Rows:
    """Return the rows of materials; a coefficient that is a texture is 1 there."""
    rows = []
    for material in materials:
        x = material.numbers
        rows += [(*material.tint, x["reflectivity"]), (x["diffuse"], x["specular"], x["shininess"], 0.0)]
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def _without_uv(meshes: Sequence[Mesh], index: Sequence[int], count: int) -> tuple[str, ...]:
    """Return for each of `count` materials the name of its first mesh without uv coordinates, or "" without any."""
    names = [""] * count
    for mesh, number in zip(meshes, index, strict=True):
        if mesh.uv is None and not names[number]:
            names[number] = mesh.name or "a mesh"
    return tuple(names)


def normal_rows(meshes: Sequence[Mesh]) -> Rows | None:
    """Return the normals at the corners of all triangles, (3N, 4); None if every mesh is flat."""
    if all(mesh.normals is None for mesh in meshes):
        return None
    return _corner_rows(list(map(_corner_normals, meshes)))


def _corner_normals(mesh: Mesh) -> NDArray[np.float64]:
    """Return the normals at corners, (n, 3, 3): those of the faces for a flat mesh."""
    normals = np.repeat(mesh.face_normals[:, None], 3, axis=1) if mesh.normals is None else mesh.normals
    return np.asarray(normals)


def _colors(meshes: Sequence[Mesh], materials: Sequence[AnyMaterial]) -> Rows | None:
    if all(mesh.colors is None for mesh in meshes):
        return None
    return _corner_rows([_corner_colors(mesh, materials) for mesh in meshes])


def _corner_colors(mesh: Mesh, materials: Sequence[AnyMaterial]) -> NDArray[np.float64]:
    """Return the colours at corners, (n, 3, 3), with the material's unless any of the scene's is programmed."""
    own = np.ones((len(mesh), 3, 3)) if mesh.colors is None else mesh.colors
    return np.asarray(own if any(map(is_programmed, materials)) else own * mesh.material.tint)


def is_programmed(material: AnyMaterial) -> bool:
    """Return whether the kernel alone knows the colour of a material."""
    return material.surface is not None or "color" in material.textures


def _is_body(material: AnyMaterial) -> bool:
    """Return whether what is clear of a material is rough, and tinted by its colour."""
    return isinstance(material, MetallicRoughness) and material.is_body


def _may_read_uv(material: AnyMaterial) -> bool:
    """Return whether a material may need uv coordinates."""
    return bool(material.textures or material.surface or _is_brushed(material))


def _is_brushed(material: AnyMaterial) -> bool:
    """Return whether a material's microfacets need the direction in which u grows."""
    return isinstance(material, MetallicRoughness) and material.brush[0] > 0


def uv_rows(meshes: Sequence[Mesh]) -> Rows:
    """Return the uv coordinates at the corners of all triangles, (3N, 2), 0 where a mesh has none."""
    return np.concatenate([np.zeros((len(m), 3, 2)) if m.uv is None else m.uv for m in meshes]).reshape(-1, 2)


def _corner_rows(parts: Sequence[NDArray[np.float64]]) -> Rows:
    """Return rows (3N, 4) of the meshes' values at corners, (n, 3, 3) each, and a component of padding."""
    rows = np.concatenate(parts).reshape(-1, 3)
    return np.pad(rows, ((0, 0), (0, 1)))
