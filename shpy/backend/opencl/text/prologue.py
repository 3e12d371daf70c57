"""The prologue of a kernel: functions for operations that OpenCL C lacks or computes otherwise.

Stage: emit. Most are definitions of `passes/formulas/edges.py`; those that use what the IR has no word for are texts
here. C has no overloading, so the form for each type has its own name: `sh_min` (float), `sh_min3` (float3),
`sh_min_d2` (double2). Only functions that are used are printed.
"""

from __future__ import annotations

from collections.abc import Callable
from string import Template
from typing import Final

from shpy.backend.emit.spell_c import row_major
from shpy.ir.types import Base, Type

NOINLINE: Final = "__attribute__((noinline))"
"""The attribute of functions that are large, rarely called, or called from so many places that inlining is slow."""

SCALARS: Final = {Base.F: "float", Base.D: "double", Base.I: "int", Base.U: "uint", Base.B: "bool"}
"""OpenCL's name of one component."""

_NEAREST: Final = """\
// The nearest index in range. Nearly all are in range: a predicted branch costs less than a clamp before the load.
uint sh_at(int i, int size) {
    return __builtin_expect((uint)i < (uint)size, 1) ? (uint)i : (uint)clamp(i, 0, size - 1);
}"""


_BOTH: Final = """\
// Two neighbouring rows in one load; PoCL loads halves of halves where a vector is made of two.
{scalar}8 {name}(__global const {scalar}4 *rows, int i) {{
    return vload8(0, (__global const {scalar} *)(rows + i));
}}"""
_ANY_LONG: Final = """\
// True if any component holds. PoCL's any() of eight components takes them one by one.
bool sh_any_long(int8 mask) {
    ulong4 a = as_ulong4(mask);
    ulong2 b = a.lo | a.hi;
    return (b.x | b.y) != 0;
}"""


def _powers_of_two(bias: int, mantissa: int, wide: str) -> str:
    """Return the text of ldexp for floats of this bias and mantissa; `wide` converts to ints of their size."""
    lowest, highest = 1 - bias, bias
    return f"""\
// x * 2^n rounded once: by three powers of two, and what the first two round becomes 0 by the last.
$T $name($T x, $INT n) {{
    $INT last = clamp(n, ($INT)({lowest}), ($INT)({highest}));
    $INT middle = clamp(n - last, ($INT)({lowest}), ($INT)({highest}));
    $INT first = clamp(n - last - middle, ($INT)({lowest}), ($INT)({highest}));
    x *= as_$T({wide}(first + {bias}) << {mantissa});
    x *= as_$T({wide}(middle + {bias}) << {mantissa});
    return x * as_$T({wide}(last + {bias}) << {mantissa});
}}"""


_MINUS_ZERO: Final = """\
// -0.0, hidden from LLVM, which replaces it by 0.0 in a choice by a comparison.
$T $name(void) {
    volatile BITS;
    return as_$T(bits);
}"""
_ZERO: Final = """\
// 0.0, hidden from the compiler, which would replace 0 * x by 0.
$T $name(void) {
    return as_$T((BITS)get_global_offset(2));
}"""
_WHOLE_ZERO: Final = """\
// 0, hidden from the compiler, which would compute the number of a loop's iterations from it, wrongly.
$T $name(void) {
    return ($T)get_global_offset(2);
}"""
_NAN: Final = """\
// Returns a NaN unchanged: PoCL's compiler may replace the $op of a NaN by any number.
$T $name($T x) {
    return x == x ? $op(x) : x;
}"""
NAN_LOST: Final = frozenset({"exp", "exp2", "sinh", "tanh"})
"""Functions whose implementation converts to an int; the compiler may give any result for a NaN there."""

_TEXTS: Final = {
    # PoCL's own ldexp rounds denormal results twice in vectors, and rusticl's flushes them to zero.
    ("ldexp", Base.F): _powers_of_two(127, 23, ""),
    ("ldexp", Base.D): _powers_of_two(1023, 52, "convert_$LONG"),
    ("half", Base.F): """\
// x rounded to binary16.
$T $name($T x) {
    $USHORT bits;
    vstore_half${size}_rte(x, 0, (half *)&bits);
    return vload_half$size(0, (half *)&bits);
}""",
    ("minus_zero", Base.F): _MINUS_ZERO.replace("BITS", "uint bits = 0x80000000u"),
    ("minus_zero", Base.D): _MINUS_ZERO.replace("BITS", "ulong bits = 0x8000000000000000ul"),
    ("zero", Base.F): _ZERO.replace("BITS", "int"),
    ("zero", Base.D): _ZERO.replace("BITS", "long"),
    ("zero", Base.I): _WHOLE_ZERO,
    ("zero", Base.U): _WHOLE_ZERO,
    **{(op, base): _NAN for op in NAN_LOST for base in (Base.F, Base.D)},
}
"""Texts of functions for numbers and vectors, by operation and base."""
BY_COMPONENT: Final = frozenset({"sin", "cos", "tan", "half"})
"""Operations whose vector forms drivers compute wrongly: PoCL 3.1 gives sin(1e-8) = 0.008 beside a large component."""
_SHORT: Final = {"bits_from_float": "bits", "component": "pick"}


def spelled(type: Type) -> str:
    """Return OpenCL's name of a type; a vector of bools is one of ints, -1 for true. Raise KeyError for a binary16."""
    if type.base is Base.B and type.size > 1:
        return f"int{type.size}"
    return SCALARS[type.base] if type.size == 1 else f"{SCALARS[type.base]}{type.size}"


def name_of(op: str, type: Type) -> str:
    """Return the name of the function that computes `op` for a first argument of `type`."""
    base = "" if type.base is Base.F else f"_{type.base.value}"
    return f"sh_{_SHORT.get(op, op)}{base}{type.size if type.size > 1 else ''}"


def filled(text: str, op: str, type: Type) -> str:
    """Return a function's text with its name, the operation and its types: `$T` is `type`, `$INT` as many ints."""
    size = str(type.size) if type.size > 1 else ""
    words = {word: f"{word.lower()}{size}" for word in ("INT", "LONG", "USHORT")}
    return Template(text).substitute(words, T=spelled(type), op=op, name=name_of(op, type), size=size)


class Prologue:
    """The functions that one kernel uses, in the order in which they were asked for."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def ask(self, name: str, text: Callable[[], str]) -> str:
        """Add the function of this name, unless it is there; return the name."""
        if name not in self._texts:
            written = text()  # the text may ask for other functions
            self._texts[name] = written
        return name

    def written(self, op: str, type: Type) -> str | None:
        """Return the function that computes `op`, or None where its definition is to be printed."""
        text = _TEXTS.get((op, type.base))
        return None if text is None else filled(text, op, type)

    def flat_index(self, rank: int) -> str:
        """Add the function that computes the flat index in a table of `rank` axes, 1 to 3; return its name."""
        name = f"sh_at{rank if rank > 1 else ''}"
        return self.ask(name, lambda: _NEAREST if rank == 1 else _flat(name, rank))

    def both_rows(self, base: Base) -> str:
        """Add the function that reads two neighbouring rows of four as one vector; return its name."""
        name, scalar = f"sh_both_{base.value}", SCALARS[base]
        return self.ask(name, lambda: _BOTH.format(name=name, scalar=scalar))

    def any_long(self) -> str:
        """Add the function that tells whether a component of a vector of eight holds; return its name."""
        return self.ask("sh_any_long", lambda: _ANY_LONG)

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
