"""The elements of a PLY file as columns: text or binary, with lists in any element.

Stage: scene description. Takes a file's bytes, gives each property of each element as an array, or as `Lists`. Numbers
that a header declares are compared with the bytes that follow before memory is taken.

    file = read_elements(data)
    file.columns["vertex"]["x"]
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError
from raytracer.meshes.folder import shown
from raytracer.meshes.lines import Ints, line_begins, name_of, numbers_in, plain, word_begins

_TYPES: Final = {
    "char": "i1", "uchar": "u1", "int8": "i1", "uint8": "u1", "short": "i2", "ushort": "u2", "int16": "i2",
    "uint16": "u2", "int": "i4", "uint": "u4", "int32": "i4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


class Lists(NamedTuple):
    """The lists of all elements, one after the other: their numbers, and how many each has."""

    values: NDArray[Any]
    sizes: Ints


class Property(NamedTuple):
    """A property of an element: the types of its numbers, and of a list's length, "" where it is not a list."""

    name: str
    kind: str
    length: str


@dataclass
class Element:
    """The elements of a name: how many, and what each has."""

    name: str
    count: int
    properties: list[Property]

    @property
    def least(self) -> int:
        """The bytes of one element whose lists are empty."""
        return sum(int((part.length or part.kind)[1]) for part in self.properties)


class File(NamedTuple):
    """The contents of a file.

    `columns` have an array (n,) or `Lists` for each property of each element. `short` are the elements of a text whose
    lines end before their last number; of these, numbers are NaN and lists empty.
    """

    elements: list[Element]
    columns: dict[str, dict[str, Any]]
    short: dict[str, Ints]
    pictures: list[str]

    def kind(self, element: str, name: str) -> np.dtype[Any]:
        """Return the type that the header declares for a property; columns of a text are all float64."""
        (part,) = (part for part in self.elements if part.name == element)
        return np.dtype(next(each.kind for each in part.properties if each.name == name))


def read_elements(data: bytes) -> File:
    """Read a file; SceneError for a header that is malformed, and for elements that are not there."""
    if not data.startswith(b"ply"):
        data = plain(data)  # a byte-order mark, or UTF-16
    end = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    ending = end and re.search(rb"(?:\n|\r)end_header[ \t]*" + end[1], data)
    if ending is None:
        raise SceneError("it has no PLY header that ends")
    head, body = plain(data[: ending.end()]).decode("latin-1"), data[ending.end() :]
    elements = list(_elements(head))
    (name, times), *_ = Counter(part.name for part in elements).most_common(1) or [("", 0)]
    if times > 1:
        raise SceneError(f"its header has two elements named {shown(name)!r}")
    form = re.search(r"^format[ \t]+(\w+)", head, re.MULTILINE)
    if form is None or form[1] not in ("ascii", "binary_little_endian", "binary_big_endian"):
        label = shown(form[1]) if form else "missing"
        raise SceneError(f"its format is {label}: ascii, binary_little_endian and binary_big_endian are read")
    read = _in_text if form[1] == "ascii" else _in_bytes
    columns, short = read([part for part in elements if part.properties], body, ">" if "big" in form[1] else "<")
    names = re.findall(r"^comment[ \t]+TextureFile[ \t]+(\S.*?)[ \t]*$", head, re.MULTILINE | re.IGNORECASE)
    return File(elements, columns, short, [name_of(name.encode("latin-1")) for name in names])


def _elements(head: str) -> Iterator[Element]:
    """Yield the elements that a header declares."""
    current: Element | None = None
    for number, words in enumerate(map(str.split, head.split("\n")), 1):
        if words[:1] == ["element"]:
            if current is not None:
                yield current
            if len(words) != 3 or not (words[2].isascii() and words[2].isdigit() and len(words[2]) < 19):
                text = shown(" ".join(words[1:]))
                raise SceneError(f"line {number}: an element in its header is {text!r} instead of a name and a number")
            current = Element(words[1], int(words[2]), [])
        elif words[:1] == ["property"]:
            is_list = words[1:2] == ["list"]
            kinds = words[2:4] if is_list else words[1:2]
            if current is None or len(words) != (5 if is_list else 3) or not all(kind in _TYPES for kind in kinds):
                raise SceneError(f"line {number}: {shown(' '.join(words))!r} is not a property of an element")
            length = _TYPES[kinds[0]] if is_list else ""
            if length.startswith("f"):
                raise SceneError(f"line {number}: the length of a list is a whole number, not a {kinds[0]}")
            current.properties.append(Property(words[-1], _TYPES[kinds[-1]], length))
    if current is not None:
        yield current


_Columns = dict[str, dict[str, Any]]


def _require(elements: list[Element], needed: int, there: int, unit: str) -> None:
    """Raise SceneError where fewer lines or bytes follow than elements need at least."""
    if needed > there:
        what = ", ".join(f"{part.count:,} of {shown(part.name)}" for part in elements)
        raise SceneError(f"its header declares more than follows ({what}): at least {needed:,} {unit}, not {there:,}")


