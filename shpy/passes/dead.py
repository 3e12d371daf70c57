"""Remove dead code: values without uses, variables that are never read, and empty control flow.

Stage: improve. Effects are stores to outputs and to inputs by reference, calls of functions that are not pure, exits,
and loops without a known bound, which may reach the loop limit. The pass marks all that effects depend on, starting at
the effects, and removes the rest:

    %1 = mul %0, %0          |
    store $y = %1            |   (nothing: $y is never loaded)
    if %c { store $y = %0 }  |

A variable that only feeds itself (`n = n + 1` that nothing else reads) is removed as well. Ports, params, tables and
functions stay declared, since the user named them. `remove_unused_functions` is for a module about to be printed.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

from shpy.ir.nodes import (
    EXITS,
    Break,
    Call,
    Continue,
    Function,
    If,
    Let,
    Loop,
    Module,
    Region,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.traverse import calls_of, rewrite, uses, walk
from shpy.passes.rewriter import Functions, each_function


def remove_dead(module: Module) -> Module:
    """Return the module without statements and variables that have no effect."""
    return each_function(module, without_dead)


def without_dead(function: Function, functions: Functions) -> Function:
    """Return the function without statements and variables that have no effect; `functions` are those it may call."""
    return _Marker(function, functions).swept()


def remove_unused_functions(module: Module) -> Module:
    """Return the module without the functions that its entry does not reach."""
    reached = {module.entry.name}
    for function in reversed(module.functions):
        if function.name in reached:
            reached.update(calls_of(function))
    return replace(module, functions=tuple(f for f in module.functions if f.name in reached))


def remove_unused_inputs(module: Module) -> Module:
    """Return the module without the inputs that pure functions do not read; the same object if all are read.

    A result is then as uniform as the inputs that it depends on, which `vectorize` takes for granted.
    """
    functions: dict[str, Function] = {}
    kept: dict[str, list[int]] = {}
    """By the functions that lose inputs, the places of the others."""

    def shortened(s: Stmt) -> Stmt:
        if not (isinstance(s, Let) and s.op == "call" and s.attr in kept):
            return s
        return replace(s, args=tuple(s.args[k] for k in kept[str(s.attr)]))

    for function in module.functions:  # a function comes after those that it calls
        if kept:
            function = without_dead(replace(function, body=rewrite(function.body, shortened)), functions)
        if function.pure:
            read = {value for s in walk(function.body) for value in uses(s, functions)}
            places = [k for k, port in enumerate(function.inputs) if port.id in read]
            if len(places) < len(function.inputs):
                kept[function.name] = places
                function = replace(function, inputs=tuple(function.inputs[k] for k in places))
        functions[function.name] = function
    return replace(module, functions=tuple(functions.values())) if kept else module


class _Marker:
    """Marks needed values, variables, and Ifs and Loops (by identity); `_todo` holds marks not yet followed."""

    def __init__(self, function: Function, functions: Functions) -> None:
        self.function = function
        self.functions = functions
        self.values: set[int] = set()
        self.variables: set[int] = set()
        self.controls: set[int] = set()
        self._todo: list[int] = []
        self._lets: dict[int, Let] = {}
        self._stores: defaultdict[int, list[tuple[Store, Stmt | None]]] = defaultdict(list)
        self._parents: dict[int, If | Loop | None] = {}
        self._exits: defaultdict[int, list[If | Loop | None]] = defaultdict(list)
        self._effects: list[tuple[Stmt, If | Loop | None]] = []

    def swept(self) -> Function:
        """Return the function with marked statements and variables only."""
        f = self.function
        self._index(f.body, None, None)
        for variable in (*f.outputs, *(i for i in f.inputs if isinstance(i, Variable))):
            self._need_variable(variable.id)
        for effect, control in self._effects:
            self._need_effect(effect, control)
        while self._todo:
            let = self._lets.get(self._todo.pop())
            if let is None:
                continue
            self._need_values(let.args)
            if let.op == "load":
                assert isinstance(let.attr, int)
                self._need_variable(let.attr)
        variables = tuple(v for v in f.variables if v.id in self.variables)
        return replace(f, variables=variables, body=self._sweep(f.body))

    # Marking

    def _index(self, region: Region, control: If | Loop | None, loop: Loop | None) -> None:
        """Record for each statement the enclosing If or Loop, and the innermost loop."""
        for s in region:
            if isinstance(s, Let):
                self._lets[s.value.id] = s
            elif isinstance(s, Store):
                self._stores[s.variable].append((s, control))
            elif isinstance(s, If):
                self._parents[id(s)] = control
                self._index(s.then, s, loop)
                self._index(s.orelse, s, loop)
            elif isinstance(s, Loop):
                self._parents[id(s)] = control
                self._index(s.body, s, s)
                self._index(s.continuing, s, s)
                if s.turns is None:
                    self._effects.append((s, control))
            elif isinstance(s, (Break, Continue)):
                self._exits[id(loop)].append(control)
            else:
                self._effects.append((s, control))

    def _need_effect(self, effect: Stmt, control: If | Loop | None) -> None:
        self._need_control(effect if isinstance(effect, Loop) else control)
        if isinstance(effect, Call):
            for argument, port in zip(effect.args, self.functions[effect.function].inputs, strict=True):
                if isinstance(port, Value):
                    self._need_values((argument,))
                else:
                    self._need_variable(argument)

    def _need_values(self, values: tuple[int, ...]) -> None:
        for value in values:
            if value not in self.values:
                self.values.add(value)
                self._todo.append(value)

    def _need_variable(self, variable: int) -> None:
        if variable in self.variables:
            return
        self.variables.add(variable)
        for store, control in self._stores[variable]:
            self._need_values((store.value,) if store.index is None else (store.value, store.index))
            self._need_control(control)

    def _need_control(self, control: Stmt | None) -> None:
        while isinstance(control, (If, Loop)) and id(control) not in self.controls:
            self.controls.add(id(control))
            if isinstance(control, If):
                self._need_values((control.condition,))
            else:
                if control.until is not None:
                    self._need_values((control.until,))
                for inner in self._exits[id(control)]:
                    self._need_control(inner)
            control = self._parents[id(control)]

    # Sweeping

    def _sweep(self, region: Region) -> Region:
        kept: list[Stmt] = []
        for s in region:
            if isinstance(s, Let):
                if s.value.id in self.values:
                    kept.append(s)
            elif isinstance(s, Store):
                if s.variable in self.variables:
                    kept.append(s)
            elif isinstance(s, If):
                if id(s) in self.controls:
                    kept.append(If(s.condition, self._sweep(s.then), self._sweep(s.orelse), s.loc))
            elif isinstance(s, Loop):
                if id(s) in self.controls:
                    body, continuing = self._sweep(s.body), self._sweep(s.continuing)
                    kept.append(Loop(body, continuing, s.until, s.turns, s.loc))
            elif isinstance(s, EXITS):
                kept.append(s)
            else:
                kept.append(s)
        return tuple(kept)
