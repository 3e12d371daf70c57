"""Small glTF files, written by hand: what trimesh does not write, and what is wrong."""

import base64
import json
import struct
from io import BytesIO

import numpy as np
from PIL import Image as pillow

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
WIDTHS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
CORNERS = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])  # uv of glTF: v runs down
HALVES = [0, 1, 2, 0, 2, 3]
MATT = {"KHR_materials_specular": {"specularFactor": 0}}
"""The extensions of a material that mirrors nothing: its picture shows the base colour alone."""


class File:
    """A glTF document that grows; `tree` is its JSON."""

    def __init__(self):
        self.tree = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "buffers": [{}]}
        self.binary = b""

    def add(self, key, entry):
        self.tree.setdefault(key, []).append(entry)
        return len(self.tree[key]) - 1

    def view(self, data, **extra):
        self.binary += bytes(-len(self.binary) % 4)
        entry = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)} | extra
        self.binary += data
        return self.add("bufferViews", entry)

    def array(self, values, kind="f4", **extra):
        values = np.asarray(values, kind)
        width = 1 if values.ndim == 1 else values.shape[1]
        entry = {"bufferView": self.view(values.tobytes()), "componentType": CODES[kind], "count": len(values)}
        return self.add("accessors", entry | {"type": WIDTHS[width]} | extra)

    def square(self, *, uv=True, **primitive):
        """A primitive: the square from (-1, -1, 0) to (1, 1, 0)."""
        attributes = {"POSITION": self.array(SQUARE)} | ({"TEXCOORD_0": self.array(CORNERS)} if uv else {})
        attributes |= primitive.pop("attributes", {})
        return {"attributes": attributes, "indices": self.array(HALVES, "u2")} | primitive

    def mesh(self, *primitives, **entry):
        return self.add("meshes", {"primitives": list(primitives)} | entry)

    def node(self, root=True, **entry):
        number = self.add("nodes", entry)
        if root:
            self.tree["scenes"][0]["nodes"].append(number)
        return number

    def light(self, root=True, place=None, **entry):
        lights = self.tree.setdefault("extensions", {}).setdefault("KHR_lights_punctual", {}).setdefault("lights", [])
        lights.append(entry)
        return self.node(root, extensions={"KHR_lights_punctual": {"light": len(lights) - 1}}, **(place or {}))

    def picture(self, pixels, **sampler):
        """The number of a texture that holds pixels (H, W, 3 or 4) as PNG."""
        source = self.add("images", {"bufferView": self.view(png(pixels)), "mimeType": "image/png"})
        return self.add("textures", {"source": source, "sampler": self.add("samplers", sampler)})

    def material(self, **entry):
        return self.add("materials", entry)

    def glb(self):
        self.tree["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + bytes(-len(self.binary) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def gltf(self):
        """The same as one text, with its buffer in a data URI."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        self.tree["buffers"] = [{"byteLength": len(self.binary), "uri": uri}]
        return json.dumps(self.tree).encode()

    def save(self, path):
        path.write_bytes(self.glb() if path.suffix == ".glb" else self.gltf())
        return path


def png(pixels, format="PNG"):
    held = BytesIO()
    pillow.fromarray(np.asarray(pixels, np.uint8)).save(held, format)
    return held.getvalue()


def textured():
    """A file with most of what is read: textures, materials, colours, nodes, a camera and lights."""
    file = File()
    base = file.picture([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], wrapS=33071, wrapT=33071)
    rough = file.picture(np.full((2, 2, 3), 128), magFilter=9728)
    look = {"baseColorTexture": {"index": base}, "metallicRoughnessTexture": {"index": rough}}
    painted = file.material(name="painted", pbrMetallicRoughness=look)
    tinted = file.material(pbrMetallicRoughness={"baseColorFactor": [0.5, 0.25, 0.1, 1], "metallicFactor": 0})
    colors = {"COLOR_0": file.array(np.full((4, 4), 128), "u1", normalized=True)}
    mesh = file.mesh(file.square(material=painted), file.square(material=tinted, attributes=colors), name="tile")
    child = file.node(False, name="child", mesh=mesh, translation=[2, 0, 0], scale=[-1, 1, 1])
    file.node(name="parent", mesh=mesh, rotation=[0, 0, 0.6, 0.8], children=[child])
    camera = file.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.8, "aspectRatio": 1.5, "znear": 1}})
    file.node(camera=camera, translation=[0, 0, 6])
    file.light(type="point", intensity=30, place={"translation": [0, 3, 4]})
    file.light(type="directional", color=[1, 0.5, 0.5])
    return file


def shining():
    """A file whose materials shine, are clear, or have holes."""
    file = File()
    leaf = file.picture([[[255, 0, 0, 255], [0, 255, 0, 0]], [[0, 0, 255, 128], [255, 255, 255, 255]]])
    look = {"baseColorTexture": {"index": leaf}, "baseColorFactor": [1, 1, 1, 0.8], "metallicFactor": 0}
    glow = {"emissiveFactor": [1, 0.5, 0], "emissiveTexture": {"index": leaf}}
    volume = {"thicknessFactor": 1, "attenuationDistance": 2, "attenuationColor": [1, 0.5, 0.25]}
    clear = {"transmissionFactor": 0.9, "transmissionTexture": {"index": leaf}}
    extensions = {"emissive_strength": {"emissiveStrength": 3}, "ior": {"ior": 1.4}, "transmission": clear}
    for entry in (
        {"alphaMode": "MASK", "alphaCutoff": 0.3, **glow},
        {"alphaMode": "BLEND"},
        {"extensions": {f"KHR_materials_{name}": found for name, found in extensions.items()}, **glow},
        {"extensions": {"KHR_materials_transmission": clear, "KHR_materials_volume": volume}},
    ):
        file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look, **entry))))
    file.tree["extensionsUsed"] = [f"KHR_materials_{name}" for name in (*extensions, "volume")]
    return file
