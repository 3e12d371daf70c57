"""Read the container of glTF 2.0: its JSON, its buffers, and the arrays that accessors describe.

Stage: scene description. `gltf_scene` makes meshes, materials, cameras and lights from it. trimesh is not used here: it
ignores sparse accessors, normalized integers, meshes of nodes with a camera, samplers and lights, and keeps eight bits
of a colour. Counts in the file are compared with the bytes that it has before memory is allocated for them. An entry is
an object of JSON, and what is wrong with it is a SceneError that names the part.

    document = Document(path.read_bytes(), Folder(path))
    document.array(document.one("meshes", 0)["primitives"][0]["attributes"]["POSITION"])
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from raytracer.arrays import is_whole, one_float
from raytracer.errors import SceneError
from raytracer.meshes.folder import Folder, shown
from raytracer.meshes.lines import text_of

_COMPONENTS: Final = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
_MOST_ZEROS = 1 << 26
"""Bytes of all accessors without a buffer, whose numbers are zeros."""
_LOOKS: Final = "KHR_materials_"
"""The extensions that decide no more than the look of a material, which is shown without them."""
_COMPRESSED: Final = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_TRANSLATED = (
    *("KHR_lights_punctual", "KHR_mesh_quantization", "EXT_texture_webp", "EXT_mesh_gpu_instancing"),
    *("KHR_texture_transform", "KHR_materials_pbrSpecularGlossiness"),
    *("KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_transmission", "KHR_materials_volume"),
    *("KHR_materials_specular", "KHR_materials_clearcoat", "KHR_materials_sheen", "KHR_materials_anisotropy"),
    *("KHR_materials_unlit", "KHR_materials_variants"),
)
BROKEN: Final = (SceneError, KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError)
"""The exceptions by which a reader meets a bad entry."""


class Document:
    """The JSON of a file as `tree`, and the contents of its buffers.

    Raises SceneError for another version, for what is cut off, and for extensions that the file requires and that are
    not read: the specification forbids to show such a file without them.
    """

    def __init__(self, data: bytes, folder: Folder) -> None:
        self.folder = folder
        text, self._binary = _container(data)
        self.tree: dict[str, Any] = _tree(text)
        version = str(table(self.tree, "asset").get("version", "2.0"))
        if version.split(".")[0] != "2":
            raise SceneError(f"its version of glTF is {shown(version)}, not 2.0")
        self.check_extensions([name for name in self._required if not name.startswith(_LOOKS)])
        self._lists: dict[str, list[dict[str, Any]]] = {}
        self._buffers: dict[int, bytes] = {}
        self._zeros = 0
        self._arrays: dict[int, NDArray[Any]] = {}

    @property
    def _required(self) -> list[str]:
        """The extensions that the file requires and that are not read."""
        return sorted(set(map(str, rows(self.tree, "extensionsRequired"))) - set(_TRANSLATED))

    def check_extensions(self, names: list[str] | None = None) -> None:
        """Raise SceneError for extensions that are not read: these, or by default all that the file requires."""
        unread = self._required if names is None else names
        if unread:
            listed, are = shown(", ".join(unread)), "is" if len(unread) == 1 else "are"
            raise SceneError(f"it needs {listed}, which {are} not read: export it without")

    @property
    def unread(self) -> list[str]:
        """The extensions that the file uses and that are not read."""
        return [name for name in map(str, rows(self.tree, "extensionsUsed")) if name not in _TRANSLATED]

    def all(self, key: str) -> list[dict[str, Any]]:
        """Return the entries of one of the file's lists."""
        if key not in self._lists:
            entries = self.tree.get(key, [])
            if not (isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)):
                raise SceneError(f"its {key} are no list of objects")
            self._lists[key] = entries
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
            try:
                self._arrays[number] = self._array(accessor)
            except BROKEN as error:
                raise SceneError(f"accessor {number}: {reason_of(error)}") from error
        return self._arrays[number]

    def compression_of(self, primitive: Mapping[str, Any], number: Any) -> str:
        """Return the extension that compresses the numbers of an accessor of a primitive; "" if none does."""
        view = self.one("accessors", number).get("bufferView")
        holders = [primitive, *([] if view is None else [self.one("bufferViews", view)])]
        return next((name for name in _COMPRESSED for holder in holders if name in table(holder, "extensions")), "")

    def has_bytes(self, number: Any) -> bool:
        """Return whether the file itself holds the numbers of an accessor: else an extension may."""
        return not {"bufferView", "sparse"}.isdisjoint(self.one("accessors", number))

    def bytes_of(self, view: Any) -> memoryview:
        """Return the bytes of a buffer view; they are not copied."""
        entry = self.one("bufferViews", view)
        start, length = count_of(entry, "byteOffset", 0), count_of(entry, "byteLength")
        buffer = self._buffer(needed(entry, "buffer"))
        if start + length > len(buffer):
            raise SceneError(f"buffer view {view} ends at byte {start + length:,} of {len(buffer):,}")
        return memoryview(buffer)[start : start + length]

    def uri(self, uri: Any) -> bytes:
        """Return the bytes of a data URI, or of a file in the folder."""
        if not isinstance(uri, str):
            raise SceneError(f"its uri is {shown(str(uri))}, not a text")
        if is_data(uri):
            return _data(uri)
        try:
            return self.folder.read(unquote(uri))
        except SceneError as error:
            try:
                return self.folder.read(uri)  # some exporters write names without escapes
            except SceneError:
                raise error from None

    def _buffer(self, number: Any) -> bytes:
        entry = self.one("buffers", number)
        if number not in self._buffers:
            if "uri" not in entry and number != 0:
                raise SceneError(f"buffer {number} has no bytes")
            try:
                self._buffers[number] = self.uri(entry["uri"]) if "uri" in entry else self._binary
            except (SceneError, OSError) as error:
                uri = entry["uri"]
                name = "" if is_data(uri) else f" ({shown(str(uri))})"
                raise SceneError(f"buffer {number}{name}: {error}") from None
        return self._buffers[number]

    def _array(self, accessor: dict[str, Any]) -> NDArray[Any]:
        kind, width = _component(accessor), _WIDTHS.get(str(accessor.get("type")), 0)
        if not width:
            raise SceneError(f"its type is {shown(str(accessor.get('type')))}, none of {', '.join(_WIDTHS)}")
        count = count_of(accessor, "count")
        if "bufferView" in accessor:
            elements = self._rows(accessor, kind, count, width)
        else:
            self._zeros += count * width * kind.itemsize
            if self._zeros > _MOST_ZEROS:
                raise SceneError(f"it has {count:,} elements without bytes")
            elements = np.zeros((count, width), kind)
        if "sparse" in accessor:
            sparse = table(accessor, "sparse")
            changed, where = count_of(sparse, "count"), table(sparse, "indices")
            places = self._rows(where, _component(where), changed, 1)[:, 0]
            if changed and not 0 <= places.min() <= places.max() < count:
                raise SceneError(f"its sparse numbers replace element {places.max()}, and there are {count:,}")
            elements = elements.copy()
            elements[places.astype(np.int64)] = self._rows(table(sparse, "values"), kind, changed, width)
        if accessor.get("normalized") and kind.kind in "iu":
            return np.maximum(elements.astype(np.float64) / np.iinfo(kind).max, -1)
        return elements

    def _rows(self, place: dict[str, Any], kind: np.dtype[Any], count: int, width: int) -> NDArray[Any]:
        """Return rows (count, width) of a buffer view, which `place` names with an offset."""
        view, start = needed(place, "bufferView"), count_of(place, "byteOffset", 0)
        size, content = width * kind.itemsize, self.bytes_of(view)
        stride = count_of(self.one("bufferViews", view), "byteStride", size)
        if stride < size:
            raise SceneError(f"its elements of {size} bytes lie only {stride} apart")
        end = start + (count - 1) * stride + size if count else start
        if end > len(content):
            raise SceneError(
                f"its {count:,} elements end at byte {end:,} of buffer view {view}, which has {len(content):,}"
            )
        return np.ndarray((count, width), kind, content, start, (stride, kind.itemsize))


