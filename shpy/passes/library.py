"""Composite operations and transcendentals as functions of plain operations: the library that `lower` calls.

Stage: improve. `definition("reflect", (f3, f3))` gives the pure function

    reflect3(i : f3, n : f3) -> f3 { i - 2.0 * dot(n, i) * n }

Composites are defined in `ir/meaning.py`. The same definition runs on arrays, so that every target gives the same bits.
Definitions may use other composites; `lower` lowers those in turn. A definition's parameter names are those of the
emitted function. Transcendentals are those of `formulas`, which is imported when the first one is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

from shpy.ir.names import fresh
from shpy.ir.nodes import Function, Module
from shpy.ir.ops import OPS, TRANSCENDENTALS
from shpy.ir.types import Base, Type
from shpy.passes.formulas.rounding import to_odd
from shpy.passes.formulas.terms import Term, define
from shpy.passes.fuse import FUSED, fuse_function
from shpy.passes.modes import Formulas


def _half_fma(a: Term, b: Term, c: Term) -> Term:
    """Return a * b + c of binary16 numbers, rounded once: the product is exact in binary32, the sum rounds to odd."""
    product = (a * b).named("product")
    total = (product + c).named("total")
    back = (total - product).named("back")
    error = (product - (total - back)) + (c - back)
    return to_odd(total, error).op("half", type=a.type)


def _half_from_double(x: Term) -> Term:
    """Return a binary64 rounded once to binary16, by way of binary32 rounded to odd."""
    narrow = x.op("convert", type=x.type.based(Base.F)).named("narrow")
    error = (x - narrow.op("convert", type=x.type)).op("convert", type=narrow.type)
    return to_odd(narrow, error).op("half", type=narrow.type)


_ROUNDINGS: dict[str, Callable[..., Term]] = {"half_fma": _half_fma, "half_from_double": _half_from_double}
"""The functions that `lower_half` calls."""

PARTS = frozenset({"payne_hanek", "sin_strict", "cos_strict", "tan_strict"})
"""Operations that occur only in definitions: functions that several definitions call."""

SELDOM = frozenset({"payne_hanek"})
"""The parts that a branch calls, for few arguments."""

BOUNDED = {name: f"{name}_bounded" for name in ("sin", "cos", "tan")}
"""Replacements of functions that a target computes within the error bounds for small angles only."""

HALVES = {f"{name}_half": name for name in TRANSCENDENTALS}
"""For each function that rounds a result in binary32 to binary16, the function whose result it rounds."""

CORRECTABLE = frozenset({"div", "sqrt", "fma", "convert_nan"})
"""Operations of binary32 that `formulas/arithmetic.py` corrects for devices that round them wrong or have none.

"convert_nan" is the conversion of a float to an int where it gives anything but 0 for a NaN; `lower` corrects it.
"""


def is_exact(name: str, type: Type, formulas: Formulas) -> bool:
    """Return whether an operation on this type is an elementary function that gives the exact value rounded once."""
    return name in TRANSCENDENTALS and type.base is Base.F and formulas not in ("portable", "fast")


@cache
def definition(name: str, types: tuple[Type, ...], formulas: Formulas = "doubles") -> Function:
    """Return the pure function for operation `name` on these types, such as `dot3`, `sin_strict`, `sin_strict_d2`.

    `formulas` are those of transcendentals.
    """
    first = types[0]
    if name in PARTS or name in BOUNDED.values():
        return _part(name, types)
    if is_exact(name, first, formulas):
        called = f"{name}_strict{first.size if first.size > 1 else ''}"
        from shpy.passes.formulas.strict import rounded

        return define(called, rounded(name), types, fused=formulas == "fused")
    if name in TRANSCENDENTALS:
        from shpy.passes.formulas import fast
        from shpy.passes.formulas.portable import FUNCTIONS

        base = "_d" if first.base is Base.D else ""
        if formulas == "fast" and name in fast.FUNCTIONS and (not base or name == "pow"):
            return define(f"{name}_fast{base}{first.size if first.size > 1 else ''}", fast.FUNCTIONS[name], types)
        mode = "portable" if formulas in ("portable", "fast") and not base else "strict"
        return define(f"{name}_{mode}{base}{first.size if first.size > 1 else ''}", FUNCTIONS[name], types)
    if name in HALVES:
        from shpy.passes.formulas.strict.halves import correction

        return define(f"{name}{first.size if first.size > 1 else ''}", correction(HALVES[name]), types)
    if name in CORRECTABLE:
        from shpy.passes.formulas.arithmetic import CORRECTED

        return define(f"{name}_corrected{first.size if first.size > 1 else ''}", CORRECTED[name], types)
    if name in _ROUNDINGS:
        return define(f"{name}{first.size}", _ROUNDINGS[name], types)
    meaning = OPS[name].definition
    assert meaning is not None
    return define(f"{name}{first.size}{'d' if first.base is Base.D else ''}", meaning, types)


def _part(name: str, types: tuple[Type, ...]) -> Function:
    """Return a function of PARTS or BOUNDED, which only definitions and `lower` use."""
    from shpy.passes.formulas.portable import payne_hanek

    function, _, which = name.partition("_")
    if which == "strict":
        return definition(function, types)
    base = "_d" if types[0].base is Base.D else ""
    if which == "bounded":
        size = types[0].size
        return define(f"{name}{base}{size if size > 1 else ''}", payne_hanek.BOUNDED[function], types)
    return define(f"{name}{base}", payne_hanek.payne_hanek, types)


class Library:
    """The definitions that a module uses, as functions whose names differ from the module's own.

    With `fuse`, those of the operations in `fuse.FUSED` are contracted.
    """

    def __init__(self, module: Module, formulas: Formulas = "doubles", *, fuse: bool = False) -> None:
        self.module = module
        self.formulas = formulas
        self.fuse = fuse
        self.names_in_use = {f.name for f in module.functions}
        self.functions: dict[Function, Function] = {}

    def use(
        self, name: str, types: tuple[Type, ...], prepare: Callable[[Function], Function] | None = None
    ) -> Function:
        """Return the function for operation `name` on these types; `prepare` rewrites it once, and may call `use`."""
        original = definition(name, types, self.formulas)
        if original not in self.functions:
            function = fuse_function(original, {}) if self.fuse and name in FUSED else original
            function = prepare(function) if prepare else function
            self.functions[original] = replace(function, name=fresh(function.name, self.names_in_use))
        return self.functions[original]

    def added(self, module: Module) -> Module:
        """Return the module with the used definitions in front of its own functions, callees first."""
        return replace(module, functions=(*self.functions.values(), *module.functions))
