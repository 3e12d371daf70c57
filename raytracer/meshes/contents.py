"""Checks of a mesh file's contents against its header, made before a library reads the file.

Stage: scene description. Takes a file's bytes, gives bytes that trimesh reads as they are meant: ASCII texts without a
byte-order mark. Notes what the file holds that is not read. Raises SceneError, without the file's name, for faults that
trimesh would ignore or report with a wrong cause.

>>> text_of("v 0 0 1".encode("utf-8-sig"))
'v 0 0 1'
"""

from __future__ import annotations

import codecs
import re
import struct
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np

from raytracer.arrays import whole
from raytracer.errors import SceneError
from raytracer.meshes.folder import Notices
from raytracer.meshes.ply_faces import TYPES, as_triangles

_MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
_STL_HEAD, _STL_TRIANGLE = 84, 50
_PLY: Final = {
    "vertex": frozenset("x y z nx ny nz red green blue alpha texture_u texture_v u v s t".split()),
    "face": frozenset("vertex_index vertex_indices red green blue alpha texcoord texnumber".split()),
    "tristrips": frozenset(("vertex_index", "vertex_indices")),
}
"""The properties of each element of a PLY file that are read."""


def text_of(data: bytes) -> str:
    """Decode a text: UTF-8 or UTF-16 with a byte-order mark, UTF-8, or else Latin-1."""
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return data[len(mark) :].decode(encoding, "replace")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def stl(data: bytes, notices: Notices) -> bytes:
    """Check an STL file, which is binary with as many triangles as it declares, or text; return what trimesh takes."""
    count = int.from_bytes(data[80:_STL_HEAD], "little") if len(data) >= _STL_HEAD else 0
    if len(data) >= _STL_HEAD and len(data) == _STL_HEAD + _STL_TRIANGLE * count:
        return _binary_stl(data, count, notices)
    text = text_of(data)
    if text.lstrip()[:5].lower() == "solid" and "facet" in text.lower():
        return _ascii(text)
    if len(data) < _STL_HEAD:
        raise SceneError(f"it ends within the header: {len(data)} bytes of {_STL_HEAD}")
    if len(data) < _STL_HEAD + _STL_TRIANGLE * count:
        raise SceneError(
            f"it declares {count:,} triangles and ends within number {(len(data) - _STL_HEAD) // _STL_TRIANGLE + 1:,}"
        )
    return _binary_stl(data[: _STL_HEAD + _STL_TRIANGLE * count], count, notices)


def _binary_stl(data: bytes, count: int, notices: Notices) -> bytes:
    """Note how many triangles have attributes, in which some programs write colours."""
    rows = np.frombuffer(data, np.uint8, count * _STL_TRIANGLE, _STL_HEAD).reshape(count, _STL_TRIANGLE)
    notices.ignore("attributes of triangles", int(rows[:, -2:].any(axis=1).sum()))
    return data


def ply(data: bytes, notices: Notices) -> bytes:
    """Check a PLY file, which has at least as many elements as its header declares; return what trimesh takes."""
    if data.startswith(tuple(mark for mark, _ in _MARKS)):
        data = _ascii(text_of(data))
    found = re.search(rb"end_header[ \t]*\r?\n", data)
    if not data.startswith(b"ply") or found is None:
        raise SceneError("it has no PLY header that ends")
    head, body = data[: found.end()], data[found.end() :]
    head = bytes(byte if byte < 128 else ord("?") for byte in head)
    head = re.sub(rb"^(element[ \t]+edge)\b", rb"\1_", head, flags=re.MULTILINE)  # else trimesh makes a path of them
    declared = list(_elements(head.decode("ascii"), notices))
    if re.search(rb"^format[ \t]+ascii", head, re.MULTILINE):
        body = _ascii(text_of(body))
        there = sum(1 for line in body.splitlines() if line.strip())
        sizes = [(name, count, 1) for name, count, _ in declared]
        unit = "lines"
    else:
        there, sizes, unit = len(body), declared, "bytes"
    needed = sum(count * size for _, count, size in sizes)
    if needed > there:
        what = ", ".join(f"{count:,} of {name}" for name, count, _ in declared)
        raise SceneError(f"its header declares more than follows ({what}): at least {needed:,} {unit}, not {there:,}")
    return as_triangles(head, body, declared)


