r"""Texts of numbers by lines, as OBJ, PLY, STL and OFF files are.

Stage: scene description. Lines end at \n, \r\n or \r, and at no other character: in names of other encodings, bytes
such as 85 are parts of letters. So a text stays bytes until its names are decoded, each by itself.

>>> numbers = numbers_in(b"1 2\n3 x\n")
>>> numbers.values.tolist(), numbers.counts.tolist()
([1.0, 2.0, 3.0, nan], [2, 2])
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.arrays import real

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
_MARKS: Final = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
_BLOCK: Final = 1 << 22
"""Bytes of a text in one block: the arrays of a block of this size stay in the cache."""
SPACE: Final = 32
"""The last of the characters that separate words; those before it control a terminal, or do not occur."""
LINE_FEED: Final = 10
SLASH: Final = 47


class Numbers(NamedTuple):
    """The words of lines as numbers, NaN for what is not a number, and how many each line has."""

    values: Floats
    counts: Ints

    def rows(self, width: int) -> Floats:
        """Return the first numbers of each line (N, width); NaN where a line has fewer."""
        if (self.counts == width).all():
            return self.values.reshape(-1, width)
        table = np.full((len(self.counts), width), np.nan)
        line, place = self.places()
        inside = place < width
        table[line[inside], place[inside]] = self.values[inside]
        return table

    def places(self) -> tuple[Ints, Ints]:
        """Return the line of each number, and its place in that line."""
        line = np.repeat(np.arange(len(self.counts)), self.counts)
        return line, np.arange(len(line)) - np.repeat(np.cumsum(self.counts) - self.counts, self.counts)


def plain(data: bytes) -> bytes:
    r"""Return a text whose lines end with \n, without a byte-order mark; of UTF-16 its UTF-8."""
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            data = data[len(mark) :]
            if encoding != "utf-8":
                data = data.decode(encoding, "replace").encode("utf-8")
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def name_of(word: bytes) -> str:
    """Decode a name: UTF-8, or else Latin-1, which gives equal bytes equal names."""
    try:
        return word.decode("utf-8")
    except UnicodeDecodeError:
        return word.decode("latin-1")


def text_of(data: bytes) -> str:
    """Decode a text: UTF-8 or UTF-16 with a byte-order mark, UTF-8, or else Latin-1."""
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return data[len(mark) :].decode(encoding, "replace")
    return name_of(data)


def without_comment(line: bytes) -> bytes:
    """Return a line up to a # at its begin or after a space; a name may have a # in it."""
    at = line.find(b"#")
    while at > 0 and line[at - 1] > SPACE:
        at = line.find(b"#", at + 1)
    return line if at < 0 else line[:at]


def without_indents(block: bytes) -> bytes:
    """Return lines without the spaces that they begin with."""
    if block[:1] > b" " and b"\n " not in block and b"\n\t" not in block:
        return block
    return re.sub(rb"\n[ \t\v\f]+", b"\n", b"\n" + block)[1:]


def blocks(text: bytes) -> Iterator[bytes]:
    """Yield a text in parts of whole lines, each of which ends with a line feed."""
    begin = 0
    while begin < len(text):
        end = text.find(b"\n", begin + _BLOCK)
        part = text[begin:] if end < 0 else text[begin : end + 1]
        begin = len(text) if end < 0 else end + 1
        yield part if part.endswith(b"\n") else part + b"\n"


def line_begins(text: Bytes) -> Ints:
    """Return the offset of each line; the text ends with a line feed."""
    return np.concatenate([[0], np.flatnonzero(text == LINE_FEED)[:-1] + 1])


def word_begins(text: Bytes) -> NDArray[np.bool_]:
    """Return at which characters of a text (N,) words begin."""
    mask = text > SPACE
    mask[1:] &= text[:-1] <= SPACE
    return mask


def numbers_in(text: bytes | Bytes, begins: Ints | None = None) -> Numbers:
    """Return the numbers of a text's lines, of which the last ends with a line feed; `begins` are their places."""
    characters = np.frombuffer(text, np.uint8) if isinstance(text, bytes) else text
    begins = line_begins(characters) if begins is None else begins
    counts = np.add.reduceat(word_begins(characters), begins, dtype=np.int64)
    text = characters.tobytes()
    words = text.split()
    if len(words) != int(counts.sum()):  # Python takes control characters for letters
        words = np.where(characters < SPACE, np.uint8(SPACE), characters).tobytes().split()
    if b"_" not in text:  # Python allows _ between digits
        try:
            return Numbers(np.fromiter(map(float, words), np.float64, len(words)), counts)
        except ValueError:
            pass
    return Numbers(np.fromiter(map(_float, words), np.float64, len(words)), counts)


def whole_numbers(text: Bytes, begins: Ints, ends: Ints) -> tuple[Ints, NDArray[np.bool_]]:
    """Return the decimal numbers from `begins` to `ends` of a text, and which of them are whole numbers.

    They are read digit by digit, all at once. Numbers of more than 18 digits are held at 10**18.
    """
    padded = np.append(text, np.zeros(20, np.uint8))
    sign = padded[begins]
    negative = sign == ord("-")
    first = begins + (negative | (sign == ord("+")))
    numbers, is_whole = np.zeros(len(begins), np.int64), first < ends
    longest = int((ends - first).max(initial=0))
    for place in range(min(longest, 18)):
        digit = padded[first + place] - np.uint8(ord("0"))  # characters before 0 wrap round
        inside = first + place < ends
        numbers = np.where(inside, 10 * numbers + digit, numbers)
        is_whole &= ~inside | (digit < 10)
    for number in np.flatnonzero(ends - first > 18):
        is_whole[number] = is_whole[number] and text[first[number] : ends[number]].tobytes().isdigit()
        numbers[number] = 10**18
    return np.where(negative, -numbers, numbers), is_whole


def _float(word: bytes) -> float:
    try:
        return real(word.decode("ascii"))
    except ValueError:
        return float("nan")


def lines_of(text: Bytes, begins: Ints, chosen: Ints) -> tuple[Bytes, Ints, Ints]:
    """Return the text of some of the lines that begin at these places, where each begins in it, and their sizes."""
    sizes = np.append(begins[1:], len(text)) - begins
    if len(chosen) == len(begins):
        return text.copy(), begins, sizes
    mask = np.zeros(len(begins), bool)
    mask[chosen] = True
    own = sizes[chosen]
    return text[np.repeat(mask, sizes)], np.cumsum(own) - own, own
