"""The statements of a Wavefront OBJ file as arrays.

Stage: scene description. Numbers are read in blocks of lines, each kind of statement at once. Bad entries are left out
and counted. `obj` makes meshes of the arrays.

    statements = read_statements(data, notices)
    statements.tables[0]        # its vertices
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.meshes.folder import Fault, Notices, shown
from raytracer.meshes.lines import (
    SLASH,
    SPACE,
    Bytes,
    Floats,
    Ints,
    blocks,
    line_begins,
    lines_of,
    name_of,
    numbers_in,
    plain,
    whole_numbers,
    without_comment,
    without_indents,
    word_begins,
)  # fmt: skip
from raytracer.meshes.polygons import (
    AT_BROKEN,
    BROKEN,
    COLOR_BROKEN,
    ILLEGIBLE,
    NORMAL_BROKEN,
    SMALL,
    UV_BROKEN,
    Mask,
    faces_of,
)

Indices = NDArray[np.int32]
MISSING, BAD = -1, -2
"""The index of a corner's texture vertex or normal where it has none, and of one that the file lacks."""
ANGLE: Final = -1
"""The smoothing group of faces in a file that names none: the angles between faces say where it is smooth."""
_WORDS: Final = ("vertex", "texture vertex", "normal")
_FACES, _OTHER, _EMPTY = 3, 4, 5
"""Kinds of lines beside those of `_WORDS`."""
_LACKING: Final = [
    Fault(f"face names a {kind} that the file lacks", f"faces name a {kind} that the file lacks") for kind in _WORDS
]
_BROKEN: Final = (BROKEN, UV_BROKEN, NORMAL_BROKEN)
_SKIPPED: Final = {
    b"l": "lines", b"p": "points", b"curv": "free-form curves", b"curv2": "free-form curves",
    b"surf": "free-form surfaces",
}  # fmt: skip
_WITHOUT_SHAPE: Final = frozenset(
    b"mg lod bevel c_interp d_interp shadow_obj trace_obj ctech stech usemap maplib "
    b"vp cstype deg bmat step parm trim hole scrv sp end con".split()
)
"""Statements that add no shape: those of looks, and those that belong to free-form curves and surfaces."""
_NAMES: Final = (b"o", b"g", b"usemtl", b"mtllib")
"""Statements of names, which may end with the byte of a backslash, as in Shift-JIS: they have one line each."""


class Part(NamedTuple):
    """The name of an object and the name of its material, None where it has none."""

    name: str
    material: str | None


class State(NamedTuple):
    """The part and the smoothing group of the faces that follow; group 0 is flat."""

    part: Part
    group: int


@dataclass
class Statements:
    """The contents of a file.

    `tables` are its vertices, (V, 3) or (V, 6) with colours, texture vertices (N, 2) and normals (N, 3). Those that are
    left out are NaN, and so are colours that are not there. `corners` (C, 3) are the indices of these for each corner
    of the faces, `sizes` (F,) the numbers of corners and `lines` (F,) the lines of the faces. `states` hold from the
    face on that stands before each.
    """

    tables: list[Floats]
    corners: Indices
    sizes: Ints
    lines: Ints
    states: list[tuple[int, State]]
    libraries: list[str]


def read_statements(data: bytes, notices: Notices) -> Statements:
    """Read a file; count bad entries and unknown statements in `notices`."""
    reader = _Reader(notices)
    for block in blocks(_continued(plain(data))):
        reader.read(block)
    return reader.statements()


class _Faces(NamedTuple):
    """The faces of a block: `legible` says which consist of indices alone."""

    corners: Indices
    sizes: Ints
    lines: Ints
    legible: Mask


