"""Plan the names of values in a language like Python, whose names need no declaration and last to the function's end.

Stage: emit. A value gets its name before its second use is written, not where it is computed. So a value that only one
side of an If uses is computed there, and a value that is stored first gets the variable's name. Users' names stay.

    %3 = mul %1, %2            t = a * b                 if %c { ... %4 ... }       if c:
    %4 = add %3, 1        ->   x = t + 1            %4 is used there alone    ->        t = f(a)
    store $x = %4              y = x * t                                                ... t ... t
    store $y = mul %4, %3
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from shpy.backend.emit.operations import OPERATORS
from shpy.backend.emit.plan import MAX_DEPTH, Plan, Planner, Wishes, is_whole
from shpy.backend.emit.survey import Place
from shpy.ir.constants import decode
from shpy.ir.nodes import Call, Function, If, Let, Loop, Region, Stmt, Store
from shpy.ir.traverse import continues, regions_of, uses, walk
from shpy.ir.types import Base

MAX_WIDTH: Final = 88
"""Letters, about, of an expression that needs no name."""
_BITS: Final = frozenset({"and", "or", "xor"})
_SUMS: Final = frozenset({"add", "sub", "mad"})
_NONE: Final[frozenset[int]] = frozenset()


@dataclass(frozen=True, slots=True)
class LateWishes:
    """The wishes that a target has for such a plan."""

    letters: Callable[[str], int]
    """Gives the length of the name of the function that does an operation, nearly."""
    glimpses: Collection[int]
    """Values that are a name or a number: each use writes them, also where the user gave a name."""
    views: Collection[int]
    """Values that look into their first operand: glimpses too, where that has a name."""
    holds: Callable[[int, int], bool]
    """Tells whether a value that is stored into a variable can use the variable's name."""
    changing: Collection[int]
    """Variables whose arrays change in part: such a variable is never the same array as another."""
    updates: Callable[[Let], bool]
    """Tells whether the operation may change the array of its first operand, if nothing else reads that."""
    kept: Mapping[int, int]
    """Values that stand for a variable from the start, by their ids."""


def plan_late(function: Function, callees: Mapping[str, Function], wishes: LateWishes) -> Plan:
    """Plan the text of `function`; `callees` are all functions by name."""
    return _LatePlanner(function, callees, wishes).run()


