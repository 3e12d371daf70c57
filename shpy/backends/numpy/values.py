"""Prints what values are: the expression of each, and when one gets a name of its own.

Stage: emit. Part of the numpy printer, which is a `ValuePrinter` that knows statements.

A value that the user named keeps its name and line. Any other that is used once is written where it is used, unless a
store to what it reads comes first; one that is used more often gets the name of the variable it is stored into first.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import PurePath

from shpy.backends.emit.names import Names
from shpy.backends.numpy.expressions import Expr, call, infix, item, method, name
from shpy.backends.numpy.heading import LANES
from shpy.backends.numpy.operations import SHIFTS, Imports, constant, operation, picked
from shpy.backends.numpy.updates import UPDATES, Updates
from shpy.ir.nodes import Function, Let, Loc, Store, Variable
from shpy.ir.traverse import defined, uses, walk
from shpy.passes.calls import LaneFacts
from shpy.passes.known import Known

__all__ = ["Around", "ValuePrinter", "is_partial"]

MAX_DEPTH = 32
MAX_LENGTH = 88
"""An expression that is longer gets a name."""


def is_partial(s: Store) -> bool:
    """Whether it stores a part of its variable only."""
    return s.components is not None or s.index is not None


@dataclass(frozen=True, slots=True)
class Around:
    """What the functions of a text share: their names, what else is named, imports, and what each asks for.

    `alone`: the functions that compute each lane alone (`iterations.lanes_alone`).
    """

    functions: dict[str, str]
    names: Names
    use: Imports
    asked: dict[str, list[tuple[str, str]]]
    alone: frozenset[str] = frozenset()


class ValuePrinter:
    """Prints the values of one function, and lines.

    `values`: the expression of each value so far; `left`: how often it will still be asked for; `waiting`: those that
    are not written yet; `readers`: the values whose expressions read a slot.
    """

    def __init__(self, function: Function, facts: LaneFacts, around: Around) -> None:
        self.f, self.functions, self.use, self.asked = function, around.functions, around.use, around.asked
        self.names = around.names.scope()
        self.varying, self.varying_slots = facts.varying, facts.slots
        self.known = Known(function)
        self.made = {v.id: v for v in defined(function)}
        self.slots = {v.id: v for v in (*function.outputs, *function.variables)}
        self.slot_names: dict[int, str] = {}
        self.given: dict[tuple[str, str], str] = {}
        self.uses = Counter(v for s in walk(function.body) for v in uses(s))
        self.left = Counter(self.uses)
        self.values: dict[int, Expr] = {}
        self.waiting: set[int] = set()
        self.readers: dict[int, set[int]] = {}
        self.in_place = frozenset(s.variable for s in walk(function.body) if isinstance(s, Store) and is_partial(s))
        self.lane_names: set[str] = set()
        self.lanes = "lanes"
        self.lines: list[str] = []
        self.indent = 1
        self.shown: Loc | None = None
        self.stored: list[tuple[int, Expr]] = []
        self.updates: Updates | None = None
        self.fresh: dict[int, int] = {}

    def line(self, text: str, loc: Loc | None = None) -> None:
        """Print a line, with the source line that it came from if that is another than before."""
        self.stored.clear()
        self.lines.append("    " * self.indent + text + self.comment(loc))

    def comment(self, loc: Loc | None) -> str:
        """The end of a line that came from there, unless the line before did."""
        if loc is None or loc == self.shown:
            return ""
        self.shown = loc
        file = "".join(c if c.isprintable() else "?" for c in PurePath(loc.file).name)
        return f"  # {file}:{loc.line}"

    # Values

    def take(self, value: int) -> Expr:
        """The expression for one use of a value; one that is used again gets a name first."""
        self.left[value] -= 1
        if value in self.waiting:
            if self.left[value] > 0:
                self.bind(value)
            else:
                self.waiting.discard(value)
        return self.values[value]

    def hold(self, value: int, e: Expr) -> None:
        """Let `e` stand for a value."""
        self.values[value] = e
        for slot in e.reads:
            self.readers.setdefault(slot, set()).add(value)

    def bind(self, value: int) -> None:
        """Give a value a name of its own."""
        self.waiting.discard(value)
        made, e = self.made[value], self.values[value]
        bound = self.names.take(made.name)
        scalar = e.splat
        self.line(f"{bound} = {self.unshared(scalar or e).own().text}", made.loc)
        if value in self.varying:
            self.lane_names.add(bound)
        self.fresh[value] = self.indent
        whole = name(bound)
        if scalar is not None:
            size = made.type.size
            whole = replace(call(self.use.from_lanes("splat"), whole, str(size)), splat=whole)
        self.values[value] = whole

    def is_alone(self, value: int) -> bool:
        """Whether a value was named in this region, and nothing that is still to be written reads that name."""
        if self.fresh.get(value) != self.indent:
            return False
        named = re.compile(rf"\b{self.values[value].text}\b")
        return not any(named.search(self.values[other].text) for other in self.waiting)

    def update(self, s: Let) -> None:
        """Let the array of the first operand become the value."""
        first, *rest = s.args
        held = self.take(first)
        for symbol, operand in zip(UPDATES[s.op], rest, strict=True):
            self.line(f"{held.text} {symbol}= {self.take(operand).text}", s.value.loc)
        self.values[s.value.id] = held
        self.fresh[s.value.id] = self.indent

    def unshared(self, e: Expr) -> Expr:
        """A copy, where a later store could change the array that the expression looks into."""
        return method(e, "copy") if e.shared and e.reads & self.in_place else e

    def settle(self, slots: Iterable[int]) -> None:
        """Name all that reads one of these slots and will be asked for again: they are about to change."""
        for slot in slots:
            for value in sorted(self.readers.pop(slot, ())):
                if self.left[value] > 0 and value in self.values and slot in self.values[value].reads:
                    self.bind(value)

    def let(self, s: Let) -> None:
        """Print a Let, or keep its expression for later."""
        value = s.value.id
        self.left[value] = self.uses[value]
        if not self.left[value]:
            self.left.subtract(s.args)
            return
        if self.updates is not None and self.updates.allows(s, self.left) and self.is_alone(s.args[0]):
            self.update(s)
            return
        e = self.expression(s)
        self.hold(value, e)
        simple = e.splat if e.splat is not None else e
        if simple.depth == 0 and (simple.shared or simple.literal):
            return
        self.waiting.add(value)
        if s.value.name is not None or e.depth > MAX_DEPTH or len(e.text) > MAX_LENGTH:
            self.bind(value)

    def expression(self, s: Let) -> Expr:
        """The expression of an operation."""
        match s.op, s.attr:
            case "const", tuple(bits):
                return constant(s.value.type, bits)
            case "load", int(slot):
                return self.loaded(self.slots[slot], s.args)
            case "swizzle", tuple(components):
                return picked(self.take(s.args[0]), components)
            case ("param" | "grid_index" | "grid_shape") as op, what:
                return name(self.given[op, str(what or "")])
            case "table_size", str(table):
                return name(f"{self.given['table', table]}.size")
            case "table", str(table):
                method = "gather" if s.args[0] in self.varying else "at"
                return call(f"{self.given['table', table]}.{method}", self.take(s.args[0]).own())
            case "neighbour", str(table):
                offsets = [self.take(a) for a in s.args]
                found = call(f"{self.given['table', table]}.neighbour", name(self.given["place", ""]), *offsets)
                return replace(found, shared=True)  # it may look into the table
            case "lane_mask", _:
                return call("np.ones", self.lanes, "np.bool_")
            case "call", str(function):
                return call(self.functions[function], *[self.take(a).own() for a in s.args], *self.context(function))
        args = [self.take(a) for a in s.args]
        types = [self.made[a].type for a in s.args]
        if s.op in SHIFTS and types[0] is types[1] and self.known.within(s.args[1], 0, 31):
            return infix(SHIFTS[s.op], *args)
        return operation(s.op, args, types, s.value.type, s.value.id in self.varying, self.use)

    def context(self, function: str) -> list[Expr]:
        """What a call hands on besides the arguments."""
        return [name(self.lanes if key == LANES else self.given[key]) for key in self.asked[function]]

    def loaded(self, slot: Variable, index: tuple[int, ...]) -> Expr:
        """The expression of a load."""
        whole = name(self.slot_names[slot.id], [slot.id])
        if not index:
            return whole
        at = self.take(index[0])
        if at.literal:
            return item(whole, str(min(max(int(at.text), 0), (slot.length or 1) - 1)))
        return call(self.use.from_lanes("pick"), whole, at)
