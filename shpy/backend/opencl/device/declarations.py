"""Declarations of OpenCL C's functions, for a compiler that reads its header anew for each program.

Stage: run. For each program PoCL reads clang's header `opencl-c.h` with 14,000 declarations, which takes longer than to
compile most kernels. Where the header's guard is defined, it is empty. So the text gets the declarations of the
functions that it calls, by section 6.12 of the OpenCL C 1.2 specification, and compiles to the same code. A function is
declared for all its types, so that a call means what it means with the whole header.

>>> print(declarations("__kernel void twice(__global int *a) { a[get_global_id(0)] *= 2; }"))
size_t __attribute__((overloadable, const)) get_global_id(uint);
#line 1
<BLANKLINE>
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import Final

from shpy.backend.opencl.text.operations import NATIVE, UNARY

GUARD: Final = "-D_OPENCL_H_"
"""The option that makes the header empty."""

_SIZES: Final = ("", "2", "3", "4", "8", "16")
_INTS: Final = ("char", "uchar", "short", "ushort", "int", "uint", "long", "ulong")
_FLOATS: Final = ("float", "double")
_SPACES: Final = ("__global", "__local", "__private")

_CONST: Final = "__attribute__((overloadable, const))"
_PURE: Final = "__attribute__((overloadable, pure))"
_PLAIN: Final = "__attribute__((overloadable))"

_FORMS: Final = (
    (" ".join(UNARY), _FLOATS, ("T(T)",)),
    ("pow atan2 hypot", _FLOATS, ("T(T, T)",)),
    ("fma mad", _FLOATS, ("T(T, T, T)",)),
    (" ".join(NATIVE.values()), ("float",), ("T(T)",)),
    ("isnan isinf", _FLOATS, ("B(T)",)),
    ("any all", ("char", "short", "int", "long"), ("int(T)",)),
    ("popcount clz", _INTS, ("T(T)",)),
    ("min max", (*_INTS, *_FLOATS), ("T(T, T)", "T(T, S)")),
    ("clamp", (*_INTS, *_FLOATS), ("T(T, T, T)", "T(T, S, S)")),
)
"""Functions without effects, their types, and their forms: `T` is a vector or a number, `S` a component of it, and `B`
holds its truth values."""

_PLACES: Final = frozenset(
    "get_global_id get_global_size get_global_offset get_local_id get_local_size get_group_id get_num_groups".split()
)
_ATOMIC: Final = frozenset("atomic_inc atomic_dec atomic_add atomic_sub atomic_min atomic_max atomic_or".split())
_NUMBERS: Final = {
    "INFINITY": "(__builtin_inff())",
    "NAN": '(__builtin_nanf(""))',
    "INT_MAX": "2147483647",
    "INT_MIN": "(-2147483647 - 1)",
    "UINT_MAX": "0xffffffffU",
    "CLK_LOCAL_MEM_FENCE": "0x01",
    "CLK_GLOBAL_MEM_FENCE": "0x02",
}

_CONVERSION: Final = re.compile(r"convert_([a-z]+)(|2|3|4|8|16)(?:_sat)?(?:_rt[ezpn])?")
_ACCESS: Final = re.compile(r"(vload|vstore)()(2|3|4|8|16)")
_HALF_ACCESS: Final = re.compile(r"(vload|vstore)_(half)(|2|3|4|8|16)(?:_rt[ezpn])?")
_VIEW: Final = re.compile(r"as_([a-z]+)(|2|3|4|8|16)")
_WORD: Final = re.compile(r"\b[A-Za-z_]\w*\b")


def declarations(text: str, *, doubles: bool = False) -> str:
    """Return the lines to put before a text, which keeps the numbers of its own; `doubles`: the device has binary64."""
    words = sorted(set(_WORD.findall(text)))
    lines = [line for word in words for line in _declarations(word) if doubles or "double" not in line]
    start = ["#pragma OPENCL EXTENSION cl_khr_fp64 : enable"] if doubles else []
    return "\n".join([*start, *lines, "#line 1\n"])


def _declarations(name: str) -> tuple[str, ...]:
    """Return the declarations of a function or number of OpenCL C; none for any other word."""
    if name in _NUMBERS:
        return (f"#define {name} {_NUMBERS[name]}",)
    if name in _PLACES:
        return (f"size_t {_CONST} {name}(uint);",)
    if name == "mem_fence":
        return (f"void {_PLAIN} mem_fence(uint);",)
    if name in _ATOMIC:
        value = "" if name in ("atomic_inc", "atomic_dec") else ", {0}"
        kinds = [(space, base) for space in _SPACES[:2] for base in ("int", "uint")]
        return tuple(f"{t} {_PLAIN} {name}(volatile {space} {t} *{value.format(t)});" for space, t in kinds)
    for pattern, declare in _PATTERNS.items():
        match = pattern.fullmatch(name)
        if match is not None:
            return tuple(declare(name, *match.groups()))
    return tuple(_pure_functions().get(name, ()))


@cache
def _pure_functions() -> dict[str, list[str]]:
    """Return the declarations of the functions of `_FORMS` by name."""
    declarations: dict[str, list[str]] = {}
    for names, bases, forms in _FORMS:
        for name in names.split():
            declarations[name] = [
                line for base in bases for n in _SIZES for form in forms for line in _declared(name, base, n, form)
            ]
    return declarations


def _declared(name: str, base: str, n: str, form: str) -> Iterator[str]:
    """Yield the declaration of one form for one type; numbers have no form with a component."""
    if "S" in form and not n:
        return
    truth = "int" if not n else f"{'long' if base == 'double' else 'int'}{n}"
    result, operands = form.replace("T", base + n).replace("S", base).replace("B", truth).split("(")
    yield f"{result} {_CONST} {name}({operands};"


def _conversion(name: str, base: str, n: str) -> Iterator[str]:
    if base in (*_INTS, *_FLOATS):
        for source in (*_INTS, *_FLOATS):
            yield f"{base}{n} {_CONST} {name}({source}{n});"


def _access(name: str, way: str, half: str, n: str) -> Iterator[str]:
    """Yield the forms of `vload8`, `vstore8`, `vload_half8` or `vstore_half8_rte` for each type and address space."""
    loads = way == "vload"
    for base in (*_INTS, *_FLOATS) if not half else ("float",) if loads else _FLOATS:
        for space in ("__constant", *_SPACES) if loads else _SPACES:
            if loads:
                yield f"{base}{n} {_PURE} {name}(size_t, const {space} {half or base} *);"
            else:
                yield f"void {_PLAIN} {name}({base}{n}, size_t, {space} {half or base} *);"


def _view(name: str, base: str, n: str) -> Iterator[str]:
    yield f"#define {name}(x) __builtin_astype((x), {base}{n})"


_PATTERNS: Final[dict[re.Pattern[str], Callable[..., Iterator[str]]]] = {
    _CONVERSION: _conversion,
    _ACCESS: _access,
    _HALF_ACCESS: _access,
    _VIEW: _view,
}
