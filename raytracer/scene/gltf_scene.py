"""The scene of a glTF or GLB file: meshes in their places, materials, the camera and lights.

Stage: scene description. Takes a `gltf.Document`; section numbers are those of glTF 2.0. What the file holds beyond
that is counted in `Notices`.

    scene = GltfScene(Document(data, folder), "chair", notices)
    scene.instances(), scene.cameras(low, high), scene.lights(middle)
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.materials import PLAIN
from raytracer.appearance.metallic_roughness import AnyMaterial
from raytracer.arrays import is_whole
from raytracer.errors import SceneError
from raytracer.memory import INSTANCE, OutOfMemory, check_triangles
from raytracer.meshes.appearance import CLAY, restored
from raytracer.meshes.folder import BadEntry, Fault, Notices, named, shown
from raytracer.meshes.gltf import BROKEN, Document, needed, reason_of, rows, table
from raytracer.meshes.gltf_deformation import Deformation, deformation_of, skin_of
from raytracer.meshes.gltf_materials import GltfMaterials
from raytracer.meshes.mesh import Instance, Mesh
from raytracer.scene.framing import triple
from raytracer.scene.gltf_cameras import NamedCamera, camera_of
from raytracer.scene.gltf_lights import light_of
from raytracer.scene.gltf_nodes import NODE, Matrix, Node, Pose, local_matrix, nodes_of, place_of
from raytracer.scene.lights import PlacedLight

Indices = NDArray[np.int64]
_LIGHTS: Final = "KHR_lights_punctual"
_MORPHED: Final = {"POSITION", "NORMAL", "TANGENT"}
_VARIANTS: Final = "KHR_materials_variants"
_INSTANCING: Final = "EXT_mesh_gpu_instancing"
_PRIMITIVE: Final = Fault("primitive cannot be read", "primitives cannot be read")
_CAMERA: Final = Fault("camera cannot be read", "cameras cannot be read")
_LIGHT: Final = Fault("light cannot be read", "lights cannot be read")
_MATERIAL: Final = Fault("material cannot be read", "materials cannot be read")
_SHAPE: Final = Fault("primitive is not deformed", "primitives are not deformed")
_SKIN: Final = Fault("node has a skin that cannot be read", "nodes have skins that cannot be read")
_CUT: Final = Fault("primitive ends within a triangle", "primitives end within a triangle")
_NO_VERTEX: Final = Fault("triangle names a vertex that is not there", "triangles name a vertex that is not there")
_NO_PLACE: Final = Fault("triangle has a corner at no finite place", "triangles have a corner at no finite place")
_ATTRIBUTES: Final = {
    "NORM": Fault("primitive has normals that cannot be read", "primitives have normals that cannot be read"),
    "TEXC": Fault(
        "primitive has uv coordinates that cannot be read", "primitives have uv coordinates that cannot be read"
    ),
    "COLO": Fault("primitive has colours that cannot be read", "primitives have colours that cannot be read"),
}


class _Part(NamedTuple):
    """A primitive as a mesh, and what deforms it."""

    mesh: Mesh
    deformation: Deformation | None


class GltfScene:
    """The default scene of a document; parts without a name are called `name`.

    Animations count as ignored unless it is `animated`: `posed` then gives the scene at a time. A bad entry is left
    out, and counted in the `notices`. `variant` is the name of one of the `variants`, of which each gives some
    primitives other materials (KHR_materials_variants); BadEntry for another name. `multiscatter`
    is that of `Scene.load`.
    """

    def __init__(
        self,
        document: Document,
        name: str,
        notices: Notices,
        *,
        materials: bool = True,
        animated: bool = False,
        variant: str | None = None,
        multiscatter: bool = False,
    ) -> None:
        self.document, self.name, self.notices = document, name, notices
        self._left_out: set[tuple[Fault, str]] = set()
        if notices.strict and materials:
            document.check_extensions()
        self.nodes = list(nodes_of(document, self._entry))
        self.materials = GltfMaterials(document, notices)
        self.reads_materials = materials
        self.variants = [str(each.get("name")) for each in rows(_extension(document.tree, _VARIANTS), "variants")]
        self._variant, self._multiscatter = self._number_of(variant), multiscatter
        self._meshes: dict[int, list[_Part]] = {}
        self._deformed: dict[tuple[int, int], tuple[bytes, Mesh]] = {}
        self._built = self._placed = 0
        if not animated:
            notices.ignore("animations", len(document.all("animations")))
        others = "scenes but the default one" if "scene" in document.tree else "scenes after the first"
        notices.ignore(others, max(0, len(document.all("scenes")) - 1))
        for extension in document.unread if materials else ():
            notices.ignore(extension)

    def _number_of(self, variant: str | None) -> int | None:
        """Return the number of a variant, None without one; BadEntry for a name that none has."""
        if variant is None:
            return None
        if variant not in self.variants:
            listed = f"its variants are {named(self.variants)}" if self.variants else "it has none"
            raise BadEntry(f"the file has no variant {shown(variant)!r}: {listed}")
        return self.variants.index(variant)

    @contextmanager
    def _entry(self, fault: Fault, where: str) -> Iterator[None]:
        """Leave out an entry that cannot be read, once for all poses of the scene."""
        try:
            yield
        except (BadEntry, OutOfMemory):
            raise
        except BROKEN as error:
            if (fault, where) not in self._left_out:
                self._left_out.add((fault, where))
                reason = reason_of(error)
                self.notices.leave_out(fault, 1, where if self.notices.strict else f"{where}: {reason}", reason)

    def posed(self, pose: Pose) -> GltfScene:
        """Return the scene with other places of its nodes; it shares the meshes, which are made once."""
        scene = copy.copy(self)
        scene.nodes, scene._placed = list(nodes_of(self.document, self._entry, pose)), 0
        return scene

    def instances(self) -> list[Instance]:
        """Return the parts of the scene: of a mesh with several primitives, each is one: chair, chair_1, ..."""
        instances: list[Instance] = []
        matrices = {node.number: node.matrix for node in self.nodes}
        for node in self.nodes:
            if "mesh" not in node.entry:
                continue
            parts: list[Instance] = []
            where = ("mesh", node.entry["mesh"]) if node.number < 0 else ("node", node.number)
            with self._entry(NODE, place_of(*where)):
                parts = list(self._instances_of(node, matrices))
            self._placed += len(parts)
            check_triangles(self._built + INSTANCE * self._placed)
            instances += parts
        return instances

    def _instances_of(self, node: Node, matrices: Mapping[int, Matrix]) -> Iterator[Instance]:
        """Yield the parts of a node's mesh in their places; one whose skin is bad is not deformed."""
        mesh = self.document.one("meshes", node.entry["mesh"])
        name = str(node.entry.get("name") or mesh.get("name") or self.name)
        places = [node.matrix @ place for place in self._places(node)]
        amounts = [float(amount) for amount in node.entry.get("weights", mesh.get("weights", ()))]
        joints: Matrix | None = None
        with self._entry(_SKIN, place_of("node", node.number)):
            joints = self._joints(node, matrices)
        for k, (part, deformation) in enumerate(self._parts(node.entry["mesh"], mesh)):
            placed = places
            if deformation is not None:
                skinned = deformation.joints is not None and joints is not None
                with self._entry(_SHAPE, f"primitive {k} of node {node.number}"):
                    part = self._in_shape((node.number, k), deformation, amounts, joints if skinned else None)
                placed = [np.eye(4)] if skinned else places  # joints place it: section 3.7.3.3
            check_triangles(self._built + INSTANCE * (self._placed + len(placed)))
            called = f"{name}_{k}" if k else name
            yield from (Instance(part, place, called) for place in placed)

    def _joints(self, node: Node, matrices: Mapping[int, Matrix]) -> Matrix | None:
        """Return the matrices (J, 4, 4) by which the joints of a node's skin move a mesh; None if it has no skin."""
        if "skin" not in node.entry:
            return None
        skin = skin_of(self.document, node.entry["skin"])
        if not set(skin.joints) <= matrices.keys():
            raise SceneError("the joints of its skin are no nodes of the scene")
        return np.stack([matrices[joint] for joint in skin.joints]) @ skin.inverse

    def _in_shape(
        self, key: tuple[int, int], deformation: Deformation, amounts: Sequence[float], joints: Matrix | None
    ) -> Mesh:
        """Return a deformed mesh: the one of the last pose where it has the same shape."""
        if joints is None and not any(amounts):
            return deformation.mesh
        decisive = np.array(amounts).tobytes() + (b"" if joints is None else joints.tobytes())
        shape, mesh = self._deformed.get(key, (b"", deformation.mesh))
        if shape != decisive:
            mesh = deformation.deformed(amounts, joints)
            self._deformed[key] = decisive, mesh
        return mesh

    def _places(self, node: Node) -> list[Matrix]:
        """Return the matrices (4, 4) of a node's mesh: several with EXT_mesh_gpu_instancing, else the identity."""
        attributes = table(_extension(node.entry, _INSTANCING), "attributes")
        kinds = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        rows = {key: self.document.array(attributes[name]) for name, key in kinds.items() if name in attributes}
        if not rows:
            return [np.eye(4)]
        if len({len(values) for values in rows.values()}) > 1:
            raise SceneError(f"the attributes of {_INSTANCING} are of several lengths")
        check_triangles(INSTANCE * len(next(iter(rows.values()))))
        lists = {key: values.tolist() for key, values in rows.items()}
        return [local_matrix(dict(zip(lists, row, strict=True))) for row in zip(*lists.values(), strict=True)]

    def cameras(self, low: Matrix, high: Matrix) -> list[NamedCamera]:
        """Return the cameras with their names, aimed as far away as the middle of the box from `low` to `high`.

        A camera is named after its node, or else after itself, or `camera` and its number.
        """
        cameras: list[NamedCamera] = []
        for node in self.nodes:
            if "camera" not in node.entry:
                continue
            with self._entry(_CAMERA, place_of("node", node.number)):
                entry = self.document.one("cameras", node.entry["camera"])
                camera = camera_of(entry, node.matrix, (low + high) / 2)
                name = node.entry.get("name") or entry.get("name") or f"camera {len(cameras)}"
                if camera is None:
                    self.notices.ignore("cameras that a scale of 0 leaves without a direction")
                else:
                    cameras.append((str(name), camera))
        return cameras

    def lights(self, middle: Matrix) -> list[PlacedLight]:
        """Return the lights of KHR_lights_punctual, scaled together: a surface at `middle` that all shine on gets 1.

        Points and spots fall off by the square of the distance. A file gives lights in lux and candela, for an exposure
        that it does not give.
        """
        pairs: list[tuple[PlacedLight, float]] = []
        for node in self.nodes:
            with self._entry(_LIGHT, place_of("node", node.number)):
                number = _extension(node.entry, _LIGHTS).get("light")
                if number is not None:
                    pair = light_of(self._light_entry(number), node.matrix, middle, self.notices)
                    pairs += [] if pair is None else [pair]
        colors = [np.asarray(light.color) for light, _ in pairs]
        most = float(sum((c * share for c, (_, share) in zip(colors, pairs, strict=True)), np.zeros(3)).max())
        lights = zip(colors, pairs, strict=True)
        return [replace(light, color=triple(c / most)) for c, (light, _) in lights] if most > 0 else []

    def _light_entry(self, number: Any) -> dict[str, Any]:
        entries = rows(_extension(self.document.tree, _LIGHTS), "lights")
        if not (is_whole(number, 0, len(entries) - 1) and isinstance(entries[number], dict)):
            raise SceneError(f"it names light {shown(str(number))}, and there are {len(entries)}")
        entry: dict[str, Any] = entries[number]
        return entry

    def _parts(self, number: int, entry: dict[str, Any]) -> list[_Part]:
        if number not in self._meshes:
            parts = []
            needed(entry, "primitives")
            for k, primitive in enumerate(rows(entry, "primitives")):
                part: _Part | None = None
                where = f"primitive {k} of mesh {number}"
                with self._entry(_PRIMITIVE, where):
                    part = self._primitive(table({"primitive": primitive}, "primitive"), where)
                if part is not None:
                    self._built += len(part.mesh)
                    check_triangles(self._built)
                    parts.append(part)
            self._meshes[number] = parts
        return self._meshes[number]

    def _primitive(self, primitive: dict[str, Any], where: str) -> _Part | None:
        """Return a primitive as a mesh, with what deforms it; None where it has nothing that is seen."""
        mode = primitive.get("mode", 4)
        if mode not in (4, 5, 6):
            self.notices.ignore("points and lines")
            return None
        targets = [table({"target": target}, "target") for target in rows(primitive, "targets")]
        self.notices.ignore("morph targets of colours or uv", sum(bool(t.keys() - _MORPHED) for t in targets))
        attributes, look = table(primitive, "attributes"), self._look(primitive)
        vertices = self._positions(primitive, attributes)
        order = self._order(primitive, len(vertices))
        uv_name = f"TEXCOORD_{self.materials.uv_set(look)}"
        normals, uv, colors = (
            self._attribute(attributes, name, widths, len(vertices), where)
            for name, widths in (("NORMAL", (3,)), (uv_name, (2,)), ("COLOR_0", (3, 4)))
        )
        if colors is not None and self.materials.uses_alpha(look) and (colors[:, 3:] < 1).any():
            self.notices.ignore("alpha of vertex colours")
        if look is not None and self.reads_materials and self.materials.is_cut_out(look):
            self.notices.ignore("primitives of which a mask leaves nothing")
            return None
        if mode == 4 and len(order) % 3:
            self.notices.leave_out(_CUT, 1, where, f"it has {len(order):,} corners, and a triangle takes 3")
        faces, vertices = self._sound(_faces(order, mode), vertices, where)
        kept: Any = slice(None)
        if faces.size < len(vertices):  # others may share the array: a copy of all for each would be quadratic
            kept, faces = np.unique(faces, return_inverse=True)
            faces = faces.reshape(-1, 3)
            vertices = vertices[kept]
            normals, uv, colors = (None if values is None else values[kept] for values in (normals, uv, colors))
        mesh = Mesh(
            vertices,
            faces,
            normals,
            None if colors is None else colors[:, :3],
            self._material(look, uv is not None, colors is not None),
            self.name,
            None if uv is None else self.materials.placed(look, uv) * (1, -1) + (0, 1),  # v runs down in glTF, up here
        )
        deformation: Deformation | None = None
        with self._entry(_SHAPE, where):
            deformation = deformation_of(self.document, primitive, mesh, normals, kept)
        return _Part(mesh, deformation)

    def _positions(self, primitive: dict[str, Any], attributes: dict[str, Any]) -> NDArray[Any]:
        """Return the places of the vertices (V, 3) of a primitive."""
        number = needed(attributes, "POSITION")
        try:
            if not self.document.has_bytes(number):
                raise SceneError("its positions have no bytes")
            vertices = self.document.array(number)
        except SceneError as error:
            extension = self.document.compression_of(primitive, number)
            raise (_compressed(extension) if extension else error) from error
        if vertices.shape[1] != 3:
            raise SceneError(f"its positions have {vertices.shape[1]} numbers each, not 3")
        return vertices

    def _order(self, primitive: dict[str, Any], count: int) -> Indices:
        """Return the numbers of the vertices of a primitive in the order of its triangles."""
        if "indices" not in primitive:
            return np.arange(count)
        indices = self.document.array(primitive["indices"])
        if indices.shape[1] != 1 or indices.dtype.kind not in "iu":
            raise SceneError("its indices are not one whole number each")
        return indices[:, 0].astype(np.int64)

    def _attribute(
        self, attributes: dict[str, Any], name: str, widths: Sequence[int], count: int, where: str
    ) -> NDArray[Any] | None:
        """Return the numbers of the vertices of a primitive by the name of the attribute; None without good ones."""
        if name not in attributes:
            return None
        attribute: NDArray[Any] | None = None
        with self._entry(_ATTRIBUTES[name[:4]], where):
            values = self.document.array(attributes[name])
            if values.shape[1] not in widths or len(values) != count:
                raise SceneError(f"its {name} has {values.shape} numbers, and it has {count:,} vertices")
            if not np.isfinite(values).all():
                raise SceneError(f"its {name} has a number that is not finite, that of vertex {_first_bad(values)}")
            attribute = values
        return attribute

    def _sound(self, faces: Indices, vertices: NDArray[Any], where: str) -> tuple[Indices, NDArray[Any]]:
        """Return the triangles whose corners are vertices at finite places, and the vertices, all of them finite."""
        there = ((faces >= 0) & (faces < len(vertices))).all(axis=1)
        if not there.all():
            wrong = faces[~there]
            number = int(wrong[(wrong < 0) | (wrong >= len(vertices))][0])
            cause = f"a triangle names vertex {number:,}, and there are {len(vertices):,}"
            self.notices.leave_out(_NO_VERTEX, len(wrong), where, cause)
            faces = faces[there]
        finite = np.isfinite(vertices).all(axis=1)
        if finite.all():
            return faces, vertices
        sound = finite[faces].all(axis=1)
        cause = f"vertex {_first_bad(vertices)} has no finite place"
        self.notices.leave_out(_NO_PLACE, int((~sound).sum()), where, cause)
        return faces[sound], np.where(finite[:, None], vertices, 0)

    def _look(self, primitive: dict[str, Any]) -> int | None:
        """Return the number of the material of a primitive; None without one that can be read."""
        number = primitive.get("material")
        for mapping in rows(_extension(primitive, _VARIANTS), "mappings"):
            if self._variant is not None and self._variant in rows(mapping, "variants"):
                number = mapping.get("material")
        if number is None:
            return None
        material: int | None = None
        with self._entry(_MATERIAL, place_of("material", number)):
            self.materials.uv_set(number)
            self.materials.is_cut_out(number)
            material = number
        return material

    def _material(self, number: int | None, has_uv: bool, has_colors: bool) -> AnyMaterial:
        """Return the material of this number, or a plain one without one that can be read."""
        material: AnyMaterial = PLAIN if has_colors else CLAY
        if number is not None and self.reads_materials:
            with self._entry(_MATERIAL, place_of("material", number)):
                material = self.materials.get(number, has_uv)
        return restored(material) if self._multiscatter else material


def _extension(entry: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return an extension of an entry; {} where it is not used."""
    return table(table(entry, "extensions"), name)


def _compressed(extension: str) -> SceneError:
    return SceneError(f"its positions are in {extension}, which is not read: export it without")


def _first_bad(values: NDArray[Any]) -> int:
    """Return the number of the first row with a number that is not finite."""
    return int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])


def _faces(order: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return the triangles (F, 3) of a list (mode 4), strip (5) or fan (6) of vertices (section 3.7.2.1)."""
    if mode == 4:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    k = np.arange(max(0, len(order) - 2))
    if mode == 5:
        return np.stack([order[k], order[k + 1 + k % 2], order[k + 2 - k % 2]], axis=1)
    return np.stack([order[k + 1], order[k + 2], order[0 * k]], axis=1)
