"""The prologue of a kernel: hand-written functions for operations that OpenCL C lacks or computes otherwise.

Stage: emit. Each function is written once, with `T` for its type. C has no overloading, so the form for each type has
its own name: `sh_min` (float), `sh_min3` (float3), `sh_min_d2` (double2). A vector form that cannot have the same text
calls the scalar form for each component. Only functions that are used are printed.

>>> prologue = Prologue()
>>> prologue.use("min", vec("f", 3))
'sh_min3'
>>> print(prologue.text())
// The smaller argument; if one is NaN, the other.
float3 sh_min3(float3 a, float3 b) {
    return !(a <= b) & (b == b) ? b : a;
}
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Final

from shpy.backend.emit.spell_c import row_major
from shpy.ir.types import Base, Type, vec

NOINLINE: Final = "__attribute__((noinline))"
"""The attribute of functions that are large, rarely called, or called from so many places that inlining is slow."""

SCALARS: Final = {Base.F: "float", Base.D: "double", Base.I: "int", Base.U: "uint", Base.B: "bool"}
"""OpenCL's name of one component."""


def _powers_of_two(bias: int, mantissa: int, wide: str) -> str:
    """Return the text of ldexp for floats of this bias and mantissa; `wide` converts to ints of their size."""
    lowest, highest = 1 - bias, bias
    return f"""\
// x * 2^n rounded once: by three powers of two, and what the first two round becomes 0 by the last.
T {{name}}(T x, INT n) {{
    INT last = clamp(n, (INT)({lowest}), (INT)({highest}));
    INT middle = clamp(n - last, (INT)({lowest}), (INT)({highest}));
    INT first = clamp(n - last - middle, (INT)({lowest}), (INT)({highest}));
    x *= as_T({wide}(first + {bias}) << {mantissa});
    x *= as_T({wide}(middle + {bias}) << {mantissa});
    return x * as_T({wide}(last + {bias}) << {mantissa});
}}"""


ANY_SIZE: Final = {
    ("min", Base.F): """\
// The smaller argument; if one is NaN, the other.
T {name}(T a, T b) {
    return !(a <= b) & (b == b) ? b : a;
}""",
    ("max", Base.F): """\
// The greater argument; if one is NaN, the other.
T {name}(T a, T b) {
    return !(a >= b) & (b == b) ? b : a;
}""",
    # PoCL's own ldexp rounds denormal results twice in vectors, and rusticl's flushes them to zero.
    ("ldexp", Base.F): _powers_of_two(127, 23, ""),
    ("ldexp", Base.D): _powers_of_two(1023, 52, "convert_LONG"),
}
"""Texts of functions for vectors of any size, packets too, by operation and base; those of F serve D too."""

HALF: Final = """\
// x rounded to binary16.
FLOAT {name}(FLOAT x) {
    USHORT bits;
    vstore_half{size}_rte(x, 0, (half *)&bits);
    return vload_half{size}(0, (half *)&bits);
}"""

_MINUS_ZERO: Final = """\
// -0.0, hidden from LLVM, which replaces it by 0.0 in a choice by a comparison.
T {name}(void) {
    volatile BITS;
    return as_T(bits);
}"""
_ZERO: Final = """\
// 0.0, hidden from the compiler, which would replace 0 * x by 0.
T {name}(void) {
    return as_T((BITS)get_global_offset(2));
}"""
_WHOLE_ZERO: Final = """\
// 0, hidden from the compiler, which would compute the number of a loop's iterations from it, wrongly.
T {name}(void) {
    return (T)get_global_offset(2);
}"""

_SCALAR: Final = {
    ("floordiv", Base.I): """\
// floor(a / b); 0 for b = 0, and INT_MIN for INT_MIN / -1.
int {name}(int a, int b) {
    if (b == 0 || b == -1) {
        return b == 0 ? 0 : (int)(0u - (uint)a);
    }
    int q = a / b;
    return q * b != a && (a < 0) != (b < 0) ? q - 1 : q;
}""",
    ("floordiv", Base.U): """\
// a / b; 0 for b = 0.
uint {name}(uint a, uint b) {
    return b == 0u ? 0u : a / b;
}""",
    ("floormod", Base.I): """\
// a - b * floor(a / b), which has b's sign; 0 for b = 0.
int {name}(int a, int b) {
    if (b == 0 || b == -1) {
        return 0;
    }
    int r = a % b;
    return r != 0 && (r < 0) != (b < 0) ? r + b : r;
}""",
    ("floormod", Base.U): """\
// a % b; 0 for b = 0.
uint {name}(uint a, uint b) {
    return b == 0u ? 0u : a % b;
}""",
    ("abs", Base.I): """\
// a without its sign; INT_MIN for INT_MIN.
int {name}(int a) {
    return a < 0 ? (int)(0u - (uint)a) : a;
}""",
    ("minus_zero", Base.F): _MINUS_ZERO.replace("BITS", "uint bits = 0x80000000u"),
    ("minus_zero", Base.D): _MINUS_ZERO.replace("BITS", "ulong bits = 0x8000000000000000ul"),
    ("zero", Base.F): _ZERO.replace("BITS", "int"),
    ("zero", Base.D): _ZERO.replace("BITS", "long"),
    ("zero", Base.I): _WHOLE_ZERO,
    ("zero", Base.U): _WHOLE_ZERO,
    ("bits_from_float", Base.F): """\
// The bits of x; every NaN gives the same bits.
uint {name}(float x) {
    return x != x ? 0x7fc00000u : as_uint(x);
}""",
    ("half", Base.F): HALF,
}