def _tree(text: str) -> dict[str, Any]:
    """Return the object that a text of JSON describes."""
    try:
        tree = json.loads(text)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise SceneError(f"its JSON cannot be read from {place} on: {error.msg}") from None
    except RecursionError:
        raise SceneError("its JSON has lists within lists beyond any use") from None
    if not isinstance(tree, dict):
        raise SceneError("its JSON is no object")
    return tree


def _component(entry: dict[str, Any]) -> np.dtype[Any]:
    """Return the type of the numbers of an accessor."""
    code = entry.get("componentType")
    if not (is_whole(code, 0) and code in _COMPONENTS):
        raise SceneError(f"its componentType is {shown(str(code))}, none of {', '.join(map(str, _COMPONENTS))}")
    return np.dtype(_COMPONENTS[code])


def is_data(uri: Any) -> bool:
    """Return whether a URI holds the bytes itself. The scheme may be in capitals (RFC 3986, section 3.1)."""
    return isinstance(uri, str) and uri[:5].lower() == "data:"


def _data(uri: str) -> bytes:
    """Return the bytes of a data URI (RFC 2397), whose base64 may come without its padding."""
    head, comma, body = uri.partition(",")
    if not comma:
        raise SceneError("its data URI has no comma before the bytes")
    content = unquote_to_bytes(body)
    if not head.lower().endswith(";base64"):
        return content
    content = re.sub(rb"\s+", b"", content).rstrip(b"=")
    try:
        return base64.b64decode(content + b"=" * (-len(content) % 4), validate=True)
    except binascii.Error as error:
        raise SceneError(f"the base64 of its data URI is wrong: {str(error).lower()}") from None


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
    # Some writers pad the chunk with zeros, where the format has spaces.
    return text_of(chunks[_JSON].rstrip(b"\0 ")), chunks.get(_BIN, b"")