def _in_text(elements: list[Element], body: bytes, _: str) -> tuple[_Columns, dict[str, Ints]]:
    text = np.frombuffer(plain(body) + b"\n", np.uint8)
    begins = line_begins(text)
    begins = begins[np.add.reduceat(word_begins(text), begins, dtype=np.int64) > 0]
    _require(elements, sum(part.count for part in elements), len(begins), "lines")
    columns, short, first = {}, {}, 0
    for part in elements:
        own = begins[first : first + part.count]
        first += part.count
        past = int(begins[first]) if first < len(begins) else len(text)
        if not len(own):
            columns[part.name], short[part.name] = _without_rows(part), own
            continue
        numbers = numbers_in(text[own[0] : past], own - own[0])
        ends = np.cumsum(numbers.counts)
        columns[part.name], short[part.name] = of_lines(part, numbers.values, ends - numbers.counts, ends)
    return columns, short


def of_lines(part: Element, values: NDArray[np.float64], at: Ints, ends: Ints) -> tuple[dict[str, Any], Ints]:
    """Return the columns of elements whose numbers are values[at : ends], and which of the elements end early."""
    values = np.append(values, np.nan)
    columns: dict[str, Any] = {}
    whole = np.ones(len(at), bool)
    for name, _, length in part.properties:
        whole &= at < ends
        column = np.where(whole, values[np.minimum(at, len(values) - 1)], np.nan)
        at = at + 1
        if not length:
            columns[name] = column
            continue
        with np.errstate(invalid="ignore"):
            whole &= (column >= 0) & (column == np.floor(column)) & (at + column <= ends)
        sizes = np.where(whole, column, 0).astype(np.int64)
        columns[name] = Lists(values[_ranges(at, sizes)], sizes)
        at = at + sizes
    return columns, np.flatnonzero(~whole)


def _in_bytes(elements: list[Element], body: bytes, order: str) -> tuple[_Columns, dict[str, Ints]]:
    _require(elements, sum(part.count * part.least for part in elements), len(body), "bytes")
    columns: _Columns = {}
    at = 0
    for part in elements:
        columns[part.name], at = _of_bytes(part, body, at, order)
    return columns, {part.name: np.zeros(0, np.int64) for part in elements}


def _of_bytes(part: Element, body: bytes, at: int, order: str) -> tuple[dict[str, Any], int]:
    """Return the columns of elements that begin at a place, and where they end."""
    if not part.count:
        return _without_rows(part), at
    sizes = _first_sizes(part, body, at, order)
    row = np.dtype(
        [
            item
            for k, (_, kind, length) in enumerate(part.properties)
            for item in ([(f"n{k}", order + length)] if length else []) + [(f"v{k}", order + kind, (sizes[k],))]
        ]
    )
    end = at + part.count * row.itemsize
    if end <= len(body):
        rows = np.frombuffer(body, row, part.count, at)
        if all((rows[f"n{k}"] == sizes[k]).all() for k, each in enumerate(part.properties) if each.length):
            same = {
                each.name: Lists(rows[f"v{k}"].reshape(-1), np.full(part.count, sizes[k]))
                if each.length
                else rows[f"v{k}"][:, 0]
                for k, each in enumerate(part.properties)
            }
            return same, end
    return _of_rows(part, body, at, order)


def _first_sizes(part: Element, body: bytes, at: int, order: str) -> list[int]:
    """Return the lengths of the lists of the first element, 1 for a number."""
    sizes = []
    for _, kind, length in part.properties:
        size = 1
        if length:
            step = int(length[1])
            size = _length(body[at : at + step], order, length) if at + step <= len(body) else 0
            at += step
        sizes.append(min(size, len(body)))
        at += size * int(kind[1])
    return sizes


def _length(word: bytes, order: str, kind: str) -> int:
    return max(0, int.from_bytes(word, "big" if order == ">" else "little", signed=kind[0] == "i"))


def _of_rows(part: Element, body: bytes, at: int, order: str) -> tuple[dict[str, Any], int]:
    """Return the columns of elements whose lists have different lengths: one after the other, to find their places."""
    steps = [(int(kind[1]), int(length[1]) if length else 0, length) for _, kind, length in part.properties]
    places: list[list[int]] = [[] for _ in steps]
    sizes: list[list[int]] = [[] for _ in steps]
    for number in range(part.count):
        for k, (width, step, length) in enumerate(steps):
            size = 1
            if step:
                size = body[at] if length == "u1" and at < len(body) else _length(body[at : at + step], order, length)
                at += step
            places[k].append(at)
            sizes[k].append(size)
            at += size * width
        if at > len(body):
            raise SceneError(f"it ends within {shown(part.name)} {number:,} of {part.count:,}")
    data = np.frombuffer(body, np.uint8)
    columns: dict[str, Any] = {}
    for k, (name, kind, length) in enumerate(part.properties):
        width, count = int(kind[1]), np.array(sizes[k])
        bytes_of = data[_ranges(np.array(places[k]), count * width)]
        values = bytes_of.view(order + kind)
        columns[name] = Lists(values, count) if length else values
    return columns, at


def _ranges(begins: Ints, sizes: Ints) -> Ints:
    """Return the places begins[0], begins[0] + 1, ... of each range, one after the other."""
    ends = np.cumsum(sizes)
    return np.asarray(np.arange(ends[-1] if len(ends) else 0) + np.repeat(begins - (ends - sizes), sizes))


def _without_rows(part: Element) -> dict[str, Any]:
    none = np.zeros(0)
    return {name: Lists(none, np.zeros(0, np.int64)) if length else none for name, _, length in part.properties}
