"""Prints a vectorised module as Python text for numpy.

Stage: emit. Takes what `vectorize` gives; gives the text and the names of the arguments of its entry. The text is a
Python module that anyone may run; a tile of lanes is one call of its entry:

    import numpy as np
    from shpy.backends.numpy.lanes import vector
    from shpy.ir.meaning import dot


    def mandelbrot(c, lanes):
        z = np.zeros((2, lanes), np.float32)
        n = np.float32(0.0)
        ...
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from shpy.backends.emit.names import Names
from shpy.backends.numpy import lanes as lane_functions
from shpy.backends.numpy.compaction import MARK, Compaction, compacted
from shpy.backends.numpy.expressions import Expr, call, condition, method, name, negation
from shpy.backends.numpy.heading import asked_by, components_of, imports_of
from shpy.backends.numpy.iterations import Iterations, counted, lanes_alone
from shpy.backends.numpy.leaving import ExitCopy, Plan, plans
from shpy.backends.numpy.operations import MEANINGS, Imports, dtype, zeros
from shpy.backends.numpy.updates import Updates
from shpy.backends.numpy.values import MAX_LENGTH, Around, ValuePrinter, is_partial
from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Region,
    Return,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.traverse import defined, regions_of, rewrite, uses, walk
from shpy.ir.types import Base, Type, vec
from shpy.passes.calls import LaneFacts
from shpy.passes.liveness import annotate
from shpy.passes.vectorize import VectorModule

__all__ = ["Printed", "print_python"]

_RESERVED = ("np", "lanes", "grid_index", "grid_shape", *MEANINGS, *lane_functions.__all__)


@dataclass(frozen=True, slots=True)
class Printed:
    """The text. `entry` is called with the inputs' tiles, then with what `arguments` lists, all by position.

    An argument is `("param", name)`, `("table", name)`, or `("place" | "grid_index" | "grid_shape" | "lanes", "")`.
    `large`: many lanes are to run together, for they leave loops one by one, and those that are left should still be
    many; or no function is called, so that few arrays live at a time, and numpy reuses temporaries of 256 KiB.
    `outs`: the numbers of the outputs whose arrays may follow the arguments, to be written; the rest is only returned.
    """

    text: str
    entry: str
    arguments: tuple[tuple[str, str], ...]
    large: bool
    outs: tuple[int, ...]


def print_python(vector: VectorModule, *, status: bool = False) -> Printed:
    """The module's text; `status`: its last output says how each element ended."""
    module, use = vector.module, Imports()
    asked = asked_by(module)
    names = Names("python", (*_RESERVED, *(kind for kind, what in asked[module.entry.name] if not what)))
    functions = {f.name: names.take(f.name, "f") for f in module.functions}
    around = Around(functions, names, use, asked, lanes_alone(module.functions))
    printers = []
    for function in module.functions:
        facts = _all_of(function) if function.pure else vector.facts[function.name]
        printers.append(_Printer(function, facts, around))
    printers[-1].updates = Updates(module.entry, vector.facts[module.entry.name])
    printers[-1].writes = ("place", "") in asked[module.entry.name] and not status
    texts = [printer.function() for printer in printers]
    text = "\n\n\n".join([imports_of(use, texts), *texts]) + "\n"
    large = len(printers) == 1 or any(printer.compactions for printer in printers)
    return Printed(text, functions[module.entry.name], tuple(asked[module.entry.name]), large, tuple(printers[-1].outs))


def _all_of(function: Function) -> LaneFacts:
    """A pure function's arguments may vary, and so may all that it computes."""
    slots = (*function.outputs, *function.variables)
    return LaneFacts(frozenset(v.id for v in defined(function)), frozenset(v.id for v in slots))


