"""Hold arrays of bools as ints, for targets whose compilers cannot index arrays of bools.

Stage: improve, after `prepare`. Mesa's zink aborts the process if a varying index reads a local array of bools.

    $seen: b[4]                   ->  $seen: i[4]
    %x = load $seen[%i] : b       ->  %t = load $seen[%i] : i;  %x = convert %t : b
    store $seen[%i] = %c          ->  %t = convert %c : i;      store $seen[%i] = %t
"""

from __future__ import annotations

from dataclasses import replace

from shpy.ir.nodes import Function, Let, Module, Store, Value, Variable
from shpy.ir.traverse import variables_of
from shpy.ir.types import Base
from shpy.passes.rewriter import Functions, Rewriter, each_function


def hold_bools_as_ints(module: Module) -> Module:
    """Return the module without local arrays of bools; the same object if it has none."""
    if not any(_is_concerned(v) for function in module.functions for v in variables_of(function)):
        return module
    return each_function(module, lambda function, functions: _Ints(function, functions).run())


def _is_concerned(variable: Variable) -> bool:
    return variable.length is not None and variable.type.is_bool


def _slot(variable: Variable) -> Variable:
    return replace(variable, type=variable.type.based(Base.I)) if _is_concerned(variable) else variable


class _Ints(Rewriter):
    def __init__(self, function: Function, functions: Functions) -> None:
        super().__init__(function, functions)
        self.arrays = {v.id for v in variables_of(function) if _is_concerned(v)}

    def run(self) -> Function:
        f = super().run()
        inputs = tuple(i if isinstance(i, Value) else _slot(i) for i in f.inputs)
        return replace(f, inputs=inputs, variables=tuple(map(_slot, f.variables)))

    def let(self, let: Let) -> None:
        if let.op != "load" or let.attr not in self.arrays:
            self.emit(let)
            return
        integer = self.value(let.value.type.based(Base.I))
        self.emit(Let(integer, "load", let.args, let.attr))
        self.emit(Let(let.value, "convert", (integer.id,)))

    def store(self, store: Store) -> None:
        if store.variable in self.arrays:
            number = self.make("convert", store.value, type=self.types[store.value].based(Base.I))
            store = replace(store, value=number)
        self.emit(store)
