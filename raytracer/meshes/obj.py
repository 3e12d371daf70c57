"""Wavefront OBJ files and their libraries of materials, MTL.

Stage: scene description. It is read here and not by trimesh, which takes a negative number for one from the end of the
file where it counts back from the face, drops the colours of vertices that have uv coordinates, and merges objects.
A part is what stands under one name of `o`, or else of `g`, and has one material. Numbers are checked as they are read,
so that an error names its line.

    obj = read_obj(text_of(data))
    looks = read_mtl(text_of(folder.read(obj.libraries[0])))
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.textures import decoded
from raytracer.arrays import real, whole
from raytracer.errors import SceneError
from raytracer.meshes.mesh import Mesh

Words = dict[str, list[str]]
"""The statements of a material, by their names in lower case: what follows the name."""
Rows = list[list[float]]
Faces = list[tuple[int, list[tuple[int, int, int]]]]
"""The line of each face, and the places of the vertex, texture vertex and normal of each corner."""
_KINDS: Final = ("vertex", "texture vertex", "normal")
_SKIPPED: Final = {
    "l": "lines", "p": "points", "curv": "free-form curves", "curv2": "free-form curves", "surf": "free-form surfaces",
}  # fmt: skip
_WITHOUT_SHAPE: Final = frozenset(
    "s mg lod bevel c_interp d_interp shadow_obj trace_obj ctech stech usemap maplib "
    "vp cstype deg bmat step parm trim hole scrv sp end con".split()
)
"""Statements that add no shape: those of looks, and those that belong to free-form curves and surfaces."""
_OPTIONS: Final = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2}
"""Options of a picture that take numbers, up to so many; the others take one word."""


class Part(NamedTuple):
    """The name of an object and the name of its material, None where it has none."""

    name: str
    material: str | None


@dataclass
class Obj:
    """The contents of an OBJ file: `numbers` of its vertices, texture vertices and normals, and its faces by part.

    Of a corner without a texture vertex or normal, that place is -1.
    """

    numbers: tuple[Rows, Rows, Rows] = field(default_factory=lambda: ([], [], []))
    faces: dict[Part, Faces] = field(default_factory=dict)
    libraries: list[str] = field(default_factory=list)
    skipped: Counter[str] = field(default_factory=Counter)

    def meshes(self, default: str) -> Iterator[tuple[Part, Mesh]]:
        """Return the parts as meshes of the default material, unnamed ones named `default`; faces are fans."""
        vertices, textures, normals = self.numbers
        places, colors = _split(vertices)
        uv, across = _table(textures, 2), _table(normals, 3)  # once for all parts, of which there may be many
        for part, faces in self.faces.items():
            corners = np.array(
                [(c[0], c[k], c[k + 1]) for _, c in faces for k in range(1, len(c) - 1)], dtype=np.int64
            ).reshape(-1, 3, 3)
            lines = [line for line, c in faces for _ in range(len(c) - 2)]
            for column, known in enumerate(self.numbers):
                _check(corners[..., column], lines, len(known), _KINDS[column])
            used, triangles = np.unique(corners[..., 0], return_inverse=True)
            yield (
                part,
                Mesh(
                    places[used],
                    triangles.reshape(-1, 3),
                    _rows(across, corners[..., 2]),
                    None if colors is None else colors[used],
                    name=part.name or default,
                    uv=_rows(uv, corners[..., 1]),
                ),
            )


def read_obj(text: str) -> Obj:
    """Read the statements of a file; SceneError, with the line, for an invalid number or face."""
    obj = Obj()
    kinds = {"v": 0, "vt": 1, "vn": 2}
    name = group = ""
    material: str | None = None
    faces: Faces | None = None
    for number, line in _statements(text):
        words = line.split()
        if not words:
            continue
        key = words[0]
        if key in kinds:
            obj.numbers[kinds[key]].append(_floats(words, number))
        elif key == "f":
            if faces is None:
                faces = obj.faces.setdefault(Part(name or group, material), [])
            faces.append((number, _corners(words[1:], number, obj.numbers)))
        elif key in ("o", "g", "usemtl"):
            said, faces = line[len(key) :].strip(), None
            if key == "o":
                name = said
            elif key == "g":
                group = said
            else:
                material = said
        elif key == "mtllib":
            obj.libraries.append(line[len(key) :].strip())
        elif key in _SKIPPED:
            obj.skipped[_SKIPPED[key]] += 1
        elif key not in _WITHOUT_SHAPE:
            obj.skipped[f"unknown statements {key}"] += 1
    return obj


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield each statement and the number of its first line; a backslash at the end of a line continues it."""
    first, parts = 1, []
    for number, line in enumerate(text.splitlines(), 1):
        said = _said(line)
        parts.append(said.removesuffix("\\"))
        if not said.endswith("\\"):
            yield first, " ".join(parts).strip()
            first, parts = number + 1, []
    yield first, " ".join(parts)


