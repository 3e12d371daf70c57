"""The scene of a glTF or GLB file: meshes in their places, materials, the camera and lights.

Stage: scene description. Takes a `gltf.Document`; section numbers are those of glTF 2.0. What the file holds beyond
that is counted in `Notices`.

    scene = GltfScene(Document(data, folder), "chair", notices)
    scene.instances(), scene.camera(low, high), scene.lights(middle)
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.planes import unit
from raytracer.appearance.materials import PLAIN, Material
from raytracer.errors import SceneError
from raytracer.memory import check_triangles
from raytracer.meshes.appearance import CLAY
from raytracer.meshes.folder import Notices, shown
from raytracer.meshes.gltf import Document
from raytracer.meshes.gltf_deformation import Deformation, deformation_of, skin_of
from raytracer.meshes.gltf_materials import GltfMaterials
from raytracer.meshes.instance import Instance
from raytracer.meshes.mesh import Mesh
from raytracer.scene.camera import ALONG, Camera
from raytracer.scene.framing import triple
from raytracer.scene.lights import DirectionalLight, PlacedLight, PointLight

Matrix = NDArray[np.float64]
_LIGHTS: Final = "KHR_lights_punctual"
_PLACED: Final = {"matrix", "translation", "rotation", "scale"}
_MORPHED: Final = {"POSITION", "NORMAL", "TANGENT"}
_INSTANCING: Final = "EXT_mesh_gpu_instancing"
Pose = Mapping[int, Mapping[str, Any]]
"""The entries of nodes that an animation replaces, by the numbers of the nodes."""


class Node(NamedTuple):
    """A node of the scene, the matrix (4, 4) from its coordinates to the scene's, and its number, -1 without one."""

    entry: dict[str, Any]
    matrix: Matrix
    number: int = -1


class _Part(NamedTuple):
    """A primitive as a mesh, and what deforms it."""

    mesh: Mesh
    deformation: Deformation | None