class _Reader:
    """The statements that were read so far."""

    def __init__(self, notices: Notices) -> None:
        self.notices = notices
        self.tables: tuple[list[Floats], ...] = ([], [], [])
        self.counts = np.zeros(3, np.int64)
        self.faces: list[_Faces] = []
        self.face_count, self.line = 0, 1
        self.object = self.group = ""
        self.material: str | None = None
        self.smoothing = ANGLE
        self.states = [(0, State(Part("", None), ANGLE))]
        self.libraries: list[str] = []
        self.causes: dict[int, str] = {}
        """The cause of the first bad index, by column, and of the first word that is not an index."""

    def read(self, block: bytes) -> None:
        """Read a block of lines."""
        number = block.count(b"\n")
        block = without_indents(_without_comments(block))
        text = np.frombuffer(block, np.uint8)
        begins = line_begins(text)
        ends, kinds = np.append(begins[1:], len(text)), _kinds(text, begins)
        for kind in range(3):
            chosen = np.flatnonzero(kinds == kind)
            if len(chosen):
                self._read_numbers(kind, block, *_gathered(text, begins, chosen, kind), chosen)
        chosen = np.flatnonzero(kinds == _FACES)
        if len(chosen):
            before = np.stack([np.cumsum(kinds == kind)[chosen] for kind in range(3)], axis=1) + self.counts
            self._read_faces(*_gathered(text, begins, chosen, _FACES), chosen, before)
        others = np.flatnonzero(kinds == _OTHER)
        for line, place in zip(others.tolist(), np.searchsorted(chosen, others).tolist(), strict=True):
            self._read_statement(block[begins[line] : ends[line]].strip(), self.face_count + place)
        self.counts += [int((kinds == kind).sum()) for kind in range(3)]
        self.face_count += len(chosen)
        self.line += number

    def _read_numbers(self, kind: int, block: bytes, text: Bytes, begins: Ints, lines: Ints) -> None:
        numbers = numbers_in(text, begins)
        colored = numbers.counts >= 6
        wide = kind == 0 and bool(colored.any())
        rows = numbers.rows(6 if wide else 2 if kind == 1 else 3)
        if kind == 1:
            rows[numbers.counts == 1, 1] = 0  # a texture of one dimension has no v
        if wide:
            rows[~colored, 3:] = np.nan
            odd = colored & ~np.isfinite(rows[:, 3:]).all(axis=1)
            self._leave_out(COLOR_BROKEN, odd, block, lines)
            rows[odd, 3:] = np.nan
        broken = ~np.isfinite(rows[:, :3]).all(axis=1)
        self._leave_out(_BROKEN[kind], broken, block, lines)
        rows[broken] = np.nan
        self.tables[kind].append(rows)

    def _leave_out(self, fault: Fault, broken: Any, block: bytes, lines: Ints) -> None:
        """Count broken lines; `lines` are their places in the block."""
        places = np.flatnonzero(broken)
        if len(places):
            line = int(lines[places[0]])
            text = shown(name_of(block.split(b"\n", line + 1)[line]))
            self.notices.leave_out(fault, len(places), f"line {self.line + line}", f"a {fault.one}: {text!r}")

    def _read_faces(self, text: Bytes, begins: Ints, lines: Ints, before: Ints) -> None:
        """Read faces; `before` (F, 3) are the numbers of vertices, texture vertices and normals before each."""
        is_word = word_begins(text)
        sizes, words = np.add.reduceat(is_word, begins, dtype=np.int64), np.flatnonzero(is_word)
        face = np.repeat(np.arange(len(sizes)), sizes)
        indices, legible_words = _indices(text, is_word, words)
        legible = np.ones(len(sizes), bool)
        legible[face[~legible_words]] = False
        if not legible.all() and _FACES not in self.causes:
            word = text[words[np.argmin(legible_words)] :].tobytes().split(None, 1)[0]
            self.causes[_FACES] = f"{shown(name_of(word))!r} in a face is not an index"
        numbers = indices - 1
        for kind in range(3):
            column, there = indices[:, kind], indices[:, kind] != _ABSENT
            back = there & (column < 0)
            if back.any():
                numbers[back, kind] = (column + before[face, kind])[back]
            wrong = there & ((column == 0) | (numbers[:, kind] < 0)) & legible[face]
            if wrong.any() and kind not in self.causes:
                row = int(np.argmax(wrong))
                self.causes[kind] = _cause(kind, int(column[row]), int(before[face[row], kind]))
            numbers[there & ((column == 0) | (numbers[:, kind] < 0)), kind] = BAD
            numbers[~there, kind] = MISSING
        self.faces.append(_Faces(np.minimum(numbers, _FARTHEST).astype(np.int32), sizes, self.line + lines, legible))

    def _read_statement(self, line: bytes, faces: int) -> None:
        """Read a statement of names or states, which stands after the first `faces` faces."""
        key = line.split(None, 1)[0]
        argument = name_of(line[len(key) :].strip())
        if key == b"mtllib":
            self.libraries.append(name_of(line[len(key) + 1 :]))
        elif key in _SKIPPED:
            self.notices.ignore(_SKIPPED[key])
        elif key not in _STATES and key not in _WITHOUT_SHAPE:
            self.notices.ignore(f"unknown statements {name_of(key)}")
        if key not in _STATES:
            return
        setattr(self, _STATES[key], _group(argument) if key == b"s" else argument)
        self.states.append((faces, State(Part(self.object or self.group, self.material), self.smoothing)))

    def statements(self) -> Statements:
        """Return what was read, without the faces that are left out."""
        tables = [_stacked(rows, width) for rows, width in zip(self.tables, (3, 2, 3), strict=True)]
        empty = _Faces(np.zeros((0, 3), np.int32), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, bool))
        faces = _Faces(*map(np.concatenate, zip(empty, *self.faces, strict=True)))
        self.faces = []
        kept = self._kept(tables, faces)
        corners, sizes, lines, states = faces.corners, faces.sizes, faces.lines, self.states
        if not kept.all():
            corners, places = corners[np.repeat(kept, sizes)], np.append(0, np.cumsum(kept)).tolist()
            sizes, lines = sizes[kept], lines[kept]
            states = [(places[begin], state) for begin, state in states]
        if self.smoothing != ANGLE:  # the specification's state before the first group is `s off`
            states = [(begin, State(state.part, max(state.group, 0))) for begin, state in states]
        return Statements(tables, corners, sizes, lines, states, self.libraries)

    def _kept(self, tables: list[Floats], faces: _Faces) -> Mask:
        """Return which faces stay; the indices of corners that the file lacks, or that are left out, become BAD."""
        face = np.repeat(np.arange(len(faces.sizes)), faces.sizes)
        kept = faces.legible & (faces.sizes >= 3)
        self._leave_out_faces(ILLEGIBLE, ~faces.legible, faces, self.causes.get(_FACES, ""))
        self._leave_out_faces(SMALL, faces.legible & ~kept, faces)
        for column, table in enumerate(tables):
            index = faces.corners[:, column]
            beyond = index >= len(table)
            lacking = faces_of(beyond | (index == BAD), face, len(kept)) & kept
            if lacking.any():
                own = index[face == np.argmax(lacking)]
                past = own[own >= len(table)]
                cause = self.causes[column] if BAD in own else _cause(column, int(past[0]) + 1, len(table))
                self._leave_out_faces(_LACKING[column], lacking, faces, cause)
            index[beyond] = BAD
            broken = np.append(np.isnan(table[:, 0]), [False, False])  # the last two are those of BAD and MISSING
            if broken.any():
                at_broken = broken[index]
                index[at_broken] = BAD
                if column == 0:
                    self._leave_out_faces(AT_BROKEN, faces_of(at_broken, face, len(kept)) & kept & ~lacking, faces)
            if column == 0:
                kept &= ~faces_of(index == BAD, face, len(kept))
        return kept

    def _leave_out_faces(self, fault: Fault, wrong: Mask, faces: _Faces, cause: str = "") -> None:
        if wrong.any():
            self.notices.leave_out(fault, int(wrong.sum()), f"line {faces.lines[np.argmax(wrong)]}", cause)