class _Printer(ValuePrinter):
    """Prints one function."""

    def __init__(self, function: Function, facts: LaneFacts, around: Around) -> None:
        super().__init__(function, facts, around)
        self.plans = plans(function, facts.live, facts.slots)
        self.iterations = counted(function, facts, around.alone)
        self.varying |= frozenset(value for iterations in self.iterations.values() for value in iterations.rows)
        self.in_place |= frozenset(slot for plan in self.plans.values() for slot in plan.slots)
        self.compactions: dict[int, Compaction] = {}
        self.within: list[tuple[Plan, str]] = []
        self.loops: list[Loop] = []
        self.loop_head = -2
        self.writes = False
        self.outs: dict[int, str] = {}

    def function(self) -> str:
        """The text of the function, whose arguments besides its inputs are those it asks for."""
        arguments = []
        for port in self.f.inputs:
            arguments.append(self.names.take(port.name, "x"))
            self.values[port.id] = name(arguments[-1])
            if port.id in self.varying:
                self.lane_names.add(arguments[-1])
        for kind, what in self.asked[self.f.name]:
            self.given[kind, what] = self.names.take(what) if what else kind
        self.slot_names |= self.continued()
        for slot in (*self.f.variables, *self.f.outputs):
            if slot.id not in self.slot_names:
                self.slot_names[slot.id] = self.names.take(slot.name)
        blank = self.blank()
        if self.f.pure and blank:
            self.line(f"lanes = lane_count({', '.join(arguments)})")
            self.use.from_lanes("lane_count")
        for slot in blank:
            lanes = "lanes" if slot.id in self.varying_slots else ""
            self.line(f"{self.slot_names[slot.id]} = {zeros(slot.type, lanes, slot.length)}")
        if not self.region(self.f.body):
            self.leave(None)
        outs = [f"{out}=None" for out in self.outs.values()]
        head = f"def {self.functions[self.f.name]}({', '.join([*arguments, *self.given.values(), *outs])}):"
        slots = {text for slot, text in self.slot_names.items() if slot in self.varying_slots}
        self.lane_names |= {"grid_index", *slots}
        return compacted("\n".join([head, *self.lines]), self.compactions, self.lane_names, self.names)

    def continued(self) -> dict[int, str]:
        """The slots that begin as an input of their name, which is nothing else: they are that argument."""
        inputs = {port.id: port for port in self.f.inputs}
        found: dict[int, str] = {}
        for s in self.f.body:
            if not isinstance(s, Store) or s.value not in inputs or is_partial(s):
                break
            named = self.slots[s.variable].name == inputs[s.value].name is not None
            alike = (s.variable in self.varying_slots) == (s.value in self.varying)
            if named and alike and self.uses[s.value] == 1 and s.variable not in found:
                found[s.variable] = self.values[s.value].text
        return found

    def blank(self) -> list[Variable]:
        """The slots that may be read, or changed in part, before they are stored as a whole."""
        read = Value(-1, vec(Base.B))

        def reading(s: Stmt) -> Stmt | tuple[Stmt, ...]:
            return (Let(read, "load", (), s.variable), s) if isinstance(s, Store) and is_partial(s) else s

        notes = annotate(replace(self.f, body=rewrite(self.f.body, reading)))
        live = notes[0].before if notes else frozenset(v.id for v in self.f.outputs)
        return [v for v in self.slots.values() if v.id in live]

    # Statements

    def region(self, region: Region) -> bool:
        """Print a region; whether it ends in an exit."""
        for at, s in enumerate(region, 1):
            match s:
                case Let(value) if self.exit_copy(value.id):
                    pass  # written by the store that follows
                case Store(_, value) if copy := self.exit_copy(value):
                    self.put_aside(s, copy)
                case Let():
                    self.let(s)
                case Store(_, _, None, None):
                    self.store(s)
                case Store():
                    self.store_part(s)
                case If():
                    self.branch(s)
                case Loop() if iterations := self.iterations.get(id(s)):
                    self.together(s, iterations)
                case Loop():
                    self.loop(s)
                case Call():
                    self.call(s, region[at:])
                case Break():
                    self.line("break", s.loc)
                case Continue():
                    self.again(s)
                case Return():
                    self.leave(s.loc)
                case _:
                    raise TypeError(f"{type(s).__name__} has no place in a vectorised function")
        return bool(region) and isinstance(region[-1], (Break, Continue, Return))

    def call(self, s: Call, following: Region) -> None:
        """A call of a function that is more than an expression: its results get names, of their slots if it can be."""
        args = [self.take(a).own() for a in s.args]
        made = call(self.functions[s.function], *args, *self.context(s.function))
        slots = self.slots_of(s, following)
        self.settle(slots.values())
        bound = []
        for result in s.results:
            slot = slots.get(result.id)
            called = self.names.take(result.name) if slot is None else self.slot_names[slot]
            self.hold(result.id, name(called, () if slot is None else (slot,)))
            self.left[result.id] = self.uses[result.id]
            if result.id in self.varying:
                self.lane_names.add(called)
            bound.append(called)
        self.line(f"{', '.join(bound)} = {made.text}" if bound else made.text, s.loc)

    def slots_of(self, s: Call, following: Region) -> dict[int, int]:
        """The slots that the statements right behind a call store its results into, where these are nothing else."""
        results = {r.id for r in s.results}
        found: dict[int, int] = {}
        for store in following:
            if not isinstance(store, Store) or store.value not in results or store.value in found or is_partial(store):
                break
            slot, value = store.variable, store.value
            alike = (slot in self.varying_slots) == (value in self.varying)
            if alike and slot not in self.in_place and slot not in found.values():
                found[value] = slot
        return found

    def store(self, s: Store) -> None:
        slot, value = self.slots[s.variable], s.value
        if slot.id not in self.in_place and self.left[value] and self.values[value].text == self.slot_names[slot.id]:
            self.take(value)
            return
        alike = (slot.id in self.varying_slots) == (value in self.varying)
        adopted = alike and value in self.waiting and self.left[value] > 1 and self.values[value].splat is None
        if adopted:  # what has no name yet is called by the slot's
            self.waiting.discard(value)
            self.left[value] -= 1
            e = self.values.pop(value)
        else:
            e = self.take(value)
        self.settle([slot.id])
        stored = [*self.stored, (slot.id, e.own() if alike else self.spread(slot.type, e))]
        e = self.stored_form(slot, e, alike)
        self.line(f"{self.slot_names[slot.id]} = {e.text}", s.loc)
        self.stored = stored
        if adopted:
            self.hold(value, name(self.slot_names[slot.id], [slot.id]))

    def stored_form(self, slot: Variable, e: Expr, alike: bool) -> Expr:
        """What to store: spread over the lanes, or copied, if need be."""
        if not alike or (self.f.pure and slot.id in self.in_place):
            return self.spread(slot.type, e)
        e = e.own()
        if e.shared and (slot.id in self.in_place or e.reads & self.in_place):
            return method(e, "copy")
        return e

    def spread(self, type: Type, e: Expr) -> Expr:
        """A uniform expression given to every lane."""
        number = e.splat or e
        if not number.literal:
            return call(self.use.from_lanes("spread"), e, self.lanes)
        if number.text in ("0", "0.0", "False"):
            return Expr(zeros(type, self.lanes), depth=1)
        extents = self.lanes if type.size == 1 else f"({type.size}, {self.lanes})"
        return call("np.full", extents, number, dtype(type))

    def exit_copy(self, value: int) -> ExitCopy | None:
        """What the value is made of, if it is only for lanes that leave the loop."""
        return self.within[-1][0].copies.get(value) if self.within else None

    def put_aside(self, s: Store, copy: ExitCopy) -> None:
        """An exit copy, into the array of all lanes."""
        whole, mask, new = self.take(copy.old), self.take(copy.mask), self.take(copy.new)
        mask, new = mask.splat or mask, (new.splat or new).own()
        self.settle([s.variable])
        function = self.use.from_lanes("put_aside")
        self.line(f"{function}({whole.text}, {self.within[-1][1]}, {mask.text}, {new.text})", s.loc)

    def store_part(self, s: Store) -> None:
        """Store into some components, or an element of an array."""
        slot, e = self.slots[s.variable], self.take(s.value)
        e = e if e.splat is None else e.splat
        index = None if s.index is None else self.take(s.index)
        self.settle([slot.id])
        whole = self.slot_names[slot.id]
        components = "" if s.components is None else components_of(s.components)
        if index is None:
            self.line(f"{whole}[{components}] = {e.text}", s.loc)
        elif index.literal:
            if 0 <= int(index.text) < (slot.length or 0):
                at = f"{index.text}, {components}" if components else index.text
                self.line(f"{whole}[{at}] = {e.text}", s.loc)
        else:
            args = [whole, index.text, e.own().text] + ([str(s.components)] if components else [])
            self.line(f"{self.use.from_lanes('put')}({', '.join(args)})", s.loc)

    def prepare(self, s: If | Loop) -> None:
        """Before the regions of a statement: name what cannot wait until it is asked for inside."""
        inside = [Counter(v for n in walk(r) for v in uses(n)) for r in regions_of(s)]
        if isinstance(s, Loop) and s.until is not None:
            inside.append(Counter((s.until,)))
        for value in sorted(self.waiting):
            counts = [count[value] for count in inside]
            if sum(counts) and (isinstance(s, Loop) or self.left[value] > max(counts)):
                self.bind(value)
        stored = {n.variable for r in regions_of(s) for n in walk(r) if isinstance(n, Store)}
        self.settle(sorted(stored))

    def branch(self, s: If) -> None:
        test = self.take(s.condition)
        if self.loop_head == len(self.lines) - 1 - self.marked() and s.then == (Break(),) and not s.orelse:
            indent = "    " * (self.indent - 1)
            self.lines[self.loop_head] = f"{indent}while {condition(negation(test)).text}:{self.comment(s.loc)}"
            self.loop_head = -1
            return
        self.prepare(s)
        then, orelse = s.then, s.orelse
        if not then:
            test, then, orelse = negation(test), orelse, ()
        if not then:
            return
        self.line(f"if {condition(test).text}:", s.loc)
        self.block(then)
        if orelse:
            start = len(self.lines)
            self.line("else:")
            self.block(orelse)
            self.flatten(start)

    def block(self, region: Region) -> bool:
        self.indent += 1
        start = len(self.lines)
        ended = self.region(region)
        if len(self.lines) == start:
            self.line("pass")
        self.indent -= 1
        self.stored.clear()
        return ended

    def flatten(self, start: int) -> None:
        """Turn `else: if ...` into `elif ...` where nothing else is in that block."""
        inner = "    " * (self.indent + 1)
        first, *others = [line[len(inner) :] for line in self.lines[start + 1 :]]
        if first.startswith("if ") and all(o.startswith((" ", "elif ", "else:")) for o in others):
            self.lines[start:] = ["    " * self.indent + line for line in ("el" + first, *others)]

    def loop(self, s: Loop) -> None:
        self.prepare(s)
        self.line("while True:", s.loc)
        self.loop_head = len(self.lines) - 1
        self.loops.append(s)
        self.indent += 1
        outside, plan = self.lanes, self.plans.get(id(s))
        self.within.append(self.mark(plan) if plan else (Plan(-1), ""))
        start = len(self.lines)
        if not self.region(s.body):
            self.step(s)
        self.loop_head = -1
        if len(self.lines) == start:
            self.line("pass")
        self.indent -= 1
        self.stored.clear()
        self.loops.pop()
        self.within.pop()
        self.lanes = outside

    def together(self, s: Loop, iterations: Iterations) -> None:
        """Print a loop of which several iterations are computed at once."""
        for let in iterations.first:
            self.let(let)
        stop, counter = self.take(iterations.stop), self.slot_names[iterations.counter]
        self.prepare(s)
        head = f"{self.use.from_lanes('iterations_of')}({counter}, {stop.text}, {iterations.step}, {self.lanes})"
        self.line(f"for {counter} in {head}:", s.loc)
        self.indent += 1
        updates, self.updates = self.updates, None  # what is new has several rows, what was there before may have one
        for let in iterations.body:
            self.let(let)
        for total in iterations.sums:
            term, slot = self.take(total.term), self.slot_names[total.slot]
            self.settle([total.slot])
            folded = call(self.use.from_lanes("fold"), total.fold, slot, term.own())
            self.line(f"{slot} = {folded.text}", self.made[total.term].loc)
        self.updates = updates
        self.indent -= 1
        self.stored.clear()

    def marked(self) -> bool:
        """Whether a mark follows the head of the loop at hand."""
        return bool(self.within) and self.within[-1][1] != ""

    def mark(self, plan: Plan) -> tuple[Plan, str]:
        """Mark the head of a loop that goes on with its live lanes alone; the name of their numbers."""
        live, lane = self.slot_names[plan.live], self.names.take("lane")
        exits = frozenset(self.slot_names[slot] for slot in plan.slots)
        self.line(f"{MARK}({len(self.compactions)})")
        self.compactions[len(self.compactions)] = Compaction(lane, live, exits, self.lanes)
        self.use.lanes |= {"few", "compact"}
        self.lanes = f"{live}.size"
        return plan, lane

    def step(self, s: Loop) -> None:
        """Print the end of an iteration: the `continuing` region and the test."""
        self.region(s.continuing)
        if s.until is not None:
            self.line(f"if {condition(self.take(s.until)).text}:", s.loc)
            self.indent += 1
            self.line("break")
            self.indent -= 1

    def again(self, s: Continue) -> None:
        """Print the end of an iteration at a `continue` as well: in Python, `continue` would skip it."""
        left, values, waiting = Counter(self.left), dict(self.values), set(self.waiting)
        readers = {slot: set(found) for slot, found in self.readers.items()}
        loop = self.loops[-1]
        self.left = Counter(v for s in walk(loop.continuing) for v in uses(s))
        self.left.update(() if loop.until is None else (loop.until,))
        self.step(loop)
        self.left, self.values, self.waiting, self.readers = left, values, waiting, readers
        self.line("continue", s.loc)

    def leave(self, loc: Loc | None) -> None:
        """Return the outputs; those that were stored last as what was stored."""
        texts: dict[int, Expr] = {}
        outputs = [v.id for v in self.f.outputs]
        stored = list(self.stored)
        while stored and stored[-1][0] in outputs and stored[-1][0] not in texts:
            slot, e = stored.pop()
            if any(slot in later.reads for later in texts.values()):
                break
            texts[slot] = e
        written = {o: self.written(at, texts[o]) for at, o in enumerate(outputs) if o in texts}
        found = [written.get(o, self.slot_names[o]) for o in outputs]
        if texts and sum(map(len, found)) < MAX_LENGTH:
            comment = self.lines[-1].partition("  # ")[2] if len(texts) == 1 else ""
            del self.lines[-len(texts) :]
            text = f"{'    ' * self.indent}return {', '.join(found)}"
            self.lines.append(f"{text}  # {comment}" if comment else text)
            return
        for line, o in enumerate(reversed(texts), len(self.lines) - len(texts)):
            self.lines[line] = self.lines[line].replace(f" = {texts[o].text}", f" = {written[o]}", 1)
        self.line(f"return {', '.join(self.slot_names[o] for o in outputs)}", loc)

    def written(self, at: int, e: Expr) -> str:
        """The text of an output, which writes it where it belongs, if it may be told that.

        A stencil does little for each element, and a copy would take as long as an addition.
        """
        slot = self.f.outputs[at]
        if not (self.writes and e.into and slot.type.size == 1 and slot.id in self.varying_slots):
            return e.text
        if at not in self.outs:
            self.outs[at] = self.names.take("out" if len(self.f.outputs) == 1 else f"{slot.name}_out")
        return f"{e.into}, out={self.outs[at]})"
