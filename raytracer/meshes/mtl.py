"""The statements of MTL files, libraries of materials for OBJ files.

Stage: scene description. `appearance.mtl` makes materials of them.

    looks = read_mtl(folder.read("chair.mtl"))
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from raytracer.arrays import real
from raytracer.meshes.lines import name_of, plain, without_comment

Words = dict[str, list[str]]
"""The statements of a material, by their names in lower case: what follows the name."""
_PICTURES: Final = ("map_", "bump", "norm", "disp", "decal", "refl")
"""The beginnings of statements that name pictures."""
_OPTIONS: Final = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2}
"""Options of a picture that take numbers, up to so many; the others take one word."""


def read_mtl(data: bytes) -> dict[str, Words]:
    """Read the materials of a library by name; of a statement that comes twice, the last one counts."""
    materials: dict[str, Words] = {}
    current: Words = {}
    for line in plain(data).split(b"\n"):
        line = without_comment(line).strip()
        words = line.split()
        if words[:1] == [b"newmtl"]:
            current = materials.setdefault(name_of(line[len("newmtl") :].strip()), {})
        elif words:
            key = name_of(words[0]).lower()
            after = name_of(line[len(words[0]) + 1 :])  # of a name spaces count, except those around it
            current[key] = [after] if key.startswith(_PICTURES) and after else [name_of(word) for word in words[1:]]
    return materials


class PictureWords(NamedTuple):
    """The file of a picture in a statement of an MTL file, and its options by name."""

    file: str
    options: dict[str, list[str]]


def picture_words(words: list[str]) -> PictureWords:
    """Split a statement such as map_Kd into options and a file, whose name may have spaces, and begin with some."""
    text = " ".join(words)
    spans = [match.span() for match in re.finditer(r"\S+", text)]
    words = [text[begin:end] for begin, end in spans]
    options: dict[str, list[str]] = {}
    at = 0
    while at < len(words) - 1 and words[at].startswith("-"):
        option = words[at]
        end = at + 2
        while end - at <= _OPTIONS.get(option, 1) and end < len(words) - 1 and _is_number(words[end]):
            end += 1
        options[option] = words[at + 1 : end]
        at = end
    return PictureWords(text[spans[at - 1][1] + 1 if at else 0 :] if words else "", options)


def _is_number(word: str) -> bool:
    try:
        real(word)
    except ValueError:
        return False
    return True