_STATES: Final = {b"o": "object", b"g": "group", b"usemtl": "material", b"s": "smoothing"}
"""The attribute of `_Reader` that a statement sets."""
_ABSENT: Final = np.iinfo(np.int64).min
_FARTHEST: Final = np.iinfo(np.int32).max


def _indices(text: Bytes, is_word: Mask, words: Ints) -> tuple[Ints, Mask]:
    """Return the three indices (N, 3) of each word of faces, `_ABSENT` where one is left out, and which are legible."""
    is_slash = text == SLASH
    inside = (text > SPACE) & ~is_slash
    first, last = inside.copy(), inside.copy()
    first[1:] &= ~inside[:-1]
    last[:-1] &= ~inside[1:]
    begins, slashes = np.flatnonzero(first), np.cumsum(is_slash, dtype=np.int32)
    values, is_whole = whole_numbers(text, begins, np.flatnonzero(last) + 1)
    word = np.cumsum(is_word, dtype=np.int32)[begins] - 1
    column = slashes[begins] - (slashes[words] - is_slash[words])[word]
    indices = np.full((len(words), 3), _ABSENT)
    read = column < 3
    indices[word[read], column[read]] = values[read]
    legible = indices[:, 0] != _ABSENT
    legible[word[read & ~is_whole]] = False
    return indices, legible