_NAN: Final = """\
// Returns a NaN unchanged: PoCL's compiler may replace the {op} of a NaN by any number.
T {name}(T x) {
    return x == x ? {op}(x) : x;
}"""
NAN_LOST: Final = frozenset({"exp", "exp2", "sinh", "tanh"})
"""Functions whose implementation converts to an int; the compiler may give any result for a NaN there."""

# Vector forms that drivers compute wrongly: PoCL 3.1 gives sin(1e-8) = 0.008 beside a large component.
_BY_COMPONENT: Final = frozenset({"sin", "cos", "tan"})

_NEAREST: Final = """\
// The nearest index in range. Nearly all are in range: a predicted branch costs less than a clamp before the load.
uint sh_at(int i, int size) {
    return __builtin_expect((uint)i < (uint)size, 1) ? (uint)i : (uint)clamp(i, 0, size - 1);
}"""


def spelled(type: Type) -> str:
    """Return OpenCL's name of a type; a vector of bools is one of ints, -1 for true. Raise KeyError for a binary16."""
    if type.base is Base.B and type.size > 1:
        return f"int{type.size}"
    return SCALARS[type.base] if type.size == 1 else f"{SCALARS[type.base]}{type.size}"


def name_of(op: str, type: Type) -> str:
    """Return the name of the function that computes `op` for a first argument of `type`."""
    base = "" if type.base is Base.F else f"_{type.base.value}"
    return f"sh_{_SHORT.get(op, op)}{base}{type.size if type.size > 1 else ''}"


def filled(text: str, name: str, type: str, size: str, **words: str) -> str:
    """Return a function's text with its name and types: `type` for T, `float4` for FLOAT if `size` is "4", and so on.

    `words` are others that are replaced.
    """
    wide = {word: f"{word.lower()}{size}" for word in ("FLOAT", "INT", "UINT", "LONG", "DOUBLE", "USHORT")}
    for word, meant in {**wide, "T": type, **words}.items():
        text = re.sub(rf"(\b|(?<=_)){word}\b", meant, text)
    return text.replace("{name}", name).replace("{size}", size)


class Prologue:
    """The functions that one kernel uses, in the order in which they were asked for."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def use(self, op: str, type: Type) -> str:
        """Add the function that computes `op` for a first argument of `type`; return its name."""
        return self._ask(name_of(op, type), lambda name: self._text(op, type, name))

    def _ask(self, name: str, text: Callable[[str], str]) -> str:
        """Add the function of this name, unless it is there; return the name."""
        if name not in self._texts:
            self._texts[name] = text(name)
        return name

    def _text(self, op: str, type: Type, name: str) -> str:
        """Return the function that computes `op`; the function of one component, which it may call, is added."""
        if op in _BY_COMPONENT:
            return _each(spelled(type), name, [f"{spelled(type)} x"], op, "x", type.size)
        if op == "component":
            return _pick(name, type)
        text = _NAN.replace("{op}", op) if op in NAN_LOST else None
        text = text or ANY_SIZE.get((op, type.base)) or ANY_SIZE.get((op, Base.F))
        if text is None and type.size > 1:
            scalar = self.use(op, type.scalar)
            return _componentwise(self._texts[scalar], scalar, name, type.size)
        size = str(type.size) if type.size > 1 else ""
        return filled(text or _SCALAR[op, type.base], name, spelled(type), size)

    def wants(self, op: str, type: Type) -> bool:
        """Return whether `op` needs a function of the prologue, because OpenCL's own differs for this type."""
        return op in NAN_LOST or (type.size > 1 and op in _BY_COMPONENT)

    def flat_index(self, rank: int) -> str:
        """Add the function that computes the flat index in a table of `rank` axes, 1 to 3; return its name."""
        return self._ask(f"sh_at{rank if rank > 1 else ''}", lambda name: _NEAREST if rank == 1 else _flat(name, rank))

    def text(self) -> str:
        """Return the functions, one empty line between them."""
        return "\n\n".join(self._texts.values())


def _flat(name: str, rank: int) -> str:
    place = row_major(["(size_t)at.x", *(f"at.{c}" for c in "yz"[: rank - 1])], "size")
    return f"""\
// The place of an element, the nearest one for an index that is out of range.
size_t {name}(int{rank} at, int{rank} size) {{
    at = clamp(at, (int{rank})(0), size - 1);
    return {place};
}}"""


_SHORT: Final = {"bits_from_float": "bits", "component": "pick"}


def _pick(name: str, type: Type) -> str:
    choice = "".join(f"i {'<=' if k == 0 else '=='} {k} ? v.{c} : " for k, c in enumerate("xyzw"[: type.size - 1]))
    scalar = spelled(vec(Base.I) if type.is_bool else type.scalar)
    return f"""\
// The component at i, clamped.
{scalar} {name}({spelled(type)} v, int i) {{
    return {choice}v.{"xyzw"[type.size - 1]};
}}"""


def _componentwise(text: str, scalar: str, name: str, size: int) -> str:
    head = re.search(r"^(\w+) \w+\((.*)\) \{$", text, re.MULTILINE)
    assert head is not None
    parameters = [p.split(" ") for p in head[2].split(", ")]
    takes = [f"{t}{size} {p}" for t, p in parameters]
    return _each(f"{head[1]}{size}", name, takes, scalar, [p for _, p in parameters], size)


def _each(result: str, name: str, takes: list[str], scalar: str, names: Iterable[str], size: int) -> str:
    each = ", ".join(f"{scalar}({', '.join(f'{p}.{c}' for p in names)})" for c in "xyzw"[:size])
    return f"{result} {name}({', '.join(takes)}) {{\n    return ({result})({each});\n}}"
