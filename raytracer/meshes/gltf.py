"""Read the container of glTF 2.0: its JSON, its buffers, and the arrays that accessors describe.

Stage: scene description. `gltf_scene` makes meshes, materials, cameras and lights from it. trimesh is not used here: it
ignores sparse accessors, normalized integers, meshes of nodes with a camera, samplers and lights, and keeps eight bits
of a colour. Counts in the file are compared with the bytes that it has before memory is allocated for them.

    document = Document(path.read_bytes(), Folder(path))
    document.array(document.one("meshes", 0)["primitives"][0]["attributes"]["POSITION"])
"""

from __future__ import annotations

import base64
import json
import struct
from typing import Any, Final
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from raytracer.arrays import is_whole
from raytracer.errors import SceneError
from raytracer.meshes.contents import text_of
from raytracer.meshes.folder import Folder, shown

_COMPONENTS: Final = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
_MOST_ZEROS = 1 << 26
"""Bytes of all accessors without a buffer, whose numbers are zeros."""
_TRANSLATED = (
    *("KHR_lights_punctual", "KHR_mesh_quantization", "EXT_texture_webp", "EXT_mesh_gpu_instancing"),
    *("KHR_texture_transform", "KHR_materials_pbrSpecularGlossiness"),
    *("KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_transmission", "KHR_materials_volume"),
)