class GltfScene:
    """The default scene of a document; parts without a name are called `name`.

    Animations count as ignored unless it is `animated`: `posed` then gives the scene at a time.
    """

    def __init__(
        self, document: Document, name: str, notices: Notices, *, materials: bool = True, animated: bool = False
    ) -> None:
        self.document, self.name, self.notices = document, name, notices
        self.nodes = list(_nodes(document))
        self.materials = GltfMaterials(document, notices)
        self.reads_materials = materials
        self._meshes: dict[int, list[_Part]] = {}
        self._deformed: dict[tuple[int, int], tuple[bytes, Mesh]] = {}
        self._built = self._placed = 0
        if not animated:
            notices.ignore("animations", len(document.all("animations")))
        notices.ignore("scenes after the first", max(0, len(document.all("scenes")) - 1))
        for extension in document.unread if materials else ():
            notices.ignore(extension)

    def posed(self, pose: Pose) -> GltfScene:
        """Return the scene with other places of its nodes; it shares the meshes, which are made once."""
        found = copy.copy(self)
        found.nodes, found._placed = list(_nodes(self.document, pose)), 0
        return found

    def instances(self) -> list[Instance]:
        """Return the parts of the scene: of a mesh with several primitives, each is one: chair, chair_1, ..."""
        found = []
        matrices = {node.number: node.matrix for node in self.nodes}
        for node in self.nodes:
            if "mesh" not in node.entry:
                continue
            mesh = self.document.one("meshes", node.entry["mesh"])
            name = str(node.entry.get("name") or mesh.get("name") or self.name)
            places = [node.matrix @ place for place in self._places(node)]
            amounts = [float(amount) for amount in node.entry.get("weights", mesh.get("weights", ()))]
            joints = self._joints(node, matrices)
            for k, (part, deformation) in enumerate(self._parts(node.entry["mesh"], mesh)):
                placed = places
                if deformation is not None:
                    skinned = deformation.joints is not None and joints is not None
                    part = self._in_shape((node.number, k), deformation, amounts, joints if skinned else None)
                    placed = [np.eye(4)] if skinned else places  # joints place it: section 3.7.3.3
                self._placed += len(part) * len(placed)
                check_triangles(self._placed)
                called = f"{name}_{k}" if k else name
                found += [Instance(part, place, called) for place in placed]
        return found

    def _joints(self, node: Node, matrices: Mapping[int, Matrix]) -> Matrix | None:
        """Return the matrices (J, 4, 4) by which the joints of a node's skin move a mesh; None if it has no skin."""
        if "skin" not in node.entry:
            return None
        skin = skin_of(self.document, node.entry["skin"])
        if not set(skin.joints) <= matrices.keys():
            raise SceneError("the joints of a skin are no nodes of the scene")
        return np.stack([matrices[joint] for joint in skin.joints]) @ skin.inverse

    def _in_shape(
        self, key: tuple[int, int], deformation: Deformation, amounts: Sequence[float], joints: Matrix | None
    ) -> Mesh:
        """Return a deformed mesh: the one of the last pose where it has the same shape."""
        if joints is None and not any(amounts):
            return deformation.mesh
        decisive = np.array(amounts).tobytes() + (b"" if joints is None else joints.tobytes())
        known, mesh = self._deformed.get(key, (b"", deformation.mesh))
        if known != decisive:
            mesh = deformation.deformed(amounts, joints)
            self._deformed[key] = decisive, mesh
        return mesh

    def _places(self, node: Node) -> list[Matrix]:
        """Return the matrices (4, 4) of a node's mesh: several with EXT_mesh_gpu_instancing, else the identity."""
        given = node.entry.get("extensions", {}).get(_INSTANCING, {}).get("attributes", {})
        kinds = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        rows = {key: self.document.array(given[name]) for name, key in kinds.items() if name in given}
        if not rows:
            return [np.eye(4)]
        if len({len(values) for values in rows.values()}) > 1:
            raise SceneError(f"the attributes of {_INSTANCING} are of several lengths")
        check_triangles(len(next(iter(rows.values()))))  # each instance has a triangle, and takes more than that
        return [_local(dict(zip(rows, row, strict=True))) for row in zip(*rows.values(), strict=True)]

    def camera(self, low: Matrix, high: Matrix) -> Camera | None:
        """Return the first perspective camera, aimed as far away as the middle of the box from `low` to `high`."""
        cameras = [node for node in self.nodes if "camera" in node.entry]
        found: Camera | None = None
        for node in cameras:
            entry = self.document.one("cameras", node.entry["camera"])
            if "perspective" not in entry:
                self.notices.ignore("orthographic cameras")
            elif found is not None:
                self.notices.ignore("cameras after the first")
            elif np.linalg.norm(np.cross(*unit(node.matrix[:3, 1:3].T))) <= ALONG:
                self.notices.ignore("cameras that a scale of 0 leaves without a direction")
            else:
                found = _camera(entry["perspective"], node.matrix, (low + high) / 2)
        return found

    def lights(self, middle: Matrix) -> list[PlacedLight]:
        """Return the lights of KHR_lights_punctual, scaled together: a surface at `middle` that all shine on gets 1.

        Points and spots fall off by the square of the distance.

        A file gives them in lux and candela, for an exposure that it does not give.
        """
        given = self.document.tree.get("extensions", {}).get(_LIGHTS, {}).get("lights", [])
        found: list[tuple[PlacedLight, float]] = []
        for node in self.nodes:
            number = node.entry.get("extensions", {}).get(_LIGHTS, {}).get("light")
            if number is None:
                continue
            if not 0 <= number < len(given):
                raise SceneError(f"it names light {number}, and there are {len(given)}")
            found += [made for made in [self._light(given[number], node.matrix, middle)] if made]
        colors = [np.asarray(light.color) for light, _ in found]
        most = float(sum((c * share for c, (_, share) in zip(colors, found, strict=True)), np.zeros(3)).max())
        lights = zip(colors, found, strict=True)
        return [replace(light, color=triple(c / most)) for c, (light, _) in lights] if most > 0 else []

    def _light(self, entry: dict[str, Any], matrix: Matrix, middle: Matrix) -> tuple[PlacedLight, float] | None:
        """Return a light, and the share of its colour that comes to `middle`."""
        color = float(entry.get("intensity", 1)) * np.asarray(entry.get("color", (1, 1, 1)), dtype=np.float64)
        kind, place = entry.get("type"), matrix[:3, 3]
        if color.shape != (3,) or not np.all(np.isfinite(color)) or color.min() < 0:
            raise SceneError(f"a light has the colour {shown(str(color))}")
        if kind == "directional" and not matrix[:3, 2].any():
            self.notices.ignore("lights that a scale of 0 leaves without a direction")
            return None
        if kind == "directional":
            return DirectionalLight(triple(-matrix[:3, 2]), triple(color)), 1.0
        if kind not in ("point", "spot"):
            self.notices.ignore(f"lights of the type {kind}")
            return None
        if kind == "spot":
            self.notices.ignore("cones of spot lights, which shine all round")
        distance = float(np.linalg.norm(place - middle))
        return PointLight(triple(place), triple(color), falloff="square"), 1 / (distance**2 or 1)

    def _parts(self, number: int, entry: dict[str, Any]) -> list[_Part]:
        if number not in self._meshes:
            made = [self._primitive(primitive) for primitive in entry["primitives"]]
            self._meshes[number] = [part for part in made if part is not None]
        return self._meshes[number]

    def _primitive(self, primitive: dict[str, Any]) -> _Part | None:
        mode = primitive.get("mode", 4)
        if mode not in (4, 5, 6):
            self.notices.ignore("points and lines")
            return None
        targets = primitive.get("targets", [])
        self.notices.ignore("morph targets of colours or uv", sum(bool(t.keys() - _MORPHED) for t in targets))
        attributes = primitive["attributes"]
        if not self.document.has_bytes(attributes["POSITION"]):
            raise SceneError(_without_bytes(primitive))
        vertices = self.document.array(attributes["POSITION"])
        order = np.arange(len(vertices))
        if "indices" in primitive:
            order = self.document.array(primitive["indices"])[:, 0].astype(np.int64)
        look = primitive.get("material")
        normals, uv, colors = (
            self.document.array(attributes[name]) if name in attributes else None
            for name in ("NORMAL", f"TEXCOORD_{self.materials.uv_set(look)}", "COLOR_0")
        )
        if colors is not None and self.materials.uses_alpha(look) and (colors[:, 3:] < 1).any():
            self.notices.ignore("alpha of vertex colours")
        kept: Any = slice(None)
        if len(order) < len(vertices):  # others may share the array: a copy of all for each would be quadratic
            used, order = np.unique(order, return_inverse=True)
            if used.size and not 0 <= used[0] <= used[-1] < len(vertices):
                raise SceneError(f"a primitive names vertex {used[-1]}, and there are {len(vertices)}")
            vertices, kept = vertices[used], used
            normals, uv, colors = (None if rows is None else rows[used] for rows in (normals, uv, colors))
        faces = _faces(order, mode)
        self._built += len(faces)
        check_triangles(self._built)
        made = Mesh(
            vertices,
            faces,
            normals,
            None if colors is None else colors[:, :3],
            self._material(look, uv is not None, colors is not None),
            self.name,
            None if uv is None else self.materials.placed(look, uv) * (1, -1) + (0, 1),  # v runs down in glTF, up here
        )
        return _Part(made, deformation_of(self.document, primitive, made, normals, kept))

    def _material(self, number: Any, has_uv: bool, has_colors: bool) -> Material:
        if number is None or not self.reads_materials:
            return PLAIN if has_colors else CLAY
        return self.materials.get(number, has_uv)


