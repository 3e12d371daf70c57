r"""The prologue of a shader: hand-written functions for what GLSL 3.30 does not do, or not as the op table says.

Stage: emit. The functions stand in `edges.glsl`, for one component. The printer asks for those it uses; what comes out
is these, those that they call, and their forms for vectors, in the order of the file.

>>> prologue = Prologue()
>>> prologue.use("sh_min", (vec(Base.F, 2),) * 2)
'sh_min'
>>> print(prologue.text().split("\n\n")[1])
vec2 sh_min(precise vec2 a, precise vec2 b) {
    return vec2(sh_min(a.x, b.x), sh_min(a.y, b.y));
}
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Final

from shpy.ir.types import Base, Type

SCALARS: Final = {Base.F: "float", Base.I: "int", Base.U: "uint", Base.B: "bool"}
"""GLSL's name of one component."""

_VECTORS: Final = {Base.F: "vec", Base.I: "ivec", Base.U: "uvec", Base.B: "bvec"}
_ROUNDED: Final = ("float", "bool")
_PRECISE: Final = "precise "
_HEAD: Final = re.compile(r"^(\w+) (sh_\w+)\((.*)\) \{$", re.MULTILINE)


def spelled(type: Type) -> str:
    """GLSL's name of a type; KeyError for the bases it has not."""
    return SCALARS[type.base] if type.size == 1 else f"{_VECTORS[type.base]}{type.size}"


@dataclass(frozen=True, slots=True)
class Helper:
    """One function of the prologue: its head, taken apart, and its whole text with the comment above it."""

    name: str
    result: str
    types: tuple[str, ...]
    parameters: tuple[str, ...]
    text: str

    @property
    def calls(self) -> frozenset[str]:
        """The functions of the prologue that it calls."""
        return frozenset(re.findall(r"\b(sh_\w+)\(", self.text[self.text.index("{") :]))

    def sized(self, size: int) -> str:
        """The same function of vectors, component by component."""
        wide = {scalar: f"{_VECTORS[base]}{size}" for base, scalar in SCALARS.items()}
        takes = ", ".join(
            f"{_PRECISE if t in _ROUNDED else ''}{wide[t]} {p}"
            for t, p in zip(self.types, self.parameters, strict=True)
        )
        each = [f"{self.name}({', '.join(f'{p}.{c}' for p in self.parameters)})" for c in "xyzw"[:size]]
        result = wide[self.result]
        return f"{result} {self.name}({takes}) {{\n    return {result}({', '.join(each)});\n}}"


@cache
def helpers(precise: bool = True) -> tuple[Helper, ...]:
    """Every function of the prologue, in the order of the file; functions stand below those that they call.

    Where a device has no `precise`, those of kept.glsl take the place of their namesakes.
    """
    found = _read("edges.glsl")
    if precise:
        return found
    others = {(h.name, h.types): h for h in _read("kept.glsl")}
    return tuple(others.get((h.name, h.types), h) for h in found)


def _read(file: str) -> tuple[Helper, ...]:
    text = (resources.files(__package__) / file).read_text()
    found = []
    for paragraph in text.split("\n\n"):
        head = _HEAD.search(paragraph)
        if head is None:
            continue
        result, name, inside = head.groups()
        pairs = [p.removeprefix(_PRECISE).rsplit(" ", 1) for p in inside.split(", ")]
        found.append(
            Helper(name, result, tuple(t for t, _ in pairs), tuple(p for _, p in pairs), paragraph.strip("\n"))
        )
    return tuple(found)


class Prologue:
    """The functions that one shader uses.

    `exact`: what is handed to them keeps its order of operations; `precise`: the device has the qualifier for that.
    """

    def __init__(self, *, exact: bool = True, precise: bool = True) -> None:
        self._exact = exact
        self._helpers = helpers(precise or not exact)
        self._used: set[Helper] = set()
        self._sized: set[tuple[Helper, int]] = set()

    def use(self, name: str, types: tuple[Type, ...]) -> str:
        """Ask for the function of this name that takes these types; gives the name."""
        scalars = tuple(SCALARS[t.base] for t in types)
        helper = next(h for h in self._helpers if h.name == name and h.types == scalars)
        self._used.add(helper)
        size = max(t.size for t in types)
        if size > 1:
            self._sized.add((helper, size))
        return name

    def text(self) -> str:
        """The functions asked for and those that they call, one empty line between them."""
        wanted: set[Helper] = set()
        pending = set(self._used)
        while pending:
            wanted |= pending
            called = frozenset().union(*(h.calls for h in pending))
            pending = {h for h in self._helpers if h.name in called} - wanted
        parts = []
        for helper in self._helpers:
            if helper in wanted:
                parts.append(helper.text)
                parts += [helper.sized(size) for size in (2, 3, 4) if (helper, size) in self._sized]
        text = "\n\n".join(parts)
        return text if self._exact else _HEAD.sub(lambda head: head[0].replace(_PRECISE, ""), text)
