"""Faces of a PLY file as triangles, since trimesh mixes faces of several numbers of corners only in a few files.

Stage: scene description. Takes a file's header and body, gives those of a file in which fans of triangles replace
faces, each with the properties of its face, such as colours. A list of two numbers for each corner, such as MeshLab's
`texcoord`, goes with the corners.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

TYPES: Final = {
    "char": "b", "uchar": "B", "int8": "b", "uint8": "B", "short": "h", "ushort": "H", "int16": "h", "uint16": "H",
    "int": "i", "uint": "I", "int32": "i", "uint32": "I", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip
"""The types of PLY's properties, as `struct` calls them."""
Face = list[list[bytes]]
"""The numbers of each property of a face, as the file has them."""
_PAIRS = 2
"""Numbers of a corner in a list that goes with the corners."""


class _Property(NamedTuple):
    """A property of faces: the types of its numbers, and of a list's length, which is "" where it is not a list."""

    kind: str
    length: str = ""
    is_corners: bool = False

    @classmethod
    def of(cls, words: Sequence[str]) -> _Property:
        """Return the property that a line of the header declares."""
        if words[1] != "list":
            return cls(TYPES.get(words[1], "B"))
        length, kind = (TYPES.get(word, "B") for word in words[2:4])
        return cls(kind, length, words[-1].startswith("vert"))


class _Layout(NamedTuple):
    """The faces of a file: their properties, number and order of bytes, "" in a text."""

    properties: list[_Property]
    number: int
    order: str

    def read(self, body: bytes, at: int) -> tuple[Face, int] | None:
        """Read the face at a place of a binary body; return it and where it ends, None where the body ends."""
        face = []
        for kind, length, _ in self.properties:
            number = 1
            if length:
                step = struct.calcsize(f"={length}")
                if at + step > len(body):
                    return None
                number, at = max(0, int(struct.unpack_from(f"{self.order}{length}", body, at)[0])), at + step
            width = struct.calcsize(f"={kind}")
            if at + number * width > len(body):
                return None
            face.append([body[place : place + width] for place in range(at, at + number * width, width)])
            at += number * width
        return face, at

    def split(self, line: bytes) -> Face | None:
        """Split a line of a text; return None where it has too few words."""
        words, at, face = line.split(), 0, []
        for _, length, _ in self.properties:
            number = 1
            if length:
                number, at = int(words[at]) if words[at:] and words[at].isdigit() else len(words), at + 1
            face.append(words[at : at + number])
            at += number
        return face if at <= len(words) else None

    def written(self, face: Face) -> bytes:
        """Return a face as a file of this layout has it."""
        made = []
        for part, held in zip(face, self.properties, strict=True):
            if held.length:
                number = len(part)
                made.append(struct.pack(f"{self.order}{held.length}", number) if self.order else b"%d" % number)
            made += part
        return b"".join(made) if self.order else b" ".join(made) + b"\n"

    @property
    def corners(self) -> int:
        """The place of the list of corners among the properties."""
        return next(k for k, held in enumerate(self.properties) if held.is_corners)

    def is_uniform(self, body: bytes, at: int) -> bool:
        """Return whether all faces of a binary body have lists of the lengths that the first one has."""
        first = self.read(body, at)
        if first is None:
            return False
        face, end = first
        if len(body) < at + self.number * (end - at):
            return False
        rows = np.frombuffer(body, np.uint8, self.number * (end - at), at).reshape(self.number, end - at)
        place = 0
        for part, (kind, length, _) in zip(face, self.properties, strict=True):
            size = struct.calcsize(f"={length}") if length else 0
            if not (rows[:, place : place + size] == rows[0, place : place + size]).all():
                return False
            place += size + len(part) * struct.calcsize(f"={kind}")
        return True

    def faces(self, body: bytes, at: int) -> tuple[list[Face], int] | None:
        """Read all faces of a binary body, and where they end; None where it ends before."""
        found = []
        for _ in range(self.number):
            read = self.read(body, at)
            if read is None:
                return None
            face, at = read
            found.append(face)
        return found, at


