r"""The prologue of a shader: hand-written functions for what GLSL 3.30 does not do, or not as the op table says.

Stage: emit. The functions stand in `edges.glsl`, for one component. The printer asks for those it uses; the text has
these, the functions that they call, and their forms for vectors, in the order of the file.

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
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Final

from shpy.backend.emit.spell_c import row_major
from shpy.backend.emit.tree import Name
from shpy.backend.glsl.text.interface import (
    FIRST,
    FOLD,
    GRID_SHAPE,
    LAST,
    NOTHING,
    RUNNING,
    WIDTH,
    InputTexture,
    TableTexture,
)
from shpy.ir.types import Base, Type, vec

SCALARS: Final = {Base.F: "float", Base.D: "double", Base.I: "int", Base.U: "uint", Base.B: "bool"}
"""GLSL's name of one component."""

_VECTORS: Final = {Base.F: "vec", Base.D: "dvec", Base.I: "ivec", Base.U: "uvec", Base.B: "bvec"}
_ROUNDED: Final = ("float", "double", "bool")
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
    source: str

    @property
    def words(self) -> frozenset[str]:
        """The names in it that are ours."""
        return frozenset(re.findall(r"\bsh_\w+", self.source))

    @property
    def calls(self) -> frozenset[str]:
        """The functions of the prologue that it calls."""
        return frozenset(re.findall(r"\b(sh_\w+)\(", self.source[self.source.index("{") :]))

    def sized(self, size: int) -> str:
        """Return the same function of vectors, component by component."""
        wide = {scalar: f"{_VECTORS[base]}{size}" for base, scalar in SCALARS.items()}
        takes = ", ".join(
            f"{_PRECISE if t in _ROUNDED else ''}{wide[t]} {p}"
            for t, p in zip(self.types, self.parameters, strict=True)
        )
        each = [f"{self.name}({', '.join(f'{p}.{c}' for p in self.parameters)})" for c in "xyzw"[:size]]
        result = wide[self.result]
        return f"{result} {self.name}({takes}) {{\n    return {result}({', '.join(each)});\n}}"


@cache
def helpers(signs: bool = True) -> tuple[Helper, ...]:
    """Return every function of the prologue in the order of the file; functions stand below those that they call.

    Those of signs.glsl take the place of their namesakes where the choices of a device lose the signs of zeros.
    """
    others = {} if signs else {(h.name, h.types): h for h in _read("signs.glsl")}
    return tuple(others.get((h.name, h.types), h) for h in _read("edges.glsl"))


def _read(file: str) -> tuple[Helper, ...]:
    text = (resources.files(__package__) / file).read_text()
    functions = []
    for paragraph in text.split("\n\n"):
        head = _HEAD.search(paragraph)
        if head is None:
            continue
        result, name, inside = head.groups()
        pairs = [p.removeprefix(_PRECISE).rsplit(" ", 1) for p in inside.split(", ")]
        functions.append(
            Helper(name, result, tuple(t for t, _ in pairs), tuple(p for _, p in pairs), paragraph.strip("\n"))
        )
    return tuple(functions)


class Prologue:
    """The functions that one shader uses.

    `exact`: the operations of their arguments keep their order; `signs`: the device's choices keep the signs of zeros.
    """

    def __init__(self, *, exact: bool = True, signs: bool = True) -> None:
        self._exact = exact
        self._helpers = helpers(signs or not exact)
        self._used: set[Helper] = set()
        self._sized: set[tuple[Helper, int]] = set()

    def use(self, name: str, types: tuple[Type, ...]) -> str:
        """Ask for the function of this name that takes these types; return the name."""
        scalars = tuple(SCALARS[t.base] for t in types)
        helper = next(h for h in self._helpers if h.name == name and h.types == scalars)
        self._used.add(helper)
        size = max(t.size for t in types)
        if size > 1:
            self._sized.add((helper, size))
        return name

    def _with_callees(self) -> set[Helper]:
        """Return the functions asked for and those that they call."""
        functions: set[Helper] = set()
        pending = set(self._used)
        while pending:
            functions |= pending
            called = frozenset().union(*(h.calls for h in pending))
            pending = {h for h in self._helpers if h.name in called} - functions
        return functions

    def words(self) -> frozenset[str]:
        """Return the names in the text that are ours."""
        return frozenset().union(*(h.words for h in self._with_callees()))

    def text(self) -> str:
        """Return the functions asked for and those that they call, one empty line between them."""
        functions, parts = self._with_callees(), []
        for helper in self._helpers:
            if helper in functions:
                parts.append(helper.source)
                parts += [helper.sized(size) for size in (2, 3, 4) if (helper, size) in self._sized]
        text = "\n\n".join(parts)
        return text if self._exact else _HEAD.sub(lambda head: head[0].replace(_PRECISE, ""), text)


