"""Make less general modules: inputs and params become constants, outputs are left out.

Stage: improve; also what `Program.specialize` does to a recorded module.

    specialise(module, {"n": (8,)})        input n: Attrib1i      ->   %n = const 8, and no input n
    specialise(module, {}, {"sky": ...})   %1 = param sky         ->   %1 = const ..., and no param sky
    select_outputs(module, [0, 2])         outputs a, b, c        ->   outputs a, c; what only b needed is gone

Constants are attributes of a `const` (see `ir/constants.py`); folding is left to `fold`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from shpy.errors import ShpyTypeError
from shpy.ir.nodes import Function, Let, Module, Stmt, Value
from shpy.passes.dead import remove_dead
from shpy.passes.dead_stores import remove_dead_stores
from shpy.passes.rewriter import Functions, Rewriter, each_function

Constants = Mapping[str, tuple[int, ...]]


def specialise(module: Module, inputs: Constants, params: Constants | None = None) -> Module:
    """Make constants of inputs and params, given by name; ShpyTypeError for a name that the module lacks."""
    params = params or {}
    _check(inputs, [p.name for p in module.inputs], "input")
    _check(params, [p.name for p in module.params], "param")
    fixed: dict[int, tuple[int, ...]] = {}
    kept: list[Value] = []
    for port, value in zip(module.inputs, module.entry.inputs, strict=True):
        assert isinstance(value, Value)
        if port.name in inputs:
            fixed[value.id] = inputs[port.name]
        else:
            kept.append(value)
    constants = tuple(
        Let(value, "const", (), fixed[value.id])
        for value in module.entry.inputs
        if isinstance(value, Value) and value.id in fixed
    )
    body: tuple[Stmt, ...] = (*constants, *module.entry.body)
    entry = replace(module.entry, inputs=tuple(kept), body=body)
    changed = replace(
        module,
        inputs=tuple(p for p in module.inputs if p.name not in inputs),
        params=tuple(p for p in module.params if p.name not in params),
        functions=(*module.functions[:-1], entry),
    )
    return each_function(changed, lambda f, functions: _Params(f, functions, params).run()) if params else changed


def _check(given: Constants, known: Sequence[str], what: str) -> None:
    for name in given:
        if name not in known:
            raise ShpyTypeError(f"there is no {what} {name!r}; there is {', '.join(known) or 'none'}")


class _Params(Rewriter):
    def __init__(self, function: Function, functions: Functions, params: Constants) -> None:
        super().__init__(function, functions)
        self.params = params

    def let(self, let: Let) -> None:
        if let.op == "param" and let.attr in self.params:
            let = Let(let.value, "const", (), self.params[str(let.attr)])
        self.emit(let)


def select_outputs(module: Module, indices: Sequence[int]) -> Module:
    """Return the module with these of its entry's outputs, in this order, and without what the others needed.

    A status output, which no port describes, is the entry's last: it stays where its index is given, last.
    """
    entry = module.entry
    outputs = tuple(entry.outputs[i] for i in indices)
    others = tuple(o for i, o in enumerate(entry.outputs) if i not in set(indices))
    ports = tuple(module.outputs[i] for i in indices if i < len(module.outputs))
    fewer = replace(entry, outputs=outputs, variables=(*entry.variables, *others))
    selected = replace(module, outputs=ports, functions=(*module.functions[:-1], fewer))
    return remove_dead(remove_dead_stores(remove_dead(selected)))