def _cause(kind: int, index: int, count: int) -> str:
    end = "0; numbers begin at 1" if index == 0 else f"{index}, and there are {count}"
    return f"a face names {_WORDS[kind]} {end}"


def _kinds(text: Bytes, begins: Ints) -> NDArray[np.uint8]:
    """Return the kind of each line, by its first three characters."""
    padded = np.append(text, np.zeros(2, np.uint8))
    first, second, third = (padded[begins + k] for k in range(3))
    kinds = np.full(len(begins), _OTHER, np.uint8)
    kinds[first <= SPACE] = _EMPTY
    kinds[(first == ord("f")) & (second <= SPACE)] = _FACES
    is_vertex = first == ord("v")
    kinds[is_vertex & (second <= SPACE)] = 0
    for kind, letter in ((1, "t"), (2, "n")):
        kinds[is_vertex & (second == ord(letter)) & (third <= SPACE)] = kind
    return kinds


def _gathered(text: Bytes, begins: Ints, chosen: Ints, kind: int) -> tuple[Bytes, Ints]:
    """Return the text of some lines, with spaces for their keywords, and where each of them begins in it."""
    characters, starts, _ = lines_of(text, begins, chosen)
    characters[starts] = SPACE
    if kind in (1, 2):
        characters[starts + 1] = SPACE
    return characters, starts


def _without_comments(block: bytes) -> bytes:
    if b"#" not in block:
        return block

    def cut(match: re.Match[bytes]) -> bytes:
        at = match.start()
        before = block[at - 1 : at] if at else b"\n"
        return without_comment(before + match[0])[1:]

    return re.sub(rb"#[^\n]*", cut, block)


def _continued(text: bytes) -> bytes:
    """Join each statement to the lines that continue it, which end with a backslash; empty lines follow it instead."""
    if re.search(rb"\\[ \t]*\n", text) is None:
        return text
    lines: list[bytes] = []
    parts: list[bytes] = []
    empty = 0
    for line in text.split(b"\n"):
        content = without_comment(line).rstrip()
        named = not parts and content.split(None, 1)[:1] and content.split(None, 1)[0] in _NAMES
        if content.endswith(b"\\") and not named:
            parts.append(content[:-1])
            empty += 1
            continue
        lines += [b" ".join([*parts, line]), *[b""] * empty]
        parts, empty = [], 0
    return b"\n".join([*lines, b" ".join(parts)])


def _group(argument: str) -> int:
    """Return the number of a smoothing group, 0 for `off` and for a word that is not a number."""
    word = argument.split()[:1]
    return int(word[0]) if word and word[0].isascii() and word[0].isdigit() and len(word[0]) < 10 else 0


def _stacked(rows: list[Floats], width: int) -> Floats:
    """Return blocks of rows as one table, all as wide as the widest; NaN for what is not there."""
    width = max([width, *(part.shape[1] for part in rows)])
    for k, part in enumerate(rows):
        if part.shape[1] < width:
            rows[k] = np.full((len(part), width), np.nan)
            rows[k][:, : part.shape[1]] = part
    return np.concatenate([np.zeros((0, width)), *rows])