def _said(line: str) -> str:
    """Return a line without its comment; a name may have a # in it."""
    return re.split(r"(?:^|\s)#", line, maxsplit=1)[0].strip() if "#" in line else line.strip()


def _floats(words: list[str], line: int) -> list[float]:
    what, least = {"v": ("vertex", 3), "vt": ("texture vertex", 1), "vn": ("normal", 3)}[words[0]]
    try:
        found = [real(word) for word in words[1:]]
    except ValueError:
        raise SceneError(f"line {line}: a {what} has a coordinate that is no number") from None
    if len(found) < least:
        need = "three coordinates" if least == 3 else "a coordinate"
        raise SceneError(f"line {line}: a {what} has {need}, not {len(found)}")
    if not math.isfinite(sum(found)) and not all(map(math.isfinite, found)):
        raise SceneError(f"line {line}: a {what} has a coordinate that is not finite")
    return found


def _corners(words: list[str], line: int, numbers: tuple[Rows, ...]) -> list[tuple[int, int, int]]:
    """Return three indices for each corner of a face: vertex, texture vertex and normal.

    They begin at 0; -1 stands for a texture vertex or normal that the file leaves out.
    """
    if len(words) < 3:
        raise SceneError(f"line {line}: a face has at least three vertices, not {len(words)}")
    found = []
    for word in words:
        places = [-1, -1, -1]
        for column, part in enumerate(word.split("/")[:3]):
            if column and not part:
                continue
            try:
                place = whole(part)
            except ValueError:
                raise SceneError(f"line {line}: {word[:40]!r} in a face is no vertex number") from None
            if place == 0:
                raise SceneError(f"line {line}: a face names {_KINDS[column]} 0; numbers begin at 1")
            if place < -len(numbers[column]):
                raise _beyond(line, _KINDS[column], place, len(numbers[column]))
            places[column] = place - 1 if place > 0 else len(numbers[column]) + place
        found.append((places[0], places[1], places[2]))
    return found


def _check(places: NDArray[np.int64], lines: list[int], count: int, kind: str) -> None:
    """Raise SceneError for the first triangle (T, 3) with a corner that names a missing vertex."""
    wrong = np.argwhere(places >= count)
    if len(wrong):
        row, column = wrong[0]
        raise _beyond(lines[row], kind, int(places[row, column]) + 1, count)


def _beyond(line: int, kind: str, number: int, count: int) -> SceneError:
    return SceneError(f"line {line}: a face names {kind} {number}, and there are {count}")


def _split(vertices: Rows) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Return positions (V, 3) and linear colours (V, 3), None if no vertex has a colour.

    MeshLab and ZBrush write a vertex's colour in sRGB after its position; a vertex without one is white. Where one is
    above 2, some program has written all of them as bytes.
    """
    places = np.array([v[:3] for v in vertices], dtype=np.float64).reshape(-1, 3)
    if not any(len(v) >= 6 for v in vertices):
        return places, None
    white = 255.0 if max(max(v[3:6]) for v in vertices if len(v) >= 6) > 2 else 1.0
    colors = np.array([v[3:6] if len(v) >= 6 else (white, white, white) for v in vertices])
    return places, decoded(np.clip(colors / white, 0, 1))


def _table(numbers: Rows, width: int) -> NDArray[np.float64]:
    """Return numbers as rows (N + 1, width); the last row, of place -1, is zeros."""
    table = np.zeros((len(numbers) + 1, width))
    if numbers:
        table[:-1] = [(*row, 0.0)[:width] for row in numbers]
    return table


def _rows(table: NDArray[np.float64], places: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Return the rows of a table at the corners (T, 3) of triangles; None if no corner has one.

    The table's last row is zeros: a corner with the index -1 reads it.
    """
    return table[places] if (places >= 0).any() else None


def read_mtl(text: str) -> dict[str, Words]:
    """Read the materials of a library by name; of a statement that comes twice, the last one counts."""
    found: dict[str, Words] = {}
    current: Words = {}
    for line in text.splitlines():
        line = _said(line)
        words = line.split()
        if words[:1] == ["newmtl"]:
            current = found.setdefault(line[len("newmtl") :].strip(), {})
        elif words:
            current[words[0].lower()] = words[1:]
    return found


class PictureWords(NamedTuple):
    """The file of a picture in a statement of an MTL file, and its options by name."""

    file: str
    options: dict[str, list[str]]


def picture_words(words: list[str]) -> PictureWords:
    """Split the words of a statement such as map_Kd into options and a file, whose name may have spaces."""
    options: dict[str, list[str]] = {}
    at = 0
    while at < len(words) - 1 and words[at].startswith("-"):
        option = words[at]
        end = at + 2
        while end - at <= _OPTIONS.get(option, 1) and end < len(words) - 1 and _is_number(words[end]):
            end += 1
        options[option] = words[at + 1 : end]
        at = end
    return PictureWords(" ".join(words[at:]), options)


def _is_number(word: str) -> bool:
    try:
        real(word)
    except ValueError:
        return False
    return True
