"""Inline pure functions whose result does not depend on their arguments.

Stage: improve, once functions are simple. Takes and gives a module. A result that folds to a constant inside a function
becomes a constant outside too. Passes and printers can assume that a call with varying arguments has a varying result.

    pure function f(%a.0: f) -> ($0: f) {
      %1: f = const 0x1p+0                           |
      store $0 = %1                           ->     |   %9: f = const 0x1p+0
    }                                                |
    %9: f = call f(%8)                               |
"""

from __future__ import annotations

from dataclasses import replace

from shpy.ir.builder import Builder
from shpy.ir.nodes import Function, Let, Module, Stmt, Store
from shpy.ir.traverse import Copy, rewrite, walk


def inline_independent(module: Module) -> Module:
    """Return the module without calls of such functions; the same object if it has no such function."""
    lets_by_name: dict[str, tuple[Let, ...]] = {}
    functions = []
    for function in module.functions:
        changed = _inlined(function, lets_by_name) if lets_by_name else function
        functions.append(changed)
        needed = _independent(changed)
        if needed:
            lets_by_name[function.name] = needed
    same = all(a is b for a, b in zip(functions, module.functions, strict=True))
    return module if same else replace(module, functions=tuple(functions))


def _independent(function: Function) -> tuple[Let, ...]:
    """Return the Lets that compute the result, in order, if it depends on no input; else an empty tuple."""
    lets = {s.value.id: s for s in function.body if isinstance(s, Let)}
    stores = [s for s in walk(function.body) if isinstance(s, Store)]
    if not function.pure or len(stores) != 1 or len(lets) + 1 != len(function.body) or stores[0].components:
        return ()
    needed: list[Let] = []
    pending = [stores[0].value]
    while pending:
        let = lets.get(pending.pop())
        if let is None or let.op in ("load", "grid_index"):
            return ()
        needed.append(let)
        pending.extend(let.args)
    order = {id: n for n, id in enumerate(lets)}
    return tuple(sorted({let.value.id: let for let in needed}.values(), key=lambda let: order[let.value.id]))


def _inlined(function: Function, lets_by_name: dict[str, tuple[Let, ...]]) -> Function:
    b = Builder(function=function)

    def change(s: Stmt) -> Stmt | tuple[Stmt, ...]:
        if not (isinstance(s, Let) and s.op == "call" and s.attr in lets_by_name):
            return s
        copy = Copy(lambda type, name, _: b.value(type, name, s.value.loc), {})
        *before, last = lets_by_name[str(s.attr)]
        lets = copy.region(tuple(before))
        return (*lets, replace(last, value=s.value, args=tuple(copy.values[a] for a in last.args)))

    body = rewrite(function.body, change)
    return function if body is function.body else replace(function, body=body)