class Document:
    """The JSON of a file as `tree`, and what its buffers hold.

    Raises SceneError for another version, for what is cut off, and for extensions that the file requires and that are
    not read: the specification forbids to show such a file without them.
    """

    def __init__(self, data: bytes, folder: Folder) -> None:
        self.folder = folder
        text, self._binary = _container(data)
        tree = json.loads(text)
        if not isinstance(tree, dict):
            raise SceneError("its JSON is no object")
        self.tree: dict[str, Any] = tree
        version = str(tree.get("asset", {}).get("version", "2.0"))
        if version.split(".")[0] != "2":
            raise SceneError(f"its version of glTF is {shown(version)}, not 2.0")
        unread = set(map(str, tree.get("extensionsRequired", []))) - set(_TRANSLATED)
        if unread:
            names, are = shown(", ".join(sorted(unread))), "is" if len(unread) == 1 else "are"
            raise SceneError(f"it needs {names}, which {are} not read: export it without")
        self._lists: dict[str, list[dict[str, Any]]] = {}
        self._buffers: dict[int, bytes] = {}
        self._zeros = 0
        self._arrays: dict[int, NDArray[Any]] = {}

    @property
    def unread(self) -> list[str]:
        """The extensions that the file uses and that are not read."""
        return [name for name in map(str, self.tree.get("extensionsUsed", [])) if name not in _TRANSLATED]

    def all(self, key: str) -> list[dict[str, Any]]:
        """Return the entries of one of the file's lists."""
        if key not in self._lists:
            found = self.tree.get(key, [])
            if not (isinstance(found, list) and all(isinstance(entry, dict) for entry in found)):
                raise SceneError(f"its {key} are no list of objects")
            self._lists[key] = found
        return self._lists[key]

    def one(self, key: str, number: Any) -> dict[str, Any]:
        """Return the entry of one of the file's lists that has this number."""
        entries = self.all(key)
        if not is_whole(number, 0, len(entries) - 1):
            raise SceneError(f"it names number {shown(str(number))} of its {key}, and there are {len(entries)}")
        return entries[number]

    def array(self, number: Any) -> NDArray[Any]:
        """Return the rows (N, width) of an accessor: floats, or integers unless it is normalized."""
        accessor = self.one("accessors", number)
        if number not in self._arrays:
            self._arrays[number] = self._array(accessor)
        return self._arrays[number]

    def has_bytes(self, number: Any) -> bool:
        """Return whether the file itself holds the numbers of an accessor: else an extension may."""
        return not {"bufferView", "sparse"}.isdisjoint(self.one("accessors", number))

    def bytes_of(self, view: Any) -> memoryview:
        """Return the bytes of a buffer view; they are not copied."""
        entry = self.one("bufferViews", view)
        start, length = _count(entry.get("byteOffset", 0)), _count(entry["byteLength"])
        buffer = self._buffer(entry["buffer"])
        if start + length > len(buffer):
            raise SceneError(f"buffer view {view} ends at byte {start + length:,} of {len(buffer):,}")
        return memoryview(buffer)[start : start + length]

    def uri(self, uri: str) -> bytes:
        """Return the bytes of a data URI, or of a file in the folder."""
        if uri.startswith("data:"):
            head, comma, body = uri.partition(",")
            if not comma or not head.endswith(";base64"):
                raise SceneError("a data URI is not in base64")
            return base64.b64decode(body)
        return self.folder.read(unquote(uri))

    def _buffer(self, number: Any) -> bytes:
        entry = self.one("buffers", number)
        if number not in self._buffers:
            if "uri" not in entry and number != 0:
                raise SceneError(f"buffer {number} has no bytes")
            try:
                self._buffers[number] = self.uri(entry["uri"]) if "uri" in entry else self._binary
            except SceneError as error:
                raise SceneError(f"buffer {shown(entry['uri'])}: {error}") from None
        return self._buffers[number]

    def _array(self, accessor: dict[str, Any]) -> NDArray[Any]:
        kind = np.dtype(_COMPONENTS[accessor["componentType"]])
        count, width = _count(accessor["count"]), _WIDTHS[accessor["type"]]
        if "bufferView" in accessor:
            rows = self._rows(accessor["bufferView"], accessor.get("byteOffset", 0), kind, count, width)
        else:
            self._zeros += count * width * kind.itemsize
            if self._zeros > _MOST_ZEROS:
                raise SceneError(f"an accessor of {count:,} elements has no bytes")
            rows = np.zeros((count, width), kind)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            changed, where, values = _count(sparse["count"]), sparse["indices"], sparse["values"]
            index = np.dtype(_COMPONENTS[where["componentType"]])
            places = self._rows(where["bufferView"], where.get("byteOffset", 0), index, changed, 1)[:, 0]
            rows = rows.copy()
            rows[places] = self._rows(values["bufferView"], values.get("byteOffset", 0), kind, changed, width)
        if accessor.get("normalized") and kind.kind in "iu":
            return np.maximum(rows.astype(np.float64) / np.iinfo(kind).max, -1)
        return rows

    def _rows(self, view: Any, start: Any, kind: np.dtype[Any], count: int, width: int) -> NDArray[Any]:
        """Return rows (count, width) of a buffer view; numpy refuses rows that do not lie in it."""
        stride = self.one("bufferViews", view).get("byteStride", width * kind.itemsize)
        if stride < width * kind.itemsize:
            raise SceneError(f"elements of {width * kind.itemsize} bytes lie only {stride} apart")
        return np.ndarray((count, width), kind, self.bytes_of(view), _count(start), (stride, kind.itemsize))


def _container(data: bytes) -> tuple[str, bytes]:
    """Return the text of the JSON and the binary chunk of a GLB file, or of a text."""
    if not data.startswith(_MAGIC):
        return text_of(data), b""
    if len(data) < 20:
        raise SceneError(f"it ends within the header: {len(data)} bytes of 20")
    if data[4:8] != b"\2\0\0\0":
        raise SceneError(f"its version of GLB is {int.from_bytes(data[4:8], 'little')}, not 2")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, at)
        at += 8
        if at + length > len(data):
            raise SceneError(f"it declares {length:,} bytes where {len(data) - at:,} follow")
        chunks.setdefault(kind, data[at : at + length])
        at += length
    if _JSON not in chunks:
        raise SceneError("it has no JSON")
    return text_of(chunks[_JSON]), chunks.get(_BIN, b"")


def _count(value: Any) -> int:
    """Return a whole number of JSON that is not negative."""
    if not is_whole(value, 0):
        raise SceneError(f"{shown(str(value))!r} is no number of elements or bytes")
    return value