class _LatePlanner(Planner):
    """One walk in program order."""

    def __init__(self, function: Function, callees: Mapping[str, Function], late: LateWishes) -> None:
        super().__init__(function, callees, Wishes(letters=late.letters))
        self.late = late
        self.waiting: dict[int, None] = {}
        """Values that are still to be written, and would get a name."""
        self.fresh: dict[int, int] = {}
        """The region in which a value was named."""
        self.root: dict[int, int] = {}
        """The first of the values that one array stands for, one after the other."""
        self.mentions: dict[int, frozenset[int]] = {}
        """The named values in the expressions of others, by their roots."""
        self.stands: dict[int, int] = dict(late.kept)
        """Values for which a variable's name stands."""
        self.forced: set[int] = set()
        """Values that every way to the end of an iteration needs."""
        self.glimpses = set(late.glimpses)
        self.at = 0

    def find_inlined(self) -> set[int]:
        return set()

    def declare(self) -> None:
        pass

    # Uses and names

    def use(self, value: int) -> None:
        super().use(value)
        if not self.left[value]:
            self.waiting.pop(value, None)

    def need(self, value: int, place: Place) -> None:
        """Count a use of a value, which is named first if it is used again."""
        self.use(value)
        if self.left[value] and value in self.waiting:
            self.settle(place, [value])

    def name(self, value: int) -> None:
        super().name(value)
        self.waiting.pop(value, None)
        self.stands.pop(value, None)
        self.mentions.pop(value, None)
        self.fresh[value] = self.at
        self.root[value] = value

    def region(self, region: Region, number: int) -> None:
        waiting = set(self.waiting)
        super().region(region, number)
        self.waiting = {v: None for v in self.waiting if v in waiting}

    # Statements

    def statements(self, region: Region, number: int) -> None:
        outer = self.at
        for index, s in enumerate(region):
            self.at = number
            self.statement(s, (number, index))
        self.at = outer

    def statement(self, s: Stmt, place: Place) -> None:
        match s:
            case If():
                self.need(s.condition, place)
                self.enter(s, place)
                for inner, number in zip((s.then, s.orelse), self.survey.inner[place], strict=True):
                    self.region(inner, number)
            case Call():
                self.call(s, place)
            case _:
                super().statement(s, place)

    def let(self, s: Let, place: Place) -> None:
        value = s.value.id
        if not self.survey.uses[value]:
            for a in s.args:
                self.use(a)
            return
        if self.may_update(s, place):
            for a in s.args:
                self.need(a, place)
            self.plan.updated.add(value)
            self.fresh[value], self.root[value] = self.at, self.root[s.args[0]]
            return
        for a in s.args:
            self.need(a, place)
        depth, width = self.size(s)
        reads = _NONE.union(*(self.reads.get(a, _NONE) for a in s.args))
        if s.op == "load" and isinstance(s.attr, int):
            reads |= {s.attr}
            if not s.args:
                self.stands[value] = s.attr
        self.reads[value] = self.read_first[value] = reads
        self.sizes[value] = depth, width
        self.mentions[value] = _NONE.union(*(self.mentioned(a) for a in s.args))
        self.pending[value] = None
        glimpse = value in self.glimpses or (value in self.late.views and self.is_written(s.args[0]))
        if glimpse:
            self.glimpses.add(value)
        else:
            self.waiting[value] = None
        if value in self.forced or not (
            glimpse or (s.value.name is None and depth <= MAX_DEPTH and width <= MAX_WIDTH)
        ):
            self.plan.named.add(value)
            self.name(value)

    def is_written(self, value: int) -> bool:
        """Return whether a name or a number stands for the value."""
        return value in self.glimpses or value in self.root or value in self.stands

    def size(self, s: Let) -> tuple[int, int]:
        """Return the size as the base does, of Python's spelling.

        The estimate is not C's, because vectors of numbers, such as `np.int32([[-1], [0]])`, and brackets take more
        letters: with C's estimate a sum of two reads at constant offsets is one line of 150 letters.
        """
        sizes = [self.sizes.get(a) or (0, len(self.value_names.get(a) or "t10")) for a in s.args]
        depth, width = 1 + max([d for d, _ in sizes], default=-1), sum([w for _, w in sizes])
        match s.op:
            case "const":
                return 0, _letters_of(s)
            case "splat":
                return depth, width
            case "swizzle":
                return sizes[0][0], width + (3 if s.value.type.size == 1 else 4)
            case "mad":
                return depth, width + 6 + self.brackets("mul", s.args[:2]) + self.brackets("add", s.args[2:])
            case "cond":
                literals = [a for a in s.args[1:] if a in self.survey.lets and self.survey.lets[a].op == "const"]
                return depth, width + (24 if len(literals) == 2 else 12)  # two literals: one has a type of its own
            case "neg" | "not":
                return depth, width + 1 + self.brackets("mul", s.args)
            case op if op in OPERATORS:
                return depth, width + 3 + self.brackets(op, s.args)
        return super().size(s)

    def brackets(self, op: str, args: Sequence[int]) -> int:
        """Return the letters of the brackets around the operands of an operator."""
        inner = [self.survey.lets[a].op if a in self.sizes and a in self.survey.lets else "" for a in args]
        if op in _BITS:
            return sum([2 for i in inner if i in OPERATORS and i != op])
        if op in _SUMS:
            return sum([2 for i in inner[1:] if i in _SUMS])
        return sum([2 for at, i in enumerate(inner) if i in _SUMS or (at and i in ("mul", "div"))])

    def mentioned(self, value: int) -> frozenset[int]:
        """Return the roots of the named values in an expression."""
        root = self.root.get(value)
        return self.mentions.get(value, _NONE) if root is None else frozenset({root})

    def may_update(self, s: Let, place: Place) -> bool:
        """Return whether the first operand was named in this region, and nothing reads its array any more."""
        if not s.args or self.fresh.get(s.args[0]) != place[0] or not self.late.updates(s):
            return False
        first, *rest = s.args
        root = self.root[first]
        if self.left[first] != 1 or first in rest:
            return False
        return not any(root in self.mentions.get(other, _NONE) for other in self.waiting)

    def store(self, s: Store, place: Place) -> None:
        variable, value = s.variable, s.value
        if is_whole(s) and self.stands.get(value) == variable and variable not in self.late.changing:
            self.use(value)
            return
        if is_whole(s) and value in self.waiting and self.left[value] > 1 and self.late.holds(value, variable):
            self.use(value)
            self.name(value)
            del self.fresh[value], self.root[value]
            self.change(place, [variable])
            self.plan.adopting.add(place)
            self.stand(value, variable)
            return
        self.need(value, place)
        if s.index is not None:
            self.need(s.index, place)
        self.change(place, [variable])

    def stand(self, value: int, variable: int) -> None:
        """Let a variable's name stand for a value."""
        self.stands[value] = variable
        self.reads[value] = frozenset({variable})
        if self.left[value]:
            self.pending[value] = None

    def call(self, s: Call, place: Place) -> None:
        for a in s.args:
            self.need(a, place)
        slots = self.plan.results[place] = self.stored_results(s, place)
        self.change(place, slots.values())
        for result in s.results:
            if result.id in slots:
                self.stand(result.id, slots[result.id])
            else:
                self.root[result.id] = result.id

    def stored_results(self, s: Call, place: Place) -> dict[int, int]:
        """Return the variables that the statements after a call store its results into, and nothing else."""
        results = {r.id for r in s.results}
        variables: dict[int, int] = {}
        for store in self.survey.regions[place[0]][place[1] + 1 :]:
            if not isinstance(store, Store) or store.value not in results - variables.keys() or not is_whole(store):
                break
            variable = store.variable
            in_use = variable in self.late.changing or variable in variables.values()
            if self.late.holds(store.value, variable) and not in_use:
                variables[store.value] = variable
        return variables

    def enter(self, s: If | Loop, place: Place) -> None:
        """Name the values that must be computed before the region, and those used later that change in it."""
        if self.waiting:
            inside = [Counter(v for n in walk(r) for v in uses(n)) for r in regions_of(s)]
            if isinstance(s, Loop) and s.until is not None:
                inside.append(Counter((s.until,)))
            for value in sorted(self.waiting):
                counts = [count[value] for count in inside]
                if sum(counts) and (isinstance(s, Loop) or self.left[value] > max(counts)):
                    self.settle(place, [value])
        self.change(place, self.survey.stored[place])

    def loop(self, s: Loop, place: Place) -> None:
        self.enter(s, place)
        waiting = set(self.waiting)
        if continues(s):
            inside = {t.value.id for t in walk(s.body) if isinstance(t, Let)}
            self.forced |= inside & {s.until, *(v for t in walk(s.continuing) for v in uses(t))}
        self.iteration(s, place)
        self.waiting = {v: None for v in self.waiting if v in waiting}


def _letters_of(const: Let) -> int:
    """Estimate the letters of a constant: a number, or a vector that repeats one number or lists several."""
    type = const.value.type
    assert isinstance(const.attr, tuple)
    numbers = decode(type, const.attr[:1] if len(set(const.attr)) == 1 else const.attr)
    letters = sum([_digits(c, type.base) for c in numbers])
    return letters if len(numbers) == 1 else letters + 12 + 4 * len(numbers)


def _digits(x: float, base: Base) -> int:
    """Estimate the letters of a number."""
    if base not in (Base.F, Base.H):
        return len(repr(x))
    text = f"{x:.7g}"
    if float(np.float32(text)) != x:
        text = f"{x:.8g}"
    return len(text) if x != x or "." in text or "e" in text else len(text) + 2
