"""Vectors of 32 and 64 numbers: clang's own types, and OpenCL's functions by halves.

Stage: emit. OpenCL C ends at vectors of 16 numbers. clang has vectors of any length, with the operators, comparisons
and parts (`.lo`, `.hi`) of OpenCL's, so a packet's kernel reads the same at every width. Only names are missing: this
prologue declares those that the kernel uses.

>>> print(declare_wide("float32 y = floor(x);", 32))
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

__all__ = ["LONGEST", "declare_wide", "try_wide"]

LONGEST: Final = 16
"""Numbers of OpenCL C's longest vector."""

_HEAD: Final = (
    f"// OpenCL C has vectors of up to {LONGEST} numbers. Longer ones are clang's; functions take them by halves."
)
_OVER: Final = "__attribute__((overloadable))"
_SCALARS: Final = ("float", "double", "int", "uint", "long", "ulong", "uchar", "ushort")
_FLOATS: Final = {"float": "int", "double": "long"}
"""The types that functions of floats take, and what their comparisons give."""
_INTS: Final = ("int", "uint")

_UNARY: Final = (
    "floor ceil trunc rint sqrt rsqrt fabs sign exp exp2 log log2 log10 sin cos tan asin acos atan sinh cosh tanh "
    "asinh acosh atanh native_sqrt native_rsqrt native_exp native_exp2 native_log native_log2 native_log10 native_sin "
    "native_cos native_tan".split()
)
_FLOAT_ARGUMENTS: Final = {**dict.fromkeys(_UNARY, 1), "pow": 2, "atan2": 2, "fma": 3}
_INT_ARGUMENTS: Final = {"min": 2, "max": 2, "clamp": 3, "clz": 1, "popcount": 1}
_TESTS: Final = ("isnan", "isinf")


def try_wide(n: int) -> str:
    """Statements on a `float16 *a` that need all of clang that packets of n lanes do.

    They double the odd ones of 16 numbers and reverse their order.
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


def declare_wide(text: str, lanes: int) -> str:
    """Declare the types and functions of vectors of `lanes` numbers that a kernel's text uses; '' up to LONGEST.

    Functions of 64 numbers call those of 32.
    """
    if lanes <= LONGEST:
        return ""
    scalars = [t for t in _SCALARS if _occurs(t, lanes, text)]
    declared: list[str] = []
    functions: list[str] = []
    width = lanes
    while width > LONGEST:
        functions = [*_functions("\n".join([text, *functions]), width, scalars), *functions]
        declared = [*_macros("\n".join([text, *declared, *functions]), width), *declared]
        declared = [*_types("\n".join([text, *functions]), width), *declared]
        width //= 2
    return "\n\n".join(["\n".join([_HEAD, *declared]), *functions])


def _occurs(scalar: str, n: int, text: str) -> bool:
    """Return whether a text names the type of n such numbers, or a struct or conversion of them."""
    return re.search(rf"(\b|_){scalar}{n}(\b|x|_)", text) is not None


def _types(text: str, n: int) -> list[str]:
    return [f"typedef {t} {t}{n} __attribute__((ext_vector_type({n})));" for t in _SCALARS if _occurs(t, n, text)]


def _macros(text: str, n: int) -> Iterator[str]:
    """Conversions and stores of n numbers that a text uses."""
    for scalar in _SCALARS:
        if re.search(rf"\bas_{scalar}{n}\(", text):
            yield f"#define as_{scalar}{n}(a) __builtin_astype(a, {scalar}{n})"
        if re.search(rf"\bconvert_{scalar}{n}\(", text):
            yield f"#define convert_{scalar}{n}(a) __builtin_convertvector(a, {scalar}{n})"
    if re.search(rf"\bvstore{n}\(", text):
        half = f"vstore{n // 2}"
        yield f"#define vstore{n}(a, at, to) ({half}((a).lo, 2 * (at), to), {half}((a).hi, 2 * (at) + 1, to))"


def _functions(text: str, n: int, scalars: list[str]) -> list[str]:
    """The functions of n numbers that a text uses, each for the types of these scalars."""
    floats, ints = ([t for t in types if t in scalars] for types in (_FLOATS, _INTS))
    used = set(re.findall(r"\b(\w+)\(", text))
    made = [_by_halves(name, t, [t] * k, n) for name, k in _FLOAT_ARGUMENTS.items() if name in used for t in floats]
    made += [_by_halves(name, t, [t] * k, n) for name, k in _INT_ARGUMENTS.items() if name in used for t in ints]
    made += [_by_halves(name, _FLOATS[t], [t], n) for name in _TESTS if name in used for t in floats]
    made += [_by_halves("ldexp", t, [t, "int"], n) for t in floats if "ldexp" in used]
    for t in ints:
        if f"convert_{t}{n}_sat" in used:
            made += [_by_halves(f"convert_{t}{n}_sat", t, [f], n, f"convert_{t}{n // 2}_sat") for f in floats]
    if f"vload_half{n}" in used:
        made += [_half_load(n), _half_store(n)]
    return made


def _by_halves(name: str, result: str, takes: list[str], n: int, half: str = "") -> str:
    names = "abc"[: len(takes)]
    given = ", ".join(f"{t}{n} {a}" for t, a in zip(takes, names, strict=True))
    low, high = (", ".join(f"{a}.{part}" for a in names) for part in ("lo", "hi"))
    half = half or name
    return f"""\
{_OVER} {result}{n} {name}({given}) {{
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
