"""The Python module of a vectorised module: a tile of lanes is one call of its entry.

Stage: emit. Takes a module from `vectorize`; returns the text and the names of the arguments of its entry. Stores of
some lanes alone are selects already; this module decides which arrays are shared and which are copied.

    def mandelbrot(c, lanes):
        z = np.zeros((2, lanes), np.float32)
        n = np.float32(0.0)
        ...
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final

from shpy.backend.emit import tree
from shpy.backend.emit.entry import Needs, Unit, needed_by, needs_of
from shpy.backend.emit.late import MAX_WIDTH, LateWishes, plan_late
from shpy.backend.emit.names import Names
from shpy.backend.emit.plan import is_whole
from shpy.backend.emit.spell_python import PythonSpeller
from shpy.backend.emit.survey import Place
from shpy.backend.emit.tree import (
    BOOL,
    INT,
    Assign,
    Block,
    Construct,
    Do,
    Exit,
    Expr,
    Index,
    Literal,
    Method,
    Name,
    Tuple,
    Update,
    several,
)
from shpy.backend.numpy import lanes as lane_functions
from shpy.backend.numpy.text.compaction import LaneLoop, compacted
from shpy.backend.numpy.text.iterations import Iterations, counted, lanes_alone, rewritten
from shpy.backend.numpy.text.leaving import plans
from shpy.backend.numpy.text.operations import (
    MEANINGS,
    UPDATES,
    NumpyOperations,
    components_of,
    is_row,
    is_shared,
    own,
    zeros,
)
from shpy.backend.numpy.text.updates import Updates
from shpy.backend.numpy.text.written import written
from shpy.ir.nodes import Call, Function, If, Let, Loc, Loop, Module, Stmt, Store, Value, Variable
from shpy.ir.ops import OPS
from shpy.ir.traverse import continues, defined, rewrite, uses, walk
from shpy.ir.types import Base, vec
from shpy.passes.calls import LaneFacts
from shpy.passes.liveness import annotate
from shpy.passes.vectorize import VectorModule

LANES: Final = "lanes", ""
"""The argument of a function that needs the number of lanes."""
_EXACT: Final = frozenset({"exact"})
_RESERVED: Final = ("np", *_EXACT, "lanes", "grid_index", "grid_shape", *MEANINGS, *lane_functions.__all__)
_NAMED: Final = frozenset({"param", "grid_index", "grid_shape", "table_size"})
_NO_SPLATS: Final = frozenset(
    {"const", "load", "swizzle", "table", "neighbour", "call", "construct", "component", "half", "any", "all",
     "convert", "lane_any", "lane_mask", "param", "grid_index", "grid_shape", "table_size"}
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Printed:
    """The text. `entry` is called with the inputs' tiles, then with what `arguments` lists, all by position.

    An argument is `("param", name)`, `("table", name)`, or `("place" | "grid_index" | "grid_shape" | "lanes", "")`.
    `outs`: the numbers of the outputs whose memory follows, or None where the result is only to be returned.
    `large`: many lanes are to run together, for they leave loops one by one, and those that are left should still be
    many; or no function is called, so that few arrays live at a time, and numpy reuses temporaries of 256 KiB.
    """

    text: str
    entry: str
    arguments: tuple[tuple[str, str], ...]
    large: bool
    outs: tuple[int, ...]


def print_python(vector: VectorModule, *, status: bool = False, exact: frozenset[str] = frozenset()) -> Printed:
    """Return the module's text.

    `status`: elements may be discarded, so no result is written in place. Functions named in `exact` are rounded
    correctly.
    """
    return _PythonModule(vector, exact).printed(in_place=not status)


def handed_on(module: Module) -> dict[str, list[tuple[str, str]]]:
    """Return the arguments that each function needs besides its inputs, also for the functions that it calls."""

    def needed(let: Let) -> Needs:
        return needed_by(let) | ({("place", "")} if let.op == "neighbour" else frozenset())

    named = [*(("param", p.name) for p in module.params), *(("table", t.name) for t in module.tables)]
    every = [*named, ("place", ""), ("grid_index", ""), ("grid_shape", "")]
    needs = needs_of(module, needed)
    return {
        f.name: [key for key in every if key in needs[f.name]] + ([] if f.pure else [LANES]) for f in module.functions
    }


class _PythonModule(Unit):
    """Makes one module."""

    target = "python"

    def __init__(self, vector: VectorModule, exact: frozenset[str]) -> None:
        super().__init__(vector.module)
        self.vector, self.exact = vector, exact
        self.handed = handed_on(self.module)
        entry = self.module.entry.name
        self.globals = Names("python", (*_RESERVED, *(kind for kind, what in self.handed[entry] if not what)))
        self.functions = {f.name: self.globals.take(f.name, "f") for f in self.module.functions}
        self.alone = lanes_alone(self.module.functions)
        self.speller = PythonSpeller()
        self.compacts = False

    def printed(self, *, in_place: bool) -> Printed:
        """Return the whole text with its arguments; `in_place`: a stencil writes into the arrays of the outputs."""
        entry = self.module.entry
        outs: tuple[int, ...] = ()
        for function in self.module.functions:
            facts = _all_of(function) if function.pure else self.vector.facts[function.name]
            updates = Updates(function, facts) if function is entry else None
            body = _PythonBody(self, function, facts, updates)
            parameters, block = body.parameters(), body.function_block()
            if function is entry and in_place and ("place", "") in self.handed[entry.name]:
                block, memory = written(block, function.outputs, body.varying_slots, body.scope)
                parameters, outs = [*parameters, *memory.values()], tuple(memory)
            names = tuple([tree.Parameter(p.type, p.text) for p in parameters])
            self.speller.function(tree.Function(self.functions[function.name], None, names, block))
            self.compacts |= body.compacts
        called = {name.partition(".")[0] for name in self.speller.called}
        lane_names = frozenset(lane_functions.__all__)
        sources = {"shpy.backend.numpy.lanes": lane_names, "shpy.ir": _EXACT, "shpy.ir.meaning": MEANINGS - lane_names}
        imports = [f"from {source} import {', '.join(sorted(exports & called))}"
                   for source, exports in sources.items() if exports & called]  # fmt: skip
        head = ["import numpy as np", *[""] * bool(imports), *imports]
        text = "\n".join([*head, *self.speller.lines]) + "\n"
        large = len(self.module.functions) == 1 or self.compacts
        return Printed(text, self.functions[entry.name], tuple(self.handed[entry.name]), large, outs)


def _all_of(function: Function) -> LaneFacts:
    """Return the facts of a pure function: its arguments may vary, and so may all that it computes."""
    slots = (*function.outputs, *function.variables)
    return LaneFacts(frozenset(v.id for v in defined(function)), frozenset(v.id for v in slots))


class _PythonBody(NumpyOperations):
    """Makes the tree of one function."""

    def __init__(self, unit: _PythonModule, function: Function, facts: LaneFacts, updates: Updates | None) -> None:
        function, self.iterations = rewritten(function, counted(function, facts, unit.alone))
        super().__init__(unit, function)
        self.module, self.updates, self.exact = unit, updates, unit.exact
        self.leaving = plans(function, facts.live, facts.slots)
        rows = [i.rows for i in self.iterations.values()]
        self.varying, self.varying_slots = facts.varying.union(*rows), facts.slots
        stores = [s for s in walk(function.body) if isinstance(s, Store)]
        self.in_place = frozenset(s.variable for s in stores if not is_whole(s))
        self.in_place |= frozenset(slot for plan in self.leaving.values() for slot in plan.slots)
        self.copies = {v: c for plan in self.leaving.values() for v, c in plan.copies.items()}
        self.made_by = {s.value.id: s for s in walk(function.body) if isinstance(s, Let)}
        self.lanes = Name(INT, "lanes")
        self.lane_names: set[Expr] = {Name(INT, "grid_index")}
        self.within: Name | None = None
        self.compacts = False

    # The function

    def parameters(self) -> list[Name]:
        """Name the arguments and the variables; return the arguments."""
        arguments: list[Name] = []
        for port in self.function.inputs:
            name = self.exprs[port.id] = Name(port.type, self.scope.take(port.name, "x"))
            arguments.append(name)
            if port.id in self.varying:
                self.lane_names.add(name)
        self.arguments = tuple(arguments)
        params = {p.name: p.type for p in self.module.module.params}
        self.extra_arguments = {
            (kind, what): Name(params[what] if kind == "param" else INT, self.scope.take(what) if what else kind)
            for kind, what in self.module.handed[self.function.name]
        }
        self.kept = self.continued()
        for slot in (*self.function.variables, *self.function.outputs):
            if slot.id not in self.slots:
                self.slots[slot.id] = Name(slot.type, self.scope.take(slot.name))
        self.lane_names |= {self.slots[slot] for slot in self.varying_slots if slot in self.slots}
        return [*arguments, *self.extra_arguments.values()]

    def function_block(self) -> Block:
        """Return the statements of the function."""
        splats = _splats(self.made_by.values())

        def holds(value: int, variable: int) -> bool:
            return (variable in self.varying_slots) == (value in self.varying) and value not in splats

        wishes = LateWishes(self.letters_of, *self.glimpses(), holds, self.in_place, self.updatable, self.kept)
        self.planned = plan_late(self.function, self.unit.callees, wishes)
        blank = self.blank()
        if self.function.pure and blank:
            self.out.append(Assign(self.lanes, tree.call("lane_count", INT, *self.arguments)))
        for slot in blank:
            lanes = self.lanes if slot.id in self.varying_slots else None
            self.out.append(Assign(self.slots[slot.id], zeros(slot.type, lanes, slot.length)))
        if not self.region(self.function.body, 0):
            self.out.append(self.leave())
        return compacted(tuple(self.out), self.lane_names, self.scope)

    def continued(self) -> dict[int, int]:
        """Find the variables that begin as an input of their name that nothing else reads: they are that argument."""
        inputs = {port.id: port for port in self.function.inputs if isinstance(port, Value)}
        variables: dict[int, int] = {}
        for s in self.function.body:
            if not isinstance(s, Store) or s.value not in inputs or not is_whole(s):
                break
            named = self.variables[s.variable].name == inputs[s.value].name is not None
            alike = (s.variable in self.varying_slots) == (s.value in self.varying)
            if named and alike and s.variable not in self.slots:
                if sum(v == s.value for t in walk(self.function.body) for v in uses(t)) == 1:
                    self.slots[s.variable] = self.exprs[s.value]
                    variables[s.value] = s.variable
        return variables

    def blank(self) -> list[Variable]:
        """Return the variables that may be read, or changed in part, before they are stored as a whole."""
        read = Value(-1, vec(Base.B))

        def reading(s: Stmt) -> Stmt | tuple[Stmt, ...]:
            return (Let(read, "load", (), s.variable), s) if isinstance(s, Store) and not is_whole(s) else s

        notes = annotate(replace(self.function, body=rewrite(self.function.body, reading)))
        live = notes[0].before if notes else frozenset(v.id for v in self.function.outputs)
        slots = {v.id: v for v in (*self.function.outputs, *self.function.variables)}
        return [v for v in slots.values() if v.id in live]

    # What the plan asks

    def glimpses(self) -> tuple[set[int], set[int]]:
        """Return the values that are a name or a number, and those that are views into an operand."""
        atoms, views = {port.id for port in self.function.inputs}, set[int]()
        for v, s in self.made_by.items():
            match s.op, s.attr:
                case "const", tuple(bits):
                    atoms |= {v} if s.value.type.size == 1 or len(set(bits)) == 1 else set()
                case "load", _:
                    fixed = not s.args or (s.args[0] in self.made_by and self.made_by[s.args[0]].op == "const")
                    atoms |= {v} if fixed else set()
                case "swizzle", tuple(components):
                    views |= {v} if is_row(components) else set()
                case "splat", _:
                    views.add(v)
                case _ if s.op in _NAMED:
                    atoms.add(v)
        return atoms, views

    def updatable(self, s: Let) -> bool:
        """Return whether an operation may change the array of its first operand."""
        return self.updates is not None and self.updates.allows(s)

    def context(self, function: str) -> tuple[Expr, ...]:
        """Return the names that a call passes on besides the arguments."""
        return tuple(
            [self.lanes if key == LANES else self.extra_arguments[key] for key in self.module.handed[function]]
        )

    @contextmanager
    def block(self) -> Iterator[list[tree.Stmt]]:
        """Collect what is made inside; names hold to the end of the function."""
        out = self.out
        self.out = []
        yield self.out
        self.out = out

    # Values

    def unshared(self, e: Expr) -> Expr:
        """Return a copy, where a later store could change the array that the expression looks into."""
        changing = {self.slots[s] for s in self.in_place}
        return Method(e.type, e, "copy") if is_shared(e) and not changing.isdisjoint(tree.walk(e)) else e

    def bind(self, value: int, e: Expr | None = None, loc: Loc | None = None) -> None:
        """Assign a value to a name; one that is repeated keeps only the scalar."""
        definition, e = self.values[value], self.exprs[value] if e is None else e
        scalar = e.splat
        type = definition.type if scalar is None else definition.type.scalar
        name = Name(type, self.scope.take(definition.name))
        self.out.append(Assign(name, own(self.unshared(e if scalar is None else scalar)), loc or definition.loc))
        if value in self.varying:
            self.lane_names.add(name)
        self.exprs[value] = name if scalar is None else Construct(definition.type, (name,))

    def settle(self, place: Place) -> None:
        """Name the values that the plan names before a statement, once."""
        for value in self.planned.settled.pop(place, ()):
            self.bind(value)

    def let(self, s: Let, place: Place) -> None:
        """Make the expression of a value, and a name for it where that is planned."""
        value = s.value.id
        if value in self.copies and self.within is not None:
            self.settle(place)
            self.exprs[value] = self.put_aside(s)
        elif value in self.planned.updated:
            self.settle(place)
            first, *rest = s.args
            target = self.exprs[first]
            assert isinstance(target, Name)
            for symbol, operand in zip(UPDATES[s.op], rest, strict=True):
                self.out.append(Update(target, symbol, self.exprs[operand], s.value.loc))
            self.exprs[value] = target
        else:
            super().let(s, place)

    # Stores

    def store(self, s: Store, place: Place) -> None:
        """Append a store."""
        variable, target, e = self.variables[s.variable], self.slots[s.variable], self.exprs[s.value]
        if is_whole(s) and e == target and s.variable not in self.in_place:
            return
        self.settle(place)
        e = self.exprs[s.value]
        if s.value in self.copies and self.within is not None:
            self.out.append(Do(e, s.loc))
        elif is_whole(s):
            self.out.append(Assign(target, self.stored_form(variable, s.value, e), s.loc))
            if place in self.planned.adopting:
                self.exprs[s.value] = target
        else:
            self.store_part(s, variable, e if e.splat is None else e.splat)

    def stored_form(self, variable: Variable, value: int, e: Expr) -> Expr:
        """Return the value to store, broadcast over the lanes or copied if necessary."""
        alike = (variable.id in self.varying_slots) == (value in self.varying)
        if not alike or (self.function.pure and variable.id in self.in_place):
            return self.spread(variable.type, e)
        e = own(e)
        return Method(e.type, e, "copy") if variable.id in self.in_place and is_shared(e) else self.unshared(e)

    def store_part(self, s: Store, variable: Variable, e: Expr) -> None:
        """Append a store into some components, or into an element of an array."""
        whole = self.slots[s.variable]
        components = None if s.components is None else components_of(s.components)
        index = None if s.index is None else self.exprs[s.index]
        if index is None:
            assert components is not None
            self.out.append(Assign(Index(variable.type, whole, components), e, s.loc))
        elif not isinstance(index, Literal):
            listed = [] if s.components is None else [Tuple(INT, tuple(map(tree.number, s.components)))]
            self.out.append(Do(tree.call("put", variable.type, whole, index, own(e), *listed), s.loc))
        elif 0 <= index.value < (variable.length or 0):
            at = index if components is None else Tuple(INT, (index, components))
            self.out.append(Assign(Index(variable.type, whole, at), e, s.loc))

    def put_aside(self, s: Let) -> Expr:
        """Return an exit copy, into the array of all lanes."""
        copy = self.copies[s.value.id]
        whole, mask, new = self.exprs[copy.old], self.exprs[copy.mask], self.exprs[copy.new]
        assert self.within is not None
        mask, new = mask if mask.splat is None else mask.splat, own(new if new.splat is None else new.splat)
        return tree.call("put_aside", s.value.type, whole, self.within, mask, new)

    # Calls, choices and returns

    def call(self, s: Call, place: Place) -> None:
        """Append a call: its results get the names of the variables that they are stored into, where they can."""
        self.settle(place)
        call = self.called(s.function, BOOL, [own(self.exprs[a]) for a in s.args])
        slots, names = self.planned.results[place], []
        for result in s.results:
            slot = slots.get(result.id)
            name = Name(result.type, self.scope.take(result.name)) if slot is None else self.slots[slot]
            self.exprs[result.id] = name
            if result.id in self.varying:
                self.lane_names.add(name)
            names.append(name)
        self.out.append(Assign(several(names), call, s.loc) if names else Do(call, s.loc))

    def branch(self, s: If, place: Place) -> bool:
        """Append a choice, unless both sides are empty."""
        return bool(s.then or s.orelse) and super().branch(s, place)

    def leave(self, loc: Loc | None = None) -> tree.Stmt:
        """Return the outputs; those that were stored last as what was stored."""
        outputs = [self.slots[o.id] for o in self.function.outputs]
        stored: dict[Expr, Expr] = {}
        start = len(self.out)
        while start:
            last = self.out[start - 1]
            if not isinstance(last, Assign) or last.target not in outputs or last.target in stored:
                break
            if any(last.target in tree.walk(e) for e in stored.values()):
                break
            start -= 1
            copied = isinstance(last.value, Method) and last.value.name == "copy"
            stored[last.target] = last.value.parts[0] if copied else last.value
        results = several([stored.get(o, o) for o in outputs])
        if stored and self.module.speller.width(results) < MAX_WIDTH + 2 * len(outputs) - 2:
            line = self.out[start].loc if len(stored) == 1 else None
            del self.out[start:]
            return Exit("return", results, line)
        return Exit("return", several(outputs), loc)

    # Loops

    def loop(self, s: Loop, place: Place) -> None:
        """Append `while c:` or `while True:`, with the step at each end of an iteration."""
        self.settle(place)
        iterations, plan = self.iterations.get(id(s)), self.leaving.get(id(s))
        if iterations is not None:
            self.together(s, place, iterations)
            return
        body, continuing = self.planned.survey.inner[place]
        outside, within = self.lanes, self.within
        lane = Name(INT, self.scope.take("lane")) if plan is not None else None
        start, test = self._first_test(s, place)
        if plan is not None:
            self.lanes = tree.Member(INT, self.slots[plan.live], "size")
        self.within = lane
        with self.block() as statements:
            ended = self.region(s.body, body, start)
            step: list[tree.Stmt] = []
            if not ended or continues(s):
                with self.block() as step:
                    self.region(s.continuing, continuing)
                    if s.until is not None:
                        step.append(tree.If(self.exprs[s.until], (Exit("break"),), (), s.loc))
        block = _with_step(tuple(statements), tuple(step))
        block = block if ended else (*block, *step)
        self.within = within
        if plan is None or lane is None:
            self.out.append(tree.Loop(block, test=test, loc=s.loc))
        else:
            self.compacts = True
            self.lane_names.add(lane)
            exits = frozenset(self.slots[slot] for slot in plan.slots)
            live = self.slots[plan.live]
            self.out.append(LaneLoop(block, test=test, loc=s.loc, lane=lane, live=live, exits=exits, lanes=outside))
        self.lanes = outside

    def together(self, s: Loop, place: Place, iterations: Iterations) -> None:
        """Append a loop of which several iterations are computed at once."""
        body = self.planned.survey.inner[place][0]
        start, _ = self._first_test(s, place)
        stop, counter = self.exprs[iterations.stop], self.slots[iterations.counter]
        assert isinstance(counter, Name)
        over = tree.call("iterations_of", INT, counter, stop, tree.number(iterations.step), self.lanes)
        with self.block() as statements:
            self.region(s.body, body, start)
        self.out.append(tree.Each(counter, over, tuple(statements), s.loc))


def _with_step(block: Block, step: Block) -> Block:
    """Return the body of a loop with its step before each `continue`, which in Python would skip it."""
    statements: list[tree.Stmt] = []
    for s in block:
        if isinstance(s, tree.If):
            s = replace(s, then=_with_step(s.then, step), orelse=_with_step(s.orelse, step))
        statements += [*step, s] if isinstance(s, Exit) and s.word == "continue" else [s]
    return tuple(statements)


def _splats(lets: Iterable[Let]) -> set[int]:
    """Return the values that repeat a scalar."""
    values: set[int] = set()
    for s in lets:
        bits = s.attr if s.op == "const" and s.value.type.size > 1 else None
        repeats = s.op == "splat" or (isinstance(bits, tuple) and len(set(bits)) == 1)
        works = s.op not in _NO_SPLATS and (s.op not in OPS or OPS[s.op].componentwise)
        if repeats or (s.value.type.size > 1 and works and s.args and values.issuperset(s.args)):
            values.add(s.value.id)
    return values
