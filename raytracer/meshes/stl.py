"""STL files, binary or text, as meshes without normals: one for each solid of a text.

Stage: scene description. The normals of the file are not read: they are those of its triangles.

    meshes = read_stl(data, "bolt", notices)
"""

from __future__ import annotations

import re
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError
from raytracer.meshes.folder import Fault, Notices
from raytracer.meshes.lines import (
    SPACE,
    Floats,
    Ints,
    line_begins,
    lines_of,
    name_of,
    numbers_in,
    plain,
    without_indents,
)
from raytracer.meshes.mesh import Mesh

_HEAD: Final = 84
_ROW: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_UNKNOWN: Final = (0, 0xFFFFFFFF)
"""The numbers of triangles that programs write which do not know it before they end."""
_BROKEN: Final = Fault("triangle has a corner that is not finite", "triangles have a corner that is not finite")
_COUNT: Final = Fault("facet has not three corners", "facets have not three corners")
_KEYWORDS: Final = rb"(?i)[ \t]+(vertex|outer|facet|endloop|endfacet|endsolid)\b"


def read_stl(data: bytes, default: str, notices: Notices) -> list[Mesh]:
    """Return the meshes of a file; SceneError for one that ends before the triangles that it declares."""
    count = int.from_bytes(data[80:_HEAD], "little") if len(data) >= _HEAD else 0
    if not (count and len(data) == _HEAD + _ROW.itemsize * count):
        text = plain(data)
        if text.lstrip()[:5].lower() == b"solid" and b"facet" in text.lower():
            return _of_text(text, default, notices)
    if len(data) < _HEAD:
        raise SceneError(f"it ends within the header: {len(data)} bytes of {_HEAD}")
    there, rest = divmod(len(data) - _HEAD, _ROW.itemsize)
    if count in _UNKNOWN:
        count = there
        if rest:
            notices.leave_out(_BROKEN, 1, f"triangle {there:,}", f"it ends within triangle {there:,}")
    if count > there:
        raise SceneError(f"it declares {count:,} triangles and ends within number {there + 1:,}")
    rows = np.frombuffer(data, _ROW, count, _HEAD)
    notices.ignore("attributes of triangles", int(np.count_nonzero(rows["attribute"])))
    corners = rows["corners"]
    finite = np.isfinite(corners).all(axis=(1, 2))
    if not finite.all():
        notices.leave_out(_BROKEN, int((~finite).sum()), f"triangle {int(np.argmin(finite)):,}")
        corners = corners[finite]
    return [_mesh(corners, default)]


def _of_text(text: bytes, default: str, notices: Notices) -> list[Mesh]:
    if text.lower().count(b"vertex") > text.count(b"\n"):  # all in one line, or nearly
        text = re.sub(_KEYWORDS, rb"\n\1", text)
    text = without_indents(text + b"\n")
    characters = np.frombuffer(text, np.uint8)
    begins = line_begins(characters)
    letter = characters[begins] | 32  # a letter in lower case
    second = np.append(characters, 0)[begins + 1] | 32
    facets = np.flatnonzero((letter == ord("f")) & (second == ord("a")))
    vertices = np.flatnonzero((letter == ord("v")) & (second == ord("e")))
    solids = np.flatnonzero((letter == ord("s")) & (second == ord("o")))
    places = _places(characters, begins, vertices)
    facet = np.searchsorted(facets, vertices) - 1
    counts = np.bincount(facet[facet >= 0], minlength=len(facets))
    wrong = counts != 3
    if wrong.any():
        notices.leave_out(_COUNT, int(wrong.sum()), f"line {facets[np.argmax(wrong)] + 1}")
    kept = (facet >= 0) & ~wrong[facet] if len(facets) else np.zeros(len(facet), bool)
    corners, owner = places[kept].reshape(-1, 3, 3), facet[kept][::3]
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(corners).all(axis=(1, 2)))
    if not finite.all():
        line = facets[owner[int(np.argmin(finite))]] + 1
        notices.leave_out(_BROKEN, int((~finite).sum()), f"line {line}")
        corners, owner = corners[finite], owner[finite]
    solid = np.searchsorted(solids, facets[owner]) - 1
    parts = [(_solid_name(text, int(begins[line])), corners[solid == number]) for number, line in enumerate(solids)]
    parts = [(name, own) for name, own in parts if len(own)]
    if len(parts) == 1:
        return [_mesh(parts[0][1], default)]
    names = [name or default for name, _ in parts]
    return [
        _mesh(own, f"{name}_{before}" if (before := names[:k].count(name)) else name)
        for k, (name, (_, own)) in enumerate(zip(names, parts, strict=True))
    ]


def _places(text: NDArray[np.uint8], begins: Ints, lines: Ints) -> Floats:
    """Return the numbers (N, 3) in lines of vertices."""
    if not len(lines):
        return np.zeros((0, 3))
    characters, starts, sizes = lines_of(text, begins, lines)
    for k in range(len("vertex")):
        at = starts[sizes > k + 1] + k
        characters[at] = np.where(characters[at] > SPACE, SPACE, characters[at])
    return numbers_in(characters, starts).rows(3)


def _solid_name(text: bytes, begin: int) -> str:
    """Return the name in a line that begins with `solid`."""
    words = text[begin : text.index(b"\n", begin)].split(None, 1)
    return name_of(words[1].strip()) if len(words) > 1 else ""


def _mesh(corners: Any, name: str) -> Mesh:
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), name=name)