def _elements(head: str, notices: Notices) -> Iterator[tuple[str, int, int]]:
    """Yield name, number and least size in bytes of the elements that a header declares; note what is not read."""
    name, count, size = "", 0, 0
    for words in map(str.split, head.splitlines()):
        if words[:1] == ["element"]:
            if name:
                yield name, count, size
            if len(words) != 3 or not (words[2].isascii() and words[2].isdigit()):
                given = " ".join(words[1:])[:60]
                raise SceneError(f"an element in its header is {given!r} instead of a name and a number")
            name, count, size = words[1], int(words[2]), 0
            if name not in _PLY:
                notices.ignore(f"elements {name.removesuffix('_')}", count)
        elif words[:1] == ["property"] and len(words) > 1:
            kind = TYPES.get(words[2] if words[1] == "list" and len(words) > 2 else words[1], "B")
            size += struct.calcsize(f"={kind}")
            if words[-1] not in _PLY.get(name, words[-1:]):
                notices.ignore(f"{words[-1]} of each {name}", count)
    if name:
        yield name, count, size


class _Off(NamedTuple):
    """The parts of an OFF file: the letters before OFF in its first line, and the words of its vertices and faces."""

    letters: str
    vertices: list[list[str]]
    faces: list[list[str]]

    @classmethod
    def of(cls, data: bytes) -> _Off:
        """Split a file into its parts, as many as it declares."""
        lines = [words for line in text_of(data).splitlines() if (words := line.partition("#")[0].split())]
        found = re.fullmatch("((?:ST)?C?N?)OFF", lines[0][0]) if lines else None
        declared, *rest = [lines[0][1:], *lines[1:]] if found and len(lines[0]) > 1 else [*lines[1:], []]
        if found is None or len(declared) < 2 or not all(w.isascii() and w.isdigit() for w in declared[:2]):
            raise SceneError("it has no header: OFF, and then the numbers of its vertices and faces")
        vertices, faces = int(declared[0]), int(declared[1])
        there = sum(1 for line in rest if line)
        if there < vertices + faces:
            raise SceneError(f"it declares {vertices:,} vertices and {faces:,} faces, and {there:,} lines follow")
        return cls(found[1], rest[:vertices], rest[vertices : vertices + faces])


def off(data: bytes, notices: Notices) -> bytes:
    """Return an OFF file as trimesh takes it: fans of triangles replace faces, of which it mixes only small ones."""
    found = _Off.of(data)
    made = []
    for number, (count, *words) in enumerate(found.faces):
        corners = words[: whole(count)]
        if len(corners) < int(count):
            raise SceneError(f"face {number:,} has {count} corners, and {len(words)} numbers follow")
        made += [f"3 {corners[0]} {corners[k]} {corners[k + 1]}" for k in range(1, len(corners) - 1)]
        notices.ignore("colours of faces", int(len(words) > len(corners)))
    for letter, what in (("C", "colours"), ("N", "normals"), ("ST", "uv coordinates")):
        if letter in found.letters:
            notices.ignore(f"{what} of vertices", len(found.vertices))
    places = [" ".join(words[:3]) for words in found.vertices]
    text = "\n".join(["OFF", f"{len(places)} {len(made)} 0", *places, *made, ""])
    if "_" in text:
        raise SceneError("it has a number with a _ between its digits")
    return _ascii(text)


def _ascii(text: str) -> bytes:
    return text.encode("ascii", "replace")


READABLE: Final[dict[str, Callable[[bytes, Notices], bytes]]] = {".stl": stl, ".ply": ply, ".off": off}
"""By ending: gives a file's contents as trimesh takes them. OBJ, GLB and glTF have readers of their own."""