# The rest of a shader around its functions

VERSION: Final = """\
#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif
"""
_DOUBLES: Final = "#extension GL_ARB_gpu_shader_fp64 : require\n"
_ZERO: Final = "float(min(int(gl_FragCoord.x), 0))"
"""A zero that no driver knows: one may look at the value of a uniform that a loop's condition reads."""

_FOLD_BITS: Final = FOLD.bit_length() - 1
KINDS: Final = {Base.F: "", Base.H: "", Base.I: "i", Base.U: "u", Base.B: "u"}
"""The first letter of the samplers and texels of a base."""


def whole_text(declared: Sequence[str], prologue: str, functions: Sequence[str], *, doubles: bool) -> str:
    """Return the text of a shader: version, interface, prologue and functions, an empty line between them.

    `doubles`: a function has numbers of binary64.
    """
    interface = "".join([f"{line}\n" for line in declared])
    version = VERSION + _DOUBLES if doubles else VERSION
    parts = [version, interface, f"{prologue}\n" if prologue else "", "\n".join(functions)]
    return "\n".join([part for part in parts if part])


def uniforms(params: Iterable[Name], tables: Iterable[TableTexture], used: Collection[str], zero: str) -> list[str]:
    """Return the declarations of params, of tables, and of those of the runtime's names that are used."""
    lines = [f"uniform {spelled(p.type)} {p.text};" for p in params]
    for table in tables:
        lines.append(f"uniform {KINDS[table.type.base]}sampler2D {table.sampler};")
        lines.append(f"uniform {spelled(vec(Base.I, table.rank))} {table.shape};")
    ours = {
        zero: f"float {zero} = {_ZERO};  // 0.0, but the driver must not know",
        NOTHING: f"uint {NOTHING} = uint(min(int(gl_FragCoord.x), 0));  // 0u, but the driver must not know",
        RUNNING: f"uniform bool {RUNNING};  // true, but the driver must not know",
        LAST: f"uniform ivec2 {LAST};",
        FIRST: f"uniform int {FIRST};",
        WIDTH: f"uniform int {WIDTH};",
        GRID_SHAPE: f"uniform ivec4 {GRID_SHAPE};",
    }
    return lines + [line for name, line in ours.items() if name in used]


def input_uniforms(texture: InputTexture) -> list[str]:
    """Return the declarations of an input's uniforms."""
    each = f"uniform int {texture.each};  // 0 where one value serves all elements"
    return [f"uniform {KINDS[texture.type.base]}sampler2D {texture.sampler};", each]


def output(location: int, type: Type, name: str) -> str:
    """Return the declaration of an output."""
    return f"layout(location = {location}) out {spelled(type)} {name};"


def reader(table: TableTexture, name: str) -> str:
    """Return the function that reads a table, whose elements fill the rows of a texture in C order."""
    index, n, type = spelled(vec(Base.I, table.rank)), table.shape, table.type
    flat = "at" if table.rank == 1 else row_major([f"at.{c}" for c in "xyz"[: table.rank]], n)
    texel = f"texelFetch({table.sampler}, ivec2(i & {FOLD - 1}, i >> {_FOLD_BITS}), 0)"
    if type.is_bool or type.size < 4:
        texel = f"{texel}.{'xyzw'[: type.size]}"
    if type.is_bool:
        texel = f"{texel} != 0u" if type.size == 1 else f"notEqual({texel}, uvec{type.size}(0u))"
    return f"""\
// An element of {table.sampler}, the nearest where the index is out of range.
{spelled(type)} {name}({index} at) {{
    at = clamp(at, {index}(0), {n} - 1);
    int i = {flat};
    return {texel};
}}
"""


def grid_name(size: int) -> str:
    """Name the function that gives an element's index along `size` axes."""
    return f"sh_grid_index{size}"


def grid_function(size: int) -> tuple[str, frozenset[str]]:
    """Return the function that computes `grid_index` on `size` axes, and the names of the runtime that it uses."""
    n = GRID_SHAPE
    rows = {
        1: "    return i;",
        2: f"    return sh_split(i, {n}.y);",
        3: f"    ivec2 z = sh_split(i, {n}.z);\n    return ivec3(sh_split(z.x, {n}.y), z.y);",
        4: f"    ivec2 w = sh_split(i, {n}.w), z = sh_split(w.x, {n}.z);\n"
        f"    return ivec4(sh_split(z.x, {n}.y), z.y, w.y);",
    }[size]
    text = f"""\
{spelled(vec(Base.I, size))} {grid_name(size)}() {{
    ivec2 at = min(ivec2(gl_FragCoord.xy), {LAST});
    int i = {FIRST} + at.y * {WIDTH} + at.x;
{rows}
}}
"""
    return text, frozenset({LAST, FIRST, WIDTH, *({n} if size > 1 else ())})