def needed(entry: Mapping[str, Any], key: str) -> Any:
    """Return a part that an entry must have; SceneError where it is missing."""
    if key not in entry:
        raise SceneError(f"it has no {key}")
    return entry[key]


def table(entry: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Return a part that is an object, {} where it is missing; SceneError for anything else."""
    part = entry.get(key, {})
    if not isinstance(part, dict):
        raise SceneError(f"its {key} is {shown(str(part))}, not an object")
    return part


def rows(entry: Mapping[str, Any], key: str) -> list[Any]:
    """Return a part that is a list, [] where it is missing; SceneError for anything else."""
    part = entry.get(key, [])
    if not isinstance(part, list):
        raise SceneError(f"its {key} is {shown(str(part))}, not a list")
    return part


def count_of(entry: Mapping[str, Any], key: str, default: int | None = None) -> int:
    """Return a part that is a number of elements or bytes; SceneError for anything else."""
    part = needed(entry, key) if default is None else entry.get(key, default)
    if not is_whole(part, 0):
        raise SceneError(f"its {key} is {shown(str(part))}, not a whole number from 0 on")
    return part


def number_of(entry: Mapping[str, Any], key: str, default: float) -> float:
    """Return a part that is a finite number; SceneError for anything else."""
    return _finite(entry.get(key, default), key)


def numbers_of(entry: Mapping[str, Any], key: str, default: Sequence[float]) -> list[float]:
    """Return a part that is a list of finite numbers, as many as the default has; SceneError for anything else."""
    part = entry.get(key, default)
    if not isinstance(part, list | tuple) or len(part) != len(default):
        raise SceneError(f"its {key} is {shown(str(part))}, not {len(default)} numbers")
    return [_finite(value, key) for value in part]


def _finite(value: Any, key: str) -> float:
    number = None if isinstance(value, bool) else one_float(value)
    if number is None or not math.isfinite(number):
        raise SceneError(f"its {key} has {shown(str(value))}, which is not a finite number")
    return number


def reason_of(error: BaseException) -> str:
    """Return the cause of a fault that a reader met: the words of our own errors, and no others."""
    if isinstance(error, SceneError):
        return str(error)
    return f"it lacks {error}" if isinstance(error, KeyError) else "a part of it is of the wrong kind"
