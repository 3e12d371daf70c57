"""The rest of a shader around its functions: version, uniforms, and what the IR has no word for.

Stage: emit. Functions for what GLSL 3.30 does not do, or not as the op table says, are definitions of
`passes/formulas/edges.py`; those that hide something from the driver, or correct one, are texts here.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
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

KEEP: Final = f"""\
// x, from which the driver cannot derive other conditions.
bool sh_keep(precise bool x) {{
    return (uint(x) ^ {NOTHING}) != 0u;
}}"""
ROOT: Final = """\
// The square root of a device that rounds it wrong: one step of Newton's method, with the exact remainder.
double sh_sqrt(precise double x) {
    precise double root = sqrt(x);
    precise double rest = fma(-root, root, x);
    precise double exact = fma(rest, 0.5lf / root, root);
    precise bool finite = x > 0.0lf && x < 1e300lf;
    return finite ? exact : root;
}"""
SPLIT: Final = """\
// i / n and i % n for i >= 0, n > 0, by way of floats: drivers divide the integers of each fragment on its own.
ivec2 sh_split(int i, int n) {
    int q = int(float(i) / float(n));
    q += int(floor(float(i - q * n) / float(n)));
    int r = i - q * n;
    return r < 0 ? ivec2(q - 1, r + n) : r < n ? ivec2(q, r) : ivec2(q + 1, r - n);
}"""


def spelled(type: Type) -> str:
    """GLSL's name of a type; KeyError for the bases it has not."""
    return SCALARS[type.base] if type.size == 1 else f"{_VECTORS[type.base]}{type.size}"


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