def _without_bytes(primitive: dict[str, Any]) -> str:
    """Return what is wrong with a primitive whose positions have no bytes in the file."""
    extensions = primitive.get("extensions", {})
    if not extensions:
        return "the positions of a primitive have no bytes"
    return f"positions are in {shown(', '.join(sorted(extensions)))}, which is not read: export it without"


def _nodes(document: Document, pose: Pose = MappingProxyType({})) -> Iterator[Node]:
    """Return the nodes of the default scene in a pose, parents first, in the file's order (section 3.5)."""
    entries, scenes = document.all("nodes"), document.all("scenes")
    if scenes:
        roots = document.one("scenes", document.tree.get("scene", 0)).get("nodes", [])
    else:
        children = {child for entry in entries for child in entry.get("children", [])}
        roots = [k for k in range(len(entries)) if k not in children]
    if not entries:
        for number in range(len(document.all("meshes"))):
            yield Node({"mesh": number}, np.eye(4))
    seen: set[int] = set()
    waiting = [(root, np.eye(4)) for root in reversed(roots)]
    while waiting:
        number, outer = waiting.pop()
        entry = {**document.one("nodes", number), **pose.get(number, {})}
        if number in seen:
            raise SceneError(f"node {number} has more than one parent")
        seen.add(number)
        with np.errstate(all="ignore"):  # Instance refuses what is not finite
            matrix = outer @ _local(entry) if _PLACED & entry.keys() else outer
        yield Node(entry, matrix, number)
        waiting += [(child, matrix) for child in reversed(entry.get("children", []))]


def _local(entry: dict[str, Any]) -> Matrix:
    """Return the matrix of a node: its own, or translation, rotation and scale (section 3.5.3)."""
    if "matrix" in entry:
        given = np.asarray(entry["matrix"], dtype=np.float64).reshape(4, 4).T.copy()
        if np.allclose(given[3], (0, 0, 0, 1)):  # but for rounding in the text
            given[3] = 0, 0, 0, 1
        return given
    x, y, z, w = np.asarray(entry.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    length = math.sqrt(x * x + y * y + z * z + w * w) or 1.0
    x, y, z, w = x / length, y / length, z / length, w / length
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, :3] *= np.asarray(entry.get("scale", (1, 1, 1)), dtype=np.float64)
    found[:3, 3] = entry.get("translation", (0, 0, 0))
    return found


def _faces(order: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return the triangles (F, 3) of a list (mode 4), strip (5) or fan (6) of vertices (section 3.7.2.1)."""
    if mode == 4:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    k = np.arange(max(0, len(order) - 2))
    if mode == 5:
        return np.stack([order[k], order[k + 1 + k % 2], order[k + 2 - k % 2]], axis=1)
    return np.stack([order[k + 1], order[k + 2], order[0 * k]], axis=1)


def _camera(lens: dict[str, Any], matrix: Matrix, middle: Matrix) -> Camera:
    """Make a perspective camera (section 3.10.3): it looks along its own -z, and any picture shows its frame whole.

    Where the file gives no aspect ratio the frame is a square.
    """
    angle, aspect = float(lens["yfov"]), float(lens.get("aspectRatio", 1))
    if aspect < 1:
        angle = 2 * math.atan(aspect * math.tan(angle / 2))
    place, ahead = matrix[:3, 3], -unit(matrix[:3, 2])
    distance = float(np.linalg.norm(middle - place)) or 1.0
    target, up = triple(place + distance * ahead), triple(matrix[:3, 1])
    return Camera(triple(place), target, up, math.degrees(angle), aspect=aspect)
