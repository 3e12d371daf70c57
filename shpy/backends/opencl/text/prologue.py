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
from collections.abc import Iterable
from typing import Final

from shpy.backends.emit.spell_c import row_major
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


LDEXP: Final = {Base.F: _powers_of_two(127, 23, ""), Base.D: _powers_of_two(1023, 52, "convert_LONG")}
"""ldexp by base: PoCL's own rounds denormal results twice in vectors, and rusticl's flushes them to zero."""

ANY_SIZE: Final = {
    "min": """\
// The smaller argument; if one is NaN, the other.
T {name}(T a, T b) {
    return !(a <= b) & (b == b) ? b : a;
}""",
    "max": """\
// The greater argument; if one is NaN, the other.
T {name}(T a, T b) {
    return !(a >= b) & (b == b) ? b : a;
}""",
}

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
    ("minus_zero", Base.F): """\
// -0.0, hidden from LLVM, which replaces it by 0.0 in a choice by a comparison.
float {name}(void) {
    volatile uint bits = 0x80000000u;
    return as_float(bits);
}""",
    ("minus_zero", Base.D): """\
// -0.0, hidden from LLVM, which replaces it by 0.0 in a choice by a comparison.
double {name}(void) {
    volatile ulong bits = 0x8000000000000000ul;
    return as_double(bits);
}""",
    ("zero", Base.F): """\
// 0.0, hidden from the compiler, which would replace 0 * x by 0.
float {name}(void) {
    return as_float((int)get_global_offset(2));
}""",
    ("zero", Base.D): """\
// 0.0, hidden from the compiler, which would replace 0 * x by 0.
double {name}(void) {
    return as_double((long)get_global_offset(2));
}""",
    ("zero", Base.I): """\
// 0, hidden from the compiler, which would compute the number of a loop's iterations from it, wrongly.
int {name}(void) {
    return (int)get_global_offset(2);
}""",
    ("zero", Base.U): """\
// 0, hidden from the compiler, which would compute the number of a loop's iterations from it, wrongly.
uint {name}(void) {
    return (uint)get_global_offset(2);
}""",
    ("bits_from_float", Base.F): """\
// The bits of x; every NaN gives the same bits.
uint {name}(float x) {
    return x != x ? 0x7fc00000u : as_uint(x);
}""",
    ("half", Base.F): """\
// x rounded to binary16.
float {name}(float x) {
    ushort bits;
    vstore_half_rte(x, 0, (half *)&bits);
    return vload_half(0, (half *)&bits);
}""",
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

_PICK: Final = """\
// The component at i, clamped.
S {name}(T v, int i) {
    return {choice};
}"""

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


class Prologue:
    """The functions that one kernel uses, in the order in which they were asked for."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def use(self, op: str, type: Type) -> str:
        """Add the function that computes `op` for a first argument of `type`; return its name."""
        name = name_of(op, type)
        if name in self._texts:
            return name
        if op in ANY_SIZE:
            self._texts[name] = re.sub(r"\bT\b", spelled(type), ANY_SIZE[op]).replace("{name}", name)
        elif op == "ldexp":
            self._texts[name] = _ldexp(name, type)
        elif op in NAN_LOST:
            self._texts[name] = re.sub(r"\bT\b", spelled(type), _NAN).replace("{name}", name).replace("{op}", op)
        elif op in _BY_COMPONENT:
            self._texts[name] = _each(spelled(type), name, [f"{spelled(type)} x"], op, "x", type.size)
        elif op == "component":
            self._texts[name] = _pick(name, type)
        elif type.size == 1:
            self._texts[name] = _SCALAR[op, type.base].replace("{name}", name)
        else:
            scalar = self.use(op, type.scalar)
            self._texts[name] = _componentwise(self._texts[scalar], scalar, name, type.size)
        return name

    def wants(self, op: str, type: Type) -> bool:
        """Return whether `op` needs a function of the prologue, because OpenCL's own differs for this type."""
        return op in NAN_LOST or (type.size > 1 and op in _BY_COMPONENT)

    def flat_index(self, rank: int) -> str:
        """Add the function that computes the flat index in a table of `rank` axes, 1 to 3; return its name."""
        if rank == 1:
            self._texts.setdefault("sh_at", _NEAREST)
            return "sh_at"
        name = f"sh_at{rank}"
        self._texts.setdefault(name, _flat(name, rank))
        return name

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


def _ldexp(name: str, type: Type) -> str:
    size = type.size if type.size > 1 else ""
    text = re.sub(r"(\b|(?<=_))T\b", spelled(type), LDEXP[type.base])
    return text.replace("{name}", name).replace("INT", f"int{size}").replace("LONG", f"long{size}")


def _pick(name: str, type: Type) -> str:
    choice = "".join(f"i {'<=' if k == 0 else '=='} {k} ? v.{c} : " for k, c in enumerate("xyzw"[: type.size - 1]))
    scalar = spelled(vec(Base.I) if type.is_bool else type.scalar)
    text = re.sub(r"\bT\b", spelled(type), _PICK).replace("S {", scalar + " {", 1)
    return text.replace("{name}", name).replace("{choice}", f"{choice}v.{'xyzw'[type.size - 1]}")


def _componentwise(text: str, scalar: str, name: str, size: int) -> str:
    head = re.search(r"^(\w+) \w+\((.*)\) \{$", text, re.MULTILINE)
    assert head is not None
    parameters = [p.split(" ") for p in head[2].split(", ")]
    takes = [f"{t}{size} {p}" for t, p in parameters]
    return _each(f"{head[1]}{size}", name, takes, scalar, [p for _, p in parameters], size)


def _each(result: str, name: str, takes: list[str], scalar: str, names: Iterable[str], size: int) -> str:
    each = ", ".join(f"{scalar}({', '.join(f'{p}.{c}' for p in names)})" for c in "xyzw"[:size])
    return f"{result} {name}({', '.join(takes)}) {{\n    return ({result})({each});\n}}"
