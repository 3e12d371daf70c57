"""Vectorise subroutines: make a copy of a function for each combination of uniform and varying arguments.

Stage: improve. Part of `vectorize`. There is a copy for each set of varying arguments, and another for calls at which
only some lanes are active. The latter takes the mask of active lanes as its last argument, unless it never reads it:

    %r = call tone(%n, %k)       ->      %r = call tone(%n, %k, %active)      # n varies, k and r do not

A result is uniform if the copy's output is uniform, even where arguments vary.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from shpy.ir.names import fresh
from shpy.ir.nodes import Call, Function, Let, Module, Stmt, Store, Value
from shpy.ir.ops import LANE_OPS
from shpy.ir.traverse import defined, rewrite, uses, walk
from shpy.passes.dead import without_dead
from shpy.passes.dead_stores import without_dead_stores
from shpy.passes.lanes import BOOL, Here, LaneBuilder
from shpy.passes.lines import placed
from shpy.passes.returns import returns_outside_loops


@dataclass(frozen=True, slots=True)
class LaneFacts:
    """The varying values of a function that many lanes run at once.

    `varying` are the ids of the values, and `slots` those of the variables, that hold a separate number for each lane.
    `live` are the slots among them that hold the mask of lanes still in a loop.
    """

    varying: frozenset[int]
    slots: frozenset[int]
    live: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class LaneFunction:
    """A function for many lanes, copied from the function named `of`. `masked`: its last input is the active mask."""

    function: Function
    of: str
    facts: LaneFacts
    masked: bool = False


Make = Callable[[Function, frozenset[int], Value | None, "Callees"], tuple[Function, LaneFacts]]
"""Vectorises a function whose Returns are outside loops, given its varying inputs and the input that is the mask."""


class Callees:
    """The copies of functions; `make` vectorises each at its first use."""

    def __init__(self, module: Module, make: Make, *, alone: bool = False) -> None:
        """With `alone`, functions marked as alone are not vectorised: they get the active mask as one more input."""
        self.module = module
        self.make = make
        self.functions = {f.name: f for f in module.functions}
        self.alone = {f.name: _with_mask(f) for f in module.functions if f.alone and alone}
        self.placed = placed(module)
        self.statuses = _statuses(module)
        self.names_in_use = set(self.functions)
        self.copies_by_key: dict[tuple[str, tuple[bool, ...], bool], LaneFunction] = {}
        self.copies: dict[str, Function] = dict(self.alone)

    def entry(self) -> LaneFunction:
        """Return the entry, whose inputs all vary."""
        entry = self.module.entry
        return self._copy(entry, entry.name, frozenset(port.id for port in entry.inputs), None)

    def called(self, name: str, varying: tuple[bool, ...], *, masked: bool) -> LaneFunction:
        """Return the copy for these varying arguments; `masked`: it is called where only some lanes are active."""
        key = name, varying, masked
        if key in self.copies_by_key:
            return self.copies_by_key[key]
        function = self.functions[name]
        varying_inputs = frozenset(port.id for port, varies in zip(function.inputs, varying, strict=True) if varies)
        mask = None
        if masked:
            mask = Value(max((v.id for v in defined(function)), default=-1) + 1, BOOL, "active")
            function = replace(function, inputs=(*function.inputs, mask))
            varying_inputs |= {mask.id}
        copy = self._copy(function, fresh(name, self.names_in_use), varying_inputs, mask)
        self.copies_by_key[key] = copy
        self.copies[copy.function.name] = copy.function
        return copy

    def _copy(self, function: Function, name: str, varying_inputs: frozenset[int], mask: Value | None) -> LaneFunction:
        function, of = replace(function, name=name), function.name
        copy, facts = self.make(returns_outside_loops(function, self.statuses.get(of)), varying_inputs, mask, self)
        copy = without_dead(without_dead_stores(copy, self.copies), self.copies)
        masked = mask is not None and any(mask.id in uses(s) for s in walk(copy.body))
        if mask is not None and not masked:
            copy = replace(copy, inputs=copy.inputs[:-1])
        slots = {v.id for v in (*copy.outputs, *copy.variables)}
        values = {v.id for v in defined(copy)}
        return LaneFunction(
            copy, of, LaneFacts(facts.varying & values, facts.slots & slots, facts.live & slots), masked
        )

    def named(self, entry: LaneFunction) -> dict[str, LaneFunction]:
        """Return the entry and the copies it needs, callees first; the first copy of a function keeps its name."""
        needed = {entry.function.name}
        for copy in (entry, *reversed(self.copies_by_key.values())):
            if copy.function.name in needed:
                needed |= {s.function for s in walk(copy.function.body) if isinstance(s, Call)}
        names: dict[str, str] = {}
        named: set[str] = set()
        names_in_use = set(self.functions)
        kept = [copy for copy in (*self.copies_by_key.values(), entry) if copy.function.name in needed]
        for copy in kept:
            name = fresh(copy.of, names_in_use) if copy.of in named else copy.of
            names[copy.function.name] = name
            named.add(name)
        renamed = [replace(copy, function=_renamed(copy.function, names)) for copy in kept]
        return {copy.function.name: copy for copy in renamed}


def _statuses(module: Module) -> dict[str, int]:
    """Return the id of the status output of each function that has one, by the function's name.

    The entry has a status if it has more outputs than the module. A callee has one if its caller stores the last result
    of the call into its own status.
    """
    entry = module.entry
    statuses = {entry.name: entry.outputs[-1].id} if len(entry.outputs) > len(module.outputs) else {}
    outputs = {f.name: f.outputs for f in module.functions}
    for function in reversed(module.functions):
        last = {s.results[-1].id: s.function for s in walk(function.body) if isinstance(s, Call) and s.results}
        for s in walk(function.body):
            if isinstance(s, Store) and s.variable == statuses.get(function.name) and s.value in last:
                statuses[last[s.value]] = outputs[last[s.value]][-1].id
    return statuses


def _with_mask(function: Function) -> Function:
    """Return a function that lanes run alone, with the active mask as one more input and without lane operations."""

    def change(s: Stmt) -> Stmt:
        if not isinstance(s, Let) or s.op not in LANE_OPS:
            return s
        return replace(s, op="and" if s.value.type is BOOL else "min", args=s.args * 2)

    mask = Value(max((v.id for v in defined(function)), default=-1) + 1, BOOL, "active")
    return replace(function, inputs=(*function.inputs, mask), body=rewrite(function.body, change))


def _renamed(function: Function, names: Mapping[str, str]) -> Function:
    def change(s: Stmt) -> Stmt:
        return replace(s, function=names.get(s.function, s.function)) if isinstance(s, Call) else s

    return replace(function, name=names[function.name], body=rewrite(function.body, change))


class CallBuilder(LaneBuilder):
    """A LaneBuilder that translates calls, too."""

    def __init__(self, function: Function, varying_inputs: frozenset[int], callees: Callees) -> None:
        super().__init__(function, varying_inputs)
        self.callees = callees

    def call(self, s: Call, here: Here) -> None:
        """Append a call of the copy for these arguments and this mask in place of a Call."""
        args = tuple(self.same.get(a, a) for a in s.args)
        if s.function in self.callees.alone:
            mask = here.mask if here.mask is not None else self.b.const(BOOL, [True]).id
            self.b.append(Call(s.function, (*args, mask), s.results, s.loc))
            self.varying |= {result.id for result in s.results}
            return
        varying = tuple(a in self.varying for a in args)
        copy = self.callees.called(s.function, varying, masked=here.mask is not None)
        if copy.masked and here.mask is not None:
            args = (*args, here.mask)
        self.b.append(Call(copy.function.name, args, s.results, s.loc))
        for result, output in zip(s.results, copy.function.outputs, strict=True):
            if output.id in copy.facts.slots:
                self.varying.add(result.id)
            else:
                self.varying.discard(result.id)
