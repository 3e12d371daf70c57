"""Fix the working precision: replace base F, the working float, by the base of the precision.

Stage: improve, first of all. Takes a recorded module and returns one in which every F means binary32.

    f32   %a = const 0x1.999999999999ap-4 : f   ->  %a = const 0x1.99999ap-4 : f      (rounded)
    f64   %a = sqrt %x : f                      ->  %a = sqrt %x : d
    f16   %a = sqrt %x : f                      ->  %a = sqrt %x : h                  (half.py does the h)
    f64   %a = float_from_bits %u : f           ->  %b = float_from_bits %u : f
                                                    %a = convert %b : d
    f32   %a = unit_float %u : f                ->  %b = shr %u, 8 : u
                                                    %c = convert %b : f
                                                    %a = mul %c, 0x1p-24 : f          (f16: 21 and 0x1p-11)
    f64   %a = half %x : f                      ->  %b = convert %x : h
                                                    %a = convert %b : d

A conversion between bases that have become one (f to d at f64) is dropped. Constants of floats are rounded to their
base, and so are the initial values of params. A finite constant that would round to infinity is an error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from shpy.errors import CompileError
from shpy.ir.constants import decode, from_array, to_array
from shpy.ir.nodes import Call, Function, Let, Module, Value, Variable
from shpy.ir.types import Base, Type
from shpy.passes.modes import Precision
from shpy.passes.rewriter import Rewriter, each_function

_BASES: dict[Precision, Base] = {"f16": Base.H, "f32": Base.F, "f64": Base.D}


def set_precision(module: Module, precision: Precision = "f32") -> Module:
    """Return the module at this precision of the working float; KeyError for a precision that does not exist.

    Raises CompileError, with the line of the constant, if a finite constant would be infinite at this precision.
    """
    working = _BASES[precision]
    changed = each_function(module, lambda f, functions: _Working(f, functions, Base.F, working).run())
    return retype_ports(changed, Base.F, working)


def retype_ports(module: Module, old: Base, new: Base) -> Module:
    """Change the base of params and tables from `old` to `new`, and round initial values to it."""
    params = tuple(
        replace(p, type=rebased(p.type, old, new), value=rounded(rebased(p.type, old, new), p.value))
        for p in module.params
    )
    tables = tuple(replace(t, type=rebased(t.type, old, new)) for t in module.tables)
    return replace(module, params=params, tables=tables)


@lru_cache(maxsize=4096)
def rounded(type: Type, attr: tuple[int, ...]) -> tuple[int, ...]:
    """Return the constant rounded to its type."""
    return from_array(type, to_array(type, attr))


def rebased(type: Type, old: Base, new: Base) -> Type:
    """Return the type with the base `new` if its base is `old`, else the type itself."""
    return type.based(new) if type.base is old else type


class Rebase(Rewriter):
    """Changes the base of every value and variable from `old` to `new`."""

    def __init__(self, function: Function, functions: Mapping[str, Function], old: Base, new: Base) -> None:
        super().__init__(function, functions)
        self.old, self.new = old, new
        self.old_types: dict[int, Type] = {i.id: i.type for i in function.inputs if isinstance(i, Value)}

    def run(self) -> Function:
        """Return the function with values, inputs, outputs and variables of the new base."""
        f = super().run()
        inputs = tuple(self.retyped(i) if isinstance(i, Value) else self.slot(i) for i in f.inputs)
        outputs, variables = tuple(map(self.slot, f.outputs)), tuple(map(self.slot, f.variables))
        return replace(f, inputs=inputs, outputs=outputs, variables=variables)

    def retyped(self, value: Value) -> Value:
        """Return the value with its new type; `old_types` records its old type."""
        self.old_types[value.id] = value.type
        new = rebased(value.type, self.old, self.new)
        return value if new is value.type else Value(value.id, new, value.name, value.loc)

    def slot(self, variable: Variable) -> Variable:
        """Return the variable with its new type."""
        new = rebased(variable.type, self.old, self.new)
        return variable if new is variable.type else replace(variable, type=new)

    def call(self, call: Call) -> None:
        """Rewrite a Call, so that its results have the new base."""
        self.emit(replace(call, results=tuple(map(self.retyped, call.results))))


class _Working(Rebase):
    def let(self, let: Let) -> None:
        value = self.retyped(let.value)
        if let.op == "const" and value.type.is_float:
            assert isinstance(let.attr, tuple)
            number = _round_constant(value, let.attr)
            self.emit(let if value is let.value and number == let.attr else Let(value, "const", (), number))
        elif let.op == "convert" and rebased(self.old_types[let.args[0]], self.old, self.new) is value.type:
            self.replace(value, let.args[0])
        elif let.op == "float_from_bits" and value.type.base is not Base.F:
            bits = self.value(value.type.based(Base.F))
            self.emit(Let(bits, let.op, let.args))
            self.emit(Let(value, "convert", (bits.id,)))
        elif let.op == "unit_float":
            self._unit(let, value)
        elif let.op == "half" and value.type.base is Base.D:
            rounded_to_half = self.value(value.type.based(Base.H))
            self.emit(Let(rounded_to_half, "convert", let.args))
            self.emit(Let(value, "convert", (rounded_to_half.id,)))
        else:
            self.emit(let if value is let.value else Let(value, let.op, let.args, let.attr))

    def _unit(self, let: Let, value: Value) -> None:
        """Write a fraction of a u's upper bits: as many as the float holds, so that none is rounded up to 1."""
        word, bits = self.old_types[let.args[0]], 11 if value.type.base is Base.H else 24
        count, upper, whole, unit = map(self.value, (word, word, value.type, value.type))
        self.emit(Let(count, "const", (), (32 - bits,) * word.size))
        self.emit(Let(upper, "shr", (*let.args, count.id)))
        self.emit(Let(whole, "convert", (upper.id,)))
        self.emit(Let(unit, "const", (), from_array(unit.type, np.full(unit.type.size, 2.0**-bits))))
        self.emit(Let(value, "mul", (whole.id, unit.id)))


def _round_constant(value: Value, attr: tuple[int, ...]) -> tuple[int, ...]:
    """Return the constant rounded to its type; raise CompileError if a finite number becomes infinite."""
    bits = rounded(value.type, attr)
    if bits == attr:
        return attr
    for number, kept in zip(decode(value.type, attr), decode(value.type, bits), strict=True):
        if math.isinf(kept) and math.isfinite(number):
            precision, wider = {Base.H: ("f16", "f32"), Base.F: ("f32", "f64")}[value.type.base]
            raise CompileError(
                f"{number} is out of the range of f at precision {precision}",
                loc=value.loc,
                cure=f"float('inf') if infinity is meant, or precision=\"{wider}\"",
            )
    return bits
