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
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from raytracer.arrays import whole
from raytracer.errors import SceneError
from raytracer.meshes.folder import Notices

_MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
_STL_HEAD, _STL_TRIANGLE = 84, 50


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


READABLE: Final[dict[str, Callable[[bytes, Notices], bytes]]] = {".stl": stl, ".off": off}
"""By ending: gives a file's contents as trimesh takes them. OBJ, GLB and glTF have readers of their own."""
