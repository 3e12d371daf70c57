"""The function of a vectorised module as Python: stores, calls, choices and loops over the lanes of a tile.

Stage: emit. Part of the numpy printer. Stores of some lanes are selects already; this file decides which arrays are
shared and which are copied.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from itertools import islice
from typing import Final

from shpy.backend.emit import tree
from shpy.backend.emit.structure import MAX_DEPTH, Body
from shpy.backend.emit.survey import Place, is_whole
from shpy.backend.emit.tree import BOOL, INT, Block, Expr, Literal, Name, measure, several
from shpy.backend.numpy.text.compaction import LaneLoop, compacted
from shpy.backend.numpy.text.iterations import Iterations, counted, rewritten
from shpy.backend.numpy.text.leaving import plans
from shpy.backend.numpy.text.naming import Naming, Updates
from shpy.backend.numpy.text.operations import (
    LANES,
    UPDATES,
    NumpyOperations,
    PythonUnit,
    components_of,
    is_atom,
    is_shared,
    own,
    zeros,
)
from shpy.ir.nodes import Call, Function, If, Let, Loc, Loop, Stmt, Store, Value, Variable
from shpy.ir.ops import OPS
from shpy.ir.traverse import continues, rewrite, walk
from shpy.ir.types import Base, vec
from shpy.passes.calls import LaneFacts
from shpy.passes.liveness import annotate

MAX_WIDTH: Final = 88
"""Letters of an expression that needs no name."""
_NO_SPLATS: Final = frozenset(
    {"const", "load", "swizzle", "table", "neighbour", "call", "construct", "component", "half", "any", "all",
     "convert", "lane_any", "lane_min", "lane_max", "lane_mask", "param", "grid_index", "grid_shape", "table_size"}
)  # fmt: skip


class PythonBody(Body):
    """Makes the tree of one function."""

    operations: NumpyOperations
    unit: PythonUnit
    waiting: Naming

    def __init__(self, unit: PythonUnit, function: Function, facts: LaneFacts, updates: Updates | None) -> None:
        function, self.iterations = rewritten(function, counted(function, facts, unit.alone))
        self.varying = facts.varying.union(*[i.rows for i in self.iterations.values()])
        super().__init__(NumpyOperations(unit, function, self.varying))
        self.updates = updates
        self.leaving = plans(function, facts.live, facts.slots)
        self.varying_slots = facts.slots
        stores = [s for s in walk(function.body) if isinstance(s, Store)]
        self.in_place = frozenset(s.variable for s in stores if not is_whole(s))
        self.in_place |= frozenset(slot for plan in self.leaving.values() for slot in plan.slots)
        self.copies = {v: c for plan in self.leaving.values() for v, c in plan.copies.items()}
        self.made_by = {s.value.id: s for s in walk(function.body) if isinstance(s, Let)}
        self.waiting = Naming(self.survey.uses)
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
        params = {p.name: p.type for p in self.unit.module.params}
        self.operations.extra_arguments = {
            (kind, what): Name(params[what] if kind == "param" else INT, self.scope.take(what) if what else kind)
            for kind, what in self.unit.handed[self.function.name]
        }
        self.continue_inputs()
        for slot in (*self.function.variables, *self.function.outputs):
            if slot.id not in self.slots:
                self.slots[slot.id] = Name(slot.type, self.scope.take(slot.name))
        self.lane_names |= {self.slots[slot] for slot in self.varying_slots if slot in self.slots}
        return [*arguments, *self.operations.extra_arguments.values()]

    def function_block(self) -> Block:
        """Return the statements of the function."""
        self.splats = _splats(self.made_by.values())
        blank = self.blank()
        if blank and LANES not in self.unit.handed[self.function.name]:
            self.out.append(tree.Assign(self.operations.lanes, tree.call("lane_count", INT, *self.arguments)))
        for slot in blank:
            lanes = self.operations.lanes if slot.id in self.varying_slots else None
            self.out.append(tree.Assign(self.slots[slot.id], zeros(slot.type, lanes, slot.length)))
        if not self.region(self.function.body, 0):
            self.out.append(self.leave())
        return compacted(tuple(self.out), self.lane_names, self.scope)

    def continue_inputs(self) -> None:
        """Let the variables that begin as an input of their name that nothing else reads be that argument."""
        inputs = {port.id: port for port in self.function.inputs if isinstance(port, Value)}
        for s in self.function.body:
            if not isinstance(s, Store) or s.value not in inputs or not is_whole(s):
                break
            named = self.variables[s.variable].name == inputs[s.value].name is not None
            alike = (s.variable in self.varying_slots) == (s.value in self.varying)
            if named and alike and s.variable not in self.slots and self.survey.uses[s.value] == 1:
                self.slots[s.variable] = self.exprs[s.value]

    def blank(self) -> list[Variable]:
        """Return the variables that may be read, or changed in part, before they are stored as a whole."""
        read = Value(-1, vec(Base.B))

        def reading(s: Stmt) -> Stmt | tuple[Stmt, ...]:
            return (Let(read, "load", (), s.variable), s) if isinstance(s, Store) and not is_whole(s) else s

        notes = annotate(replace(self.function, body=rewrite(self.function.body, reading)))
        live = notes[0].before if notes else frozenset(v.id for v in self.function.outputs)
        slots = {v.id: v for v in (*self.function.outputs, *self.function.variables)}
        return [v for v in slots.values() if v.id in live]

    # What a name depends on

    def holds(self, value: int, variable: int) -> bool:
        """Return whether a value that is stored into a variable can use the variable's name."""
        return (variable in self.varying_slots) == (value in self.varying) and value not in self.splats

    def updates_first(self, s: Let) -> bool:
        """Return whether an operation changes the array of its first operand."""
        if self.updates is None or not self.updates.allows(s):
            return False
        return self.waiting.may_change(s.args[0], s.args[1:])

    @contextmanager
    def block(self) -> Iterator[list[tree.Stmt]]:
        """Collect the statements emitted inside; names hold to the end of the function."""
        out = self.out
        self.out = []
        yield self.out
        self.out = out

    # Values

    def unshared(self, e: Expr) -> Expr:
        """Return a copy, where a later store could change the array that the expression looks into."""
        if not is_shared(e) or not self.in_place:
            return e
        return e if self.changing_names.isdisjoint(tree.walk(e)) else tree.Method(e.type, e, "copy")

    @cached_property
    def changing_names(self) -> frozenset[Expr]:
        """The names of the variables whose arrays change in part."""
        return frozenset([self.slots[s] for s in self.in_place])

    def bind(self, value: int, e: Expr | None = None, loc: Loc | None = None) -> None:
        """Assign a value to a name; one that is repeated keeps only the scalar."""
        definition, e = self.values[value], self.exprs[value] if e is None else e
        scalar = e.splat
        type = definition.type if scalar is None else definition.type.scalar
        name = Name(type, self.scope.take(definition.name))
        self.out.append(tree.Assign(name, own(self.unshared(e if scalar is None else scalar)), loc or definition.loc))
        if value in self.varying:
            self.lane_names.add(name)
        self.exprs[value] = name if scalar is None else tree.Construct(definition.type, (name,))
        self.waiting.name(value)

    def need(self, values: Iterable[int]) -> None:
        """Name the values that are used again after this use."""
        for value in self.waiting.needed_again(values):
            self.bind(value)

    def enter(self, s: If | Loop) -> None:
        """Name the values that must be computed before an If or Loop."""
        for value in self.waiting.needed_inside(s):
            self.bind(value)

    def let(self, s: Let, place: Place) -> None:
        """Make the expression of a value, which waits for its use or gets a name."""
        value = s.value.id
        if not self.survey.uses[value]:
            self.waiting.use(s.args)
            return
        updates = self.updates_first(s)
        self.need(s.args)
        if value in self.copies and self.within is not None:
            self.exprs[value] = self.put_aside(s)
            self.waiting.use(s.args)
        elif updates:
            first, *rest = s.args
            target = self.exprs[first]
            assert isinstance(target, Name)
            for symbol, operand in zip(UPDATES[s.op], rest, strict=True):
                self.out.append(tree.Update(target, symbol, self.exprs[operand], s.value.loc))
            self.waiting.use(s.args)
            self.exprs[value] = target
            self.waiting.name(value, root=first)
        else:
            e = self.exprs[value] = self.operations.operation(s)
            atom = is_atom(e)
            self.waiting.compute(s, atom=atom)
            if value in self.waiting.forced or not (atom or (s.value.name is None and self.is_short(e))):
                self.bind(value)

    def is_short(self, e: Expr) -> bool:
        """Return whether an expression needs no name for its length. Few letters in C are not many in Python."""
        depth, letters = measure(e)
        return depth <= MAX_DEPTH and (4 * letters <= MAX_WIDTH or self.unit.ruler.width(e) <= MAX_WIDTH)

    # Stores

    def store(self, s: Store, place: Place) -> None:
        """Append a store."""
        variable, target = self.variables[s.variable], self.slots[s.variable]
        operands = [s.value] if s.index is None else [s.value, s.index]
        if is_whole(s) and self.exprs[s.value] == target and s.variable not in self.in_place:
            self.waiting.use(operands)
            return
        adopts = is_whole(s) and self.waiting.may_adopt(s.value) and self.holds(s.value, s.variable)
        if adopts:
            self.waiting.remove(s.value)
        self.need(operands)
        self.waiting.use(operands)
        self.change([s.variable])
        e = self.exprs[s.value]
        if s.value in self.copies and self.within is not None:
            self.out.append(tree.Do(e, s.loc))
        elif is_whole(s):
            self.out.append(tree.Assign(target, self.stored_form(variable, s.value, e), s.loc))
        else:
            self.store_part(s, variable, e if e.splat is None else e.splat)
        if adopts:
            self.stand(s.value, s.variable)

    def stand(self, value: int, variable: int) -> None:
        """Let a variable's name stand for a value."""
        self.exprs[value] = self.slots[variable]
        if self.waiting.left[value]:
            self.waiting.add(value, frozenset({variable}))

    def stored_form(self, variable: Variable, value: int, e: Expr) -> Expr:
        """Return the value to store, broadcast over the lanes or copied if necessary."""
        alike = (variable.id in self.varying_slots) == (value in self.varying)
        if not alike or (self.function.pure and variable.id in self.in_place):
            return self.operations.spread(variable.type, e)
        e = own(e)
        return tree.Method(e.type, e, "copy") if variable.id in self.in_place and is_shared(e) else self.unshared(e)

    def store_part(self, s: Store, variable: Variable, e: Expr) -> None:
        """Append a store into some components, or into an element of an array."""
        whole = self.slots[s.variable]
        components = None if s.components is None else components_of(s.components)
        index = None if s.index is None else self.exprs[s.index]
        if index is None:
            assert components is not None
            self.out.append(tree.Assign(tree.Index(variable.type, whole, components), e, s.loc))
        elif not isinstance(index, Literal):
            numbers = tuple(map(tree.number, s.components or ()))
            listed = [] if not numbers else [(tree.ListDisplay if len(numbers) == 1 else tree.Tuple)(INT, numbers)]
            self.out.append(tree.Do(tree.call("put", variable.type, whole, index, own(e), *listed), s.loc))
        elif 0 <= index.value < (variable.length or 0):
            at = index if components is None else tree.Tuple(INT, (index, components))
            self.out.append(tree.Assign(tree.Index(variable.type, whole, at), e, s.loc))

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
        self.need(s.args)
        call = self.operations.called(s.function, BOOL, [own(self.exprs[a]) for a in s.args])
        self.waiting.use(s.args)
        slots = self.stored_results(s, place)
        self.change(slots.values())
        for result in s.results:
            if result.id in slots:
                self.stand(result.id, slots[result.id])
            else:
                self.exprs[result.id] = Name(result.type, self.scope.take(result.name))
                self.waiting.name(result.id)
            if result.id in self.varying:
                self.lane_names.add(self.exprs[result.id])
        names = [self.exprs[result.id] for result in s.results]
        self.out.append(tree.Assign(several(names), call, s.loc) if names else tree.Do(call, s.loc))

    def stored_results(self, s: Call, place: Place) -> dict[int, int]:
        """Return the variables that the statements after a call store its results into, and nothing else."""
        results, variables = {r.id for r in s.results}, dict[int, int]()
        for store in islice(self.survey.regions[place[0]], place[1] + 1, None):
            if not isinstance(store, Store) or store.value not in results - variables.keys() or not is_whole(store):
                break
            variable = store.variable
            if self.holds(store.value, variable) and variable not in {*self.in_place, *variables.values()}:
                variables[store.value] = variable
        return variables

    def branch(self, s: If, place: Place) -> bool:
        """Append a choice, unless both sides are empty."""
        if not (s.then or s.orelse):
            self.waiting.use([s.condition])
            return False
        self.need([s.condition])
        self.enter(s)
        return super().branch(s, place)

    def leave(self, loc: Loc | None = None) -> tree.Stmt:
        """Return the outputs; those that were stored last as what was stored."""
        outputs = [self.slots[o.id] for o in self.function.outputs]
        stored: dict[Expr, Expr] = {}
        start = len(self.out)
        while start:
            last = self.out[start - 1]
            if not isinstance(last, tree.Assign) or last.target not in outputs or last.target in stored:
                break
            if any(last.target in tree.walk(e) for e in stored.values()):
                break
            start -= 1
            copied = isinstance(last.value, tree.Method) and last.value.name == "copy"
            stored[last.target] = last.value.parts[0] if copied else last.value
        results = several([stored.get(o, o) for o in outputs])
        if stored and self.unit.ruler.width(results) < MAX_WIDTH + 2 * len(outputs) - 2:
            line = self.out[start].loc if len(stored) == 1 else None
            del self.out[start:]
            return tree.Exit("return", results, line)
        return tree.Exit("return", several(outputs), loc)

    # Loops

    def loop(self, s: Loop, place: Place) -> None:
        """Append `while c:` or `while True:`, with the step at each end of an iteration."""
        self.enter(s)
        self.change(self.survey.stored[place])
        self.waiting.force(s)
        iterations, plan = self.iterations.get(id(s)), self.leaving.get(id(s))
        if iterations is not None:
            self.together(s, place, iterations)
            return
        body, continuing = self.survey.inner[place]
        outside, within = self.operations.lanes, self.within
        lane = Name(INT, self.scope.take("lane")) if plan is not None else None
        step: list[tree.Stmt] = []
        with self.waiting.region(), self.block() as statements:
            start, test = self.first_test(s, body)
            if plan is not None:
                self.operations.lanes = tree.Member(INT, self.slots[plan.live], "size")
            self.within = lane
            ended = self.region(s.body, body, start)
            if not ended or continues(s):
                with self.waiting.region(), self.block() as step:
                    self.region(s.continuing, continuing)
                    if s.until is not None:
                        step.append(tree.If(self.exprs[s.until], (tree.Exit("break"),), (), s.loc))
            self.waiting.use([] if s.until is None else [s.until])
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
        self.operations.lanes = outside

    def together(self, s: Loop, place: Place, iterations: Iterations) -> None:
        """Append a loop of which several iterations are computed at once."""
        body = self.survey.inner[place][0]
        with self.waiting.region(), self.block() as statements:
            start, _ = self.first_test(s, body)
            stop, counter = self.exprs[iterations.stop], self.slots[iterations.counter]
            self.region(s.body, body, start)
        assert isinstance(counter, Name)
        over = tree.call("iterations_of", INT, counter, stop, tree.number(iterations.step), self.operations.lanes)
        self.out.append(tree.Each(counter, over, tuple(statements), s.loc))


def _with_step(block: Block, step: Block) -> Block:
    """Return the body of a loop with its step before each `continue`, which in Python would skip it."""
    statements: list[tree.Stmt] = []
    for s in block:
        if isinstance(s, tree.If):
            s = replace(s, then=_with_step(s.then, step), orelse=_with_step(s.orelse, step))
        statements += [*step, s] if isinstance(s, tree.Exit) and s.word == "continue" else [s]
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