def as_triangles(head: bytes, body: bytes, declared: Sequence[tuple[str, int, int]]) -> bytes:
    """Return a PLY file in which fans of triangles replace faces, if trimesh does not read these as they are.

    `declared` are name, number and size of each element. trimesh takes the number of corners of a binary file's first
    face for that of all, and does not divide the properties of faces. A file stays as it is if elements before its
    faces have lists, or if faces have lists that do not go with their corners.
    """
    text = head.decode("ascii")
    before, _, rest = text.partition("element face")
    lines = [line.split() for line in rest.partition("element ")[0].splitlines() if line.startswith("property")]
    properties = [_Property.of(words) for words in lines]
    if "property list" in before or sum(held.is_corners for held in properties) != 1:
        return head + body
    number = [name for name, _, _ in declared].index("face")
    form = re.search(r"^format[ \t]+(ascii|binary_big)", text, re.MULTILINE)
    order = "<" if form is None else ">" if form[1] == "binary_big" else ""
    layout = _Layout(properties, declared[number][1], order)
    parts = _in_text(layout, body, declared[:number]) if not order else _in_bytes(layout, body, declared[:number])
    if parts is None or not all(_goes_with_corners(face, layout) for face in parts[1]):
        return head + body
    start, faces, end = parts
    made = [layout.written(fan) for face in faces for fan in _fans(face, layout)]
    renamed = re.sub(r"element(\s+)face(\s+)\d+", rf"element\g<1>face\g<2>{len(made)}", text)
    return renamed.encode("ascii") + start + b"".join(made) + end


def _in_text(
    layout: _Layout, body: bytes, before: Sequence[tuple[str, int, int]]
) -> tuple[bytes, list[Face], bytes] | None:
    """Return what is before the faces, the faces, and what follows; None where trimesh reads them as they are."""
    if len(layout.properties) == 1:
        return None
    lines = [line + b"\n" for line in body.splitlines() if line.strip()]
    first = sum(count for _, count, _ in before)
    faces = [layout.split(line) for line in lines[first : first + layout.number]]
    read = [face for face in faces if face is not None]
    if len(read) < layout.number or all(len(face[layout.corners]) == 3 for face in read):
        return None
    return b"".join(lines[:first]), read, b"".join(lines[first + layout.number :])


def _in_bytes(
    layout: _Layout, body: bytes, before: Sequence[tuple[str, int, int]]
) -> tuple[bytes, list[Face], bytes] | None:
    """Return what is before the faces, the faces, and what follows; None where trimesh reads them as they are."""
    begin = sum(count * size for _, count, size in before)
    first = layout.read(body, begin) if layout.number else None
    if first is None:
        return None
    simple = len(layout.properties) == 1 or len(first[0][layout.corners]) == 3
    if simple and layout.is_uniform(body, begin):
        return None
    found = layout.faces(body, begin)
    return None if found is None else (body[:begin], found[0], body[found[1] :])


def _goes_with_corners(face: Face, layout: _Layout) -> bool:
    """Return whether each list of a face beside its corners has a pair of numbers for each of them."""
    count = len(face[layout.corners])
    lists = [part for part, held in zip(face, layout.properties, strict=True) if held.length and not held.is_corners]
    return all(len(part) == _PAIRS * count for part in lists)


def _fans(face: Face, layout: _Layout) -> Iterator[Face]:
    """Yield the triangles of a face about its first corner."""
    for k in range(1, len(face[layout.corners]) - 1):
        triangle = []
        for part, held in zip(face, layout.properties, strict=True):
            width = 1 if held.is_corners else _PAIRS
            places = [width * c + x for c in (0, k, k + 1) for x in range(width)]
            triangle.append([part[place] for place in places] if held.length else part)
        yield triangle
