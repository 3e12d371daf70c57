"""Vectors of 32 and 64 numbers: clang's own types, and OpenCL's functions by halves.

Stage: emit. OpenCL C ends at vectors of 16 numbers. clang has vectors of any length, with OpenCL's operators,
comparisons and parts (`.lo`, `.hi`), so a packet's kernel reads the same at every width. Only the names of types and
functions are missing: this prologue declares those that the kernel uses.

>>> words = Words()
>>> words.add_text("float32 y = floor(x);")
>>> print(declare_wide(words, 32))
// OpenCL C has vectors of up to 16 numbers. Longer ones are clang's; functions take them by halves.
typedef float float32 __attribute__((ext_vector_type(32)));
<BLANKLINE>
__attribute__((overloadable)) float32 floor(float32 a) {
    return (float32)(floor(a.lo), floor(a.hi));
}
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from shpy.backend.opencl.text.operations import NATIVE, UNARY

LONGEST: Final = 16
"""Numbers of OpenCL C's longest vector."""

_HEAD: Final = (
    f"// OpenCL C has vectors of up to {LONGEST} numbers. Longer ones are clang's; functions take them by halves."
)
_OVER: Final = "__attribute__((overloadable))"
_SCALARS: Final = ("float", "double", "int", "uint", "long", "ulong", "uchar", "ushort")
_FLOATS: Final = {"float": "int", "double": "long"}
"""The types of floats, and the type that a comparison of each gives."""
_INTS: Final = ("int", "uint")

_FLOAT_ARGUMENTS: Final = {**dict.fromkeys((*UNARY, *NATIVE.values()), 1), "pow": 2, "atan2": 2, "hypot": 2, "fma": 3}
_INT_ARGUMENTS: Final = {"min": 2, "max": 2, "clamp": 3, "clz": 1, "popcount": 1}
_TESTS: Final = ("isnan", "isinf")


def try_wide(n: int) -> str:
    """Return statements on a `float16 *a` that use every feature of clang that packets of n lanes need.

    They double the odd ones of 16 numbers and reverse the order of all.
    """
    pieces = ", ".join(["a[0]"] * (n // LONGEST))
    reverse = ", ".join(map(str, range(n - 1, -1, -1)))
    types = "".join(f"typedef {t} {t}{n} __attribute__((ext_vector_type({n}))); " for t in ("float", "int"))
    return f"""\
{types}float{n} x = (float{n})({pieces});
    int{n} odd = __builtin_convertvector(x, int{n}) & 1;
    x = odd == 1 ? x * 2.0f : __builtin_astype(__builtin_astype(x, int{n}), float{n});
    x = __builtin_shufflevector(x, x, {reverse});
    a[0] = x{".hi" * (n // LONGEST // 2)};"""


class Words:
    """The types and functions that a kernel names."""

    def __init__(self) -> None:
        self.types: set[str] = set()
        """Names of types, and names of functions, which may contain the name of a type."""
        self.functions: set[str] = set()

    def add_function(self, name: str) -> None:
        """Add a function that the text calls."""
        self.functions.add(name)
        self.types.add(name)

    def add_text(self, text: str) -> None:
        """Add the names that a text of the prologue uses."""
        self.functions |= set(re.findall(r"\b(\w+)\(", text))
        self.types |= set(re.findall(r"\w+", text))

    def has_type(self, scalar: str, n: int) -> bool:
        """Return whether the text uses the vector of n such scalars, a struct of it, or a conversion to it."""
        type = f"{scalar}{n}"
        structs = {f"{type}x{size}" for size in (2, 3, 4)}
        return not self.types.isdisjoint({type, f"as_{type}", f"convert_{type}", f"convert_{type}_sat", *structs})


def declare_wide(words: Words, lanes: int) -> str:
    """Return declarations of the types and functions that a kernel uses of vectors of `lanes`; '' up to LONGEST.

    Functions of 64 numbers call those of 32.
    """
    if lanes <= LONGEST:
        return ""
    scalars = [t for t in _SCALARS if words.has_type(t, lanes)]
    declared: list[str] = []
    functions: list[str] = []
    width = lanes
    while width > LONGEST:
        definitions = _functions(words, width, scalars)
        functions = [*definitions, *functions]
        words.add_text("\n".join(definitions))
        macros = list(_macros(words, width))
        declared = [*macros, *declared]
        words.add_text("\n".join(macros))
        declared = [*_types(words, width), *declared]
        width //= 2
    return "\n\n".join(["\n".join([_HEAD, *declared]), *functions])


def _types(words: Words, n: int) -> list[str]:
    return [f"typedef {t} {t}{n} __attribute__((ext_vector_type({n})));" for t in _SCALARS if words.has_type(t, n)]


def _macros(words: Words, n: int) -> Iterator[str]:
    """Yield conversions and stores of n numbers that a kernel uses."""
    for scalar in _SCALARS:
        if f"as_{scalar}{n}" in words.functions:
            yield f"#define as_{scalar}{n}(a) __builtin_astype(a, {scalar}{n})"
        if f"convert_{scalar}{n}" in words.functions:
            yield f"#define convert_{scalar}{n}(a) __builtin_convertvector(a, {scalar}{n})"
    if f"vstore{n}" in words.functions:
        half = f"vstore{n // 2}"
        yield f"#define vstore{n}(a, at, to) ({half}((a).lo, 2 * (at), to), {half}((a).hi, 2 * (at) + 1, to))"


def _functions(words: Words, n: int, scalars: list[str]) -> list[str]:
    """Return the functions of n numbers that a kernel uses, each for the types of these scalars."""
    floats, ints = ([t for t in types if t in scalars] for types in (_FLOATS, _INTS))
    used = words.functions
    definitions = [
        _by_halves(name, t, [t] * k, n) for name, k in _FLOAT_ARGUMENTS.items() if name in used for t in floats
    ]
    definitions += [_by_halves(name, t, [t] * k, n) for name, k in _INT_ARGUMENTS.items() if name in used for t in ints]
    definitions += [_by_halves(name, _FLOATS[t], [t], n) for name in _TESTS if name in used for t in floats]
    definitions += [_by_halves("ldexp", t, [t, "int"], n) for t in floats if "ldexp" in used]
    for t in ints:
        if f"convert_{t}{n}_sat" in used:
            definitions += [_by_halves(f"convert_{t}{n}_sat", t, [f], n, f"convert_{t}{n // 2}_sat") for f in floats]
    if f"vload_half{n}" in used:
        definitions += [_half_load(n), _half_store(n)]
    return definitions


def _by_halves(name: str, result: str, takes: list[str], n: int, half: str = "") -> str:
    names = "abc"[: len(takes)]
    parameters = ", ".join(f"{t}{n} {a}" for t, a in zip(takes, names, strict=True))
    low, high = (", ".join(f"{a}.{part}" for a in names) for part in ("lo", "hi"))
    half = half or name
    return f"""\
{_OVER} {result}{n} {name}({parameters}) {{
    return ({result}{n})({half}({low}), {half}({high}));
}}"""


def _half_load(n: int) -> str:
    load = f"vload_half{n // 2}"
    return f"""\
float{n} vload_half{n}(size_t at, half *from) {{
    return (float{n})({load}(2 * at, from), {load}(2 * at + 1, from));
}}"""


def _half_store(n: int) -> str:
    store = f"vstore_half{n // 2}_rte"
    return f"""\
void {store.replace(str(n // 2), str(n))}(float{n} a, size_t at, half *to) {{
    {store}(a.lo, 2 * at, to);
    {store}(a.hi, 2 * at + 1, to);
}}"""
