"""Checks of a mesh file's contents against its header, made before a library reads the file.

Stage: scene description. Takes a file's bytes, gives bytes that trimesh reads as they are meant: ASCII texts without a
byte-order mark. Raises SceneError, without the file's name, for faults that trimesh would ignore or report with a wrong
cause.

>>> text_of("v 0 0 1".encode("utf-8-sig"))
'v 0 0 1'
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterator
from typing import Final

from raytracer.errors import SceneError

_MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
_STL_HEAD, _STL_TRIANGLE = 84, 50
_PLY_BYTES: Final = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8, "float64": 8,
}  # fmt: skip


def text_of(data: bytes) -> str:
    """Decode a text: UTF-8 or UTF-16 with a byte-order mark, UTF-8, or else Latin-1."""
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return data[len(mark) :].decode(encoding, "replace")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def stl(data: bytes) -> bytes:
    """Check an STL file, which is binary with as many triangles as it declares, or text; return what trimesh takes."""
    count = int.from_bytes(data[80:_STL_HEAD], "little") if len(data) >= _STL_HEAD else 0
    if len(data) >= _STL_HEAD and len(data) == _STL_HEAD + _STL_TRIANGLE * count:
        return data
    text = text_of(data)
    if text.lstrip()[:5].lower() == "solid" and "facet" in text:
        return _ascii(text)
    if len(data) < _STL_HEAD:
        raise SceneError(f"it ends within the header: {len(data)} bytes of {_STL_HEAD}")
    if len(data) < _STL_HEAD + _STL_TRIANGLE * count:
        raise SceneError(
            f"it declares {count:,} triangles and ends within number {(len(data) - _STL_HEAD) // _STL_TRIANGLE + 1:,}"
        )
    return data[: _STL_HEAD + _STL_TRIANGLE * count]


def ply(data: bytes) -> bytes:
    """Check a PLY file, which has at least as many elements as its header declares; return what trimesh takes."""
    if data.startswith(tuple(mark for mark, _ in _MARKS)):
        data = _ascii(text_of(data))
    found = re.search(rb"end_header[ \t]*\r?\n", data)
    if not data.startswith(b"ply") or found is None:
        raise SceneError("it has no PLY header that ends")
    head, body = data[: found.end()], data[found.end() :]
    head = bytes(byte if byte < 128 else ord("?") for byte in head)
    declared = list(_elements(head.decode("ascii")))
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
    return head + body


def _elements(head: str) -> Iterator[tuple[str, int, int]]:
    """Yield name, number and least size in bytes of the elements that a header declares."""
    name, count, size = "", 0, 0
    for words in map(str.split, head.splitlines()):
        if words[:1] == ["element"]:
            if name:
                yield name, count, size
            if len(words) != 3 or not (words[2].isascii() and words[2].isdigit()):
                given = " ".join(words[1:])[:60]
                raise SceneError(f"an element in its header is {given!r} instead of a name and a number")
            name, count, size = words[1], int(words[2]), 0
        elif words[:1] == ["property"] and len(words) > 1:
            size += _PLY_BYTES.get(words[2] if words[1] == "list" and len(words) > 2 else words[1], 1)
    if name:
        yield name, count, size


def off(data: bytes) -> bytes:
    """Return an OFF file as trimesh takes it."""
    return _ascii(text_of(data))


def _ascii(text: str) -> bytes:
    return text.encode("ascii", "replace")


READABLE: Final[dict[str, Callable[[bytes], bytes]]] = {".stl": stl, ".ply": ply, ".off": off}
"""By ending: gives a file's contents as trimesh takes them. OBJ, GLB and glTF have readers of their own."""
