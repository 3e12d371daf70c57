"""Random glTF files whose right reading is known by construction.

The right parts are computed here from the numbers that a file is made of, in binary64 and by other formulas than the
reader's, before they are stored in one of the ways that the format allows.
"""

import base64
import json
import struct
from dataclasses import dataclass, field

import numpy as np
from gltf_files import CODES, WIDTHS, File

INDICES = ("u1", "u2", "u4")
PADS = (b" ", b"\0")


@dataclass
class Part:
    """A mesh as it is to be read: (F, 3, 3) corners, and normals, colours and (F, 3, 2) uv or None."""

    corners: np.ndarray
    normals: np.ndarray | None
    colors: np.ndarray | None
    uv: np.ndarray | None
    color: tuple | None


@dataclass
class Expected:
    """The right reading of a file: its parts with their names, and how many entries of each kind are left out."""

    parts: list = field(default_factory=list)
    names: list = field(default_factory=list)
    faults: dict = field(default_factory=dict)
    camera: tuple | None = None
    lights: list = field(default_factory=list)

    def leave_out(self, fault, count=1):
        self.faults[fault] = self.faults.get(fault, 0) + count


class Generated(File):
    """A file that grows at random; `expected` is its right reading."""

    def __init__(self, seed, *, bad):
        super().__init__()
        self.rng, self.bad, self.expected = np.random.default_rng(seed), bad, Expected()
        self.meshes = []  # the parts of each mesh in its own coordinates
        count = int(self.rng.integers(1, 4))
        for _ in range(count):
            self.add_mesh()
        self.grow()

    def chance(self, share=0.5):
        return self.rng.random() < share

    def one_of(self, choices):
        return choices[int(self.rng.integers(len(choices)))]

    # Numbers, stored in one of the ways that the format has

    def stored(self, values, kind="f4", **extra):
        """Return the number of an accessor of these values: plain, interleaved, with an offset, or sparse."""
        values = np.asarray(values, kind)
        values = values[:, None] if values.ndim == 1 else values
        count, width = values.shape
        entry = {"componentType": CODES[kind], "count": count, "type": WIDTHS[width]} | extra
        size = values.dtype.itemsize
        way = self.one_of(("plain", "strided", "offset", "sparse", "zeros"))
        if way == "strided":
            stride = -(-width * size // 4) * 4 + 4 * int(self.rng.integers(3))
            rows = self.rng.integers(0, 256, (count, stride), np.uint8)
            rows[:, : width * size] = values.view(np.uint8).reshape(count, -1)
            return self.add("accessors", entry | {"bufferView": self.view(rows.tobytes(), byteStride=stride)})
        if way == "offset":
            before = self.rng.bytes(4 * int(self.rng.integers(1, 4)))
            return self.add(
                "accessors", entry | {"bufferView": self.view(before + values.tobytes()), "byteOffset": len(before)}
            )
        if way == "sparse" or (way == "zeros" and not extra):
            places = np.sort(self.rng.choice(count, int(self.rng.integers(1, count + 1)), replace=False))
            if way == "zeros":
                places = np.arange(count)
            base = values.copy()
            base[places] = 7
            index = self.one_of(INDICES if count < 256 else INDICES[1:])
            entry["sparse"] = {
                "count": len(places),
                "indices": {"bufferView": self.view(places.astype(index).tobytes()), "componentType": CODES[index]},
                "values": {"bufferView": self.view(values[places].tobytes())},
            }
            if way == "zeros":
                return self.add("accessors", entry)
            return self.add("accessors", entry | {"bufferView": self.view(base.tobytes())})
        return self.add("accessors", entry | {"bufferView": self.view(values.tobytes())})

    def normalized(self, values, kinds):
        """Return an accessor of numbers in [-1, 1] or [0, 1], and the numbers as they are stored."""
        kind = self.one_of(kinds)
        if kind == "f4":
            held = np.asarray(values, np.float32)
            return self.stored(held), held.astype(np.float64)
        most = np.iinfo(kind).max
        held = np.rint(np.asarray(values) * most).astype(kind)
        return self.stored(held, kind, normalized=True), np.maximum(held / most, -1)

    # Meshes

    def add_mesh(self):
        primitives, parts = [], []
        for _ in range(int(self.rng.integers(1, 4))):
            primitive, part = self.primitive()
            primitives.append(primitive)
            parts += [] if part is None else [part]
        if self.bad and self.chance():
            primitives.insert(int(self.rng.integers(len(primitives) + 1)), self.bad_primitive())
        if self.chance(0.2):
            primitives.append({"attributes": {"POSITION": self.stored(self.rng.random((2, 3)))}, "mode": 1})
        self.mesh(*primitives, **({"name": f"mesh{len(self.meshes)}"} if self.chance() else {}))
        self.meshes.append(parts)

    def bad_primitive(self):
        """Return a primitive that is left out: each of them is counted once."""
        self.expected.leave_out("primitive cannot be read")
        kind = int(self.rng.integers(6))
        corners = self.rng.random((3, 3))
        if kind == 0:
            return {"attributes": {"NORMAL": self.stored(corners)}}
        if kind == 1:
            return {"attributes": {"POSITION": 9999}}
        if kind == 2:
            return {
                "attributes": {"POSITION": self.add("accessors", {"componentType": 5126, "count": 3, "type": "VEC3"})}
            }
        if kind == 3:
            cut = {"bufferView": self.view(bytes(20)), "componentType": 5126, "count": 3, "type": "VEC3"}
            return {"attributes": {"POSITION": self.add("accessors", cut)}}
        if kind == 4:
            return {"attributes": {"POSITION": self.stored(corners)}, "indices": self.stored([0.0, 1.0, 2.0])}
        return 7

    def primitive(self):
        """Return a primitive and its part."""
        count = int(self.rng.integers(3, 20))
        vertices = self.rng.uniform(-2, 2, (count, 3)).astype(np.float32)
        attributes = {}
        places = vertices.astype(np.float64)
        mode = self.one_of((4, 4, 4, 5, 6))
        order = np.arange(count) if self.chance(0.3) else self.rng.integers(0, count, 3 * int(self.rng.integers(1, 12)))
        if mode == 4 and len(order) % 3:
            self.expected.leave_out("end within a triangle")
        faces = triangles(order, mode)
        spoiled = self.bad and self.chance(0.3)
        if spoiled:  # a vertex without a place: its triangles go
            number = int(self.rng.integers(count))
            vertices[number, int(self.rng.integers(3))] = self.one_of((np.nan, np.inf))
            gone = (faces == number).any(axis=1)
            if gone.any():
                self.expected.leave_out("corner at no finite place", int(gone.sum()))
            faces = faces[~gone]
        extra = {}
        if spoiled or self.chance(0.6):
            attributes["POSITION"] = self.stored(vertices)
        else:
            attributes["POSITION"], places = self.normalized(vertices / 2, ("i2", "i1", "f4"))
        if len(order) != count or (order != np.arange(count)).any() or self.chance(0.2):
            kind = self.one_of(INDICES)
            if self.bad and mode == 4 and self.chance(0.3):  # a triangle of vertices that are not there
                order = np.concatenate([[0, 1, count + int(self.rng.integers(200))], order])
                self.expected.leave_out("vertex that is not there")
            extra["indices"] = self.stored(order, kind)
        normals = colors = uv = None
        if self.chance():
            given = self.rng.normal(size=(count, 3))
            given /= np.linalg.norm(given, axis=1)[:, None]
            attributes["NORMAL"], normals = self.normalized(given, ("f4", "i1", "i2"))
        elif self.bad and self.chance(0.3):
            self.expected.leave_out("normals that cannot be read")
            wrong = self.one_of((np.full((count, 3), np.nan), np.ones((count + 1, 3)), np.ones((count, 2))))
            attributes["NORMAL"] = self.stored(wrong)
        if self.chance():
            width = self.one_of((3, 4))
            attributes["COLOR_0"], colors = self.normalized(self.rng.random((count, width)), ("f4", "u1", "u2"))
            colors = colors[:, :3]
        if self.chance():
            attributes["TEXCOORD_0"], uv = self.normalized(self.rng.random((count, 2)), ("f4", "u1", "u2"))
            uv = uv * (1, -1) + (0, 1)
        color = None
        if self.chance():
            color = tuple(self.rng.random(3).round(4).tolist())
            look = {"baseColorFactor": [*color, 1], "metallicFactor": 0}
            extra["material"] = self.material(pbrMetallicRoughness=look)
        elif self.bad and self.chance(0.3):
            self.expected.leave_out("material cannot be read")
            extra["material"] = self.material(pbrMetallicRoughness={"baseColorFactor": [1, 0.5]})
        if mode != 4 or self.chance(0.3):
            extra["mode"] = mode
        at_corners = [None if rows is None else rows[faces] for rows in (places, normals, colors, uv)]
        return {"attributes": attributes} | extra, Part(*at_corners, color)

    # The scene

    def grow(self):
        """Add nodes, a camera and lights; the default scene is one of several."""
        shown = int(self.rng.integers(1, 3)) if self.chance(0.3) else 0
        self.tree["scenes"] = [{"nodes": []} for _ in range(shown + 1 + int(self.rng.integers(2)))]
        self.tree["scene"] = shown
        roots = []
        for _ in range(int(self.rng.integers(1, 4))):
            roots.append(self.branch(np.eye(4), int(self.rng.integers(4))))
        if self.bad and self.chance():
            roots.append(self.one_of((999, "x", self.add("nodes", {"mesh": 99}), self.add("nodes", {"matrix": [1]}))))
            self.expected.leave_out("node cannot be read")
        self.view_of(roots)
        self.tree["scenes"][shown]["nodes"] = roots
        for number, scene in enumerate(self.tree["scenes"]):
            if number != shown:
                scene["nodes"] = [self.add("nodes", {"mesh": 0, "name": "not shown"})]

    def view_of(self, roots):
        """Add a camera and lights."""
        if self.bad and self.chance(0.3):
            lens = self.one_of(({"yfov": -1}, {"aspectRatio": 1}, {"yfov": 1, "aspectRatio": "wide"}))
            wrong = self.add("cameras", {"type": "perspective", "perspective": lens})
            roots.append(self.add("nodes", {"camera": wrong}))
            self.expected.leave_out("camera cannot be read")
        if self.chance():
            yfov, aspect = self.rng.uniform(0.2, 1.5), self.rng.uniform(0.3, 3)
            lens = {"yfov": yfov, "aspectRatio": aspect, "znear": 0.1}
            turn, place = rotation(self.rng), self.rng.uniform(5, 9, 3)
            camera = self.add("cameras", {"type": "perspective", "perspective": lens})
            roots.append(
                self.add("nodes", {"camera": camera, "rotation": turn.tolist(), "translation": place.tolist()})
            )
            self.expected.camera = place, matrix_of(turn)[:, 2] * -1, yfov, aspect
        lights = self.tree.setdefault("extensions", {}).setdefault("KHR_lights_punctual", {}).setdefault("lights", [])
        for _ in range(int(self.rng.integers(3))):
            color = self.rng.random(3)
            lights.append({"type": "point", "color": color.tolist(), "intensity": 1 + 9 * self.rng.random()})
            place = self.rng.uniform(-9, 9, 3)
            self.expected.lights.append(place)
            self.light_node(roots, len(lights) - 1, translation=place.tolist())
        if self.bad and self.chance(0.3):
            lights.append(self.one_of(({"type": "point", "color": [1, -1, 0]}, 3, {"type": "point", "intensity": "x"})))
            self.light_node(roots, len(lights) - 1)
            self.expected.leave_out("light cannot be read")

    def light_node(self, roots, number, **place):
        roots.append(self.add("nodes", {"extensions": {"KHR_lights_punctual": {"light": number}}} | place))

    def branch(self, outer, depth):
        """Add a node with what is below it; return its number."""
        entry, matrix = self.place()
        matrix = outer @ matrix
        number = self.add("nodes", entry)
        if depth == 0 or self.chance():
            mesh = int(self.rng.integers(len(self.meshes)))
            entry["mesh"] = mesh
            if self.chance():
                entry["name"] = f"node{number}"
            name = entry.get("name") or self.tree["meshes"][mesh].get("name") or "generated"
            for k, part in enumerate(self.meshes[mesh]):
                if len(part.corners):
                    self.expected.parts.append(placed(part, matrix))
                    self.expected.names.append(f"{name}_{k}" if k else name)
        children = [self.branch(matrix, depth - 1) for _ in range(int(self.rng.integers(1, 3)) if depth else 0)]
        if children:
            entry["children"] = children
        return number

    def place(self):
        """Return the entry of a node and its matrix, which may mirror."""
        kind = self.one_of(("none", "matrix", "parts"))
        if kind == "none":
            return {}, np.eye(4)
        turn, scale, step = rotation(self.rng), self.rng.uniform(0.5, 2, 3), self.rng.uniform(-5, 5, 3)
        scale *= self.rng.choice([-1, 1], 3)
        matrix = np.eye(4)
        matrix[:3, :3] = matrix_of(turn) * scale
        matrix[:3, 3] = step
        if kind == "matrix":
            return {"matrix": matrix.T.reshape(-1).tolist()}, matrix
        return {"translation": step.tolist(), "rotation": turn.tolist(), "scale": scale.tolist()}, matrix

    # Containers

    def write(self, folder):
        """Write the file, in one of its containers; return its path."""
        self.tree["extensionsUsed"] = ["KHR_lights_punctual", "KHR_mesh_quantization"]
        kind = self.one_of(("glb", "data", "beside"))
        if kind == "glb":
            return self._glb(folder / "generated.glb")
        path = folder / "generated.gltf"
        if kind == "data":
            text = base64.b64encode(self.binary).decode()
            text = text.rstrip("=") if self.chance() else text
            uri = self.one_of(("data:", "DATA:", "Data:")) + "application/octet-stream;base64," + text
        else:
            there, uri = self.one_of(
                (("a b.bin", "a%20b.bin"), ("a.bin", "a.bin?v=3"), ("A.bin", "a.BIN"), (" a.bin", " a.bin"))
            )
            (folder / there).write_bytes(self.binary)
        self.tree["buffers"] = [{"byteLength": len(self.binary), "uri": uri}]
        mark = self.one_of((b"", b"\xef\xbb\xbf"))
        path.write_bytes(mark + json.dumps(self.tree).encode())
        return path

    def _glb(self, path):
        self.tree["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.tree).encode()
        text += self.one_of(PADS) * (-len(text) % 4)
        binary = self.binary + bytes(-len(self.binary) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        chunks += struct.pack("<I4s", 4, b"XTRA") + b"more" if self.chance(0.2) else b""
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path


def triangles(order, mode):
    """Return the triangles of a list, a strip or a fan, one by one (section 3.7.2.1)."""
    order = [int(k) for k in order]
    if mode == 4:
        found = [order[k : k + 3] for k in range(0, len(order) - 2, 3)]
    elif mode == 5:
        found = [[order[k], order[k + 1 + k % 2], order[k + 2 - k % 2]] for k in range(len(order) - 2)]
    else:
        found = [[order[k + 1], order[k + 2], order[0]] for k in range(len(order) - 2)]
    return np.array(found, int).reshape(-1, 3)


def rotation(rng):
    """Return a unit quaternion x, y, z, w."""
    found = rng.normal(size=4)
    return found / np.linalg.norm(found)


def matrix_of(turn):
    """Return the matrix (3, 3) of a quaternion: its columns are the axes, turned by q v q*."""

    def product(a, b):
        return np.append(a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3]), a[3] * b[3] - a[:3] @ b[:3])

    back = turn * (-1, -1, -1, 1)
    return np.stack([product(product(turn, np.append(axis, 0)), back)[:3] for axis in np.eye(3)], axis=1)


def placed(part, matrix):
    """Return a part where a matrix takes it; one that is mirrored keeps its outside, so its corners run backwards."""
    linear = matrix[:3, :3]
    corners = part.corners @ linear.T + matrix[:3, 3]
    normals = None
    if part.normals is not None:
        normals = part.normals @ np.linalg.inv(linear)
        normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    turned = slice(None, None, -1) if np.linalg.det(linear) < 0 else slice(None)
    found = [None if rows is None else rows[:, turned] for rows in (corners, normals, part.colors, part.uv)]
    return Part(*found, part.color)
