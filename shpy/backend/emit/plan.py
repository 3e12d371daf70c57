"""The plan of a function's text: names of values, places of declarations, the heads of loops.

Stage: emit, before there is a tree. All of it is decided from the ids of values, variables and regions. A region is
known by its number, counted in program order: the body is 0. A value that has one use, in its own region, and no name
stands where it is used, unless a store comes between that changes what it reads: then it is declared before the store.

    $n is stored first in each iteration, and used in no other region  ->  declared inside the loop
    $n is loaded before it is stored in an iteration                   ->  declared, zero, before the loop

    %3 = add %1, %2 (of $x)                        float t = x + y;
    store $x = 0                       ->          x = 0.0f;
    store $y = %3                                  y = t;
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from shpy.backend.emit.operations import OPERATORS
from shpy.backend.emit.survey import Place, Survey
from shpy.ir.constants import decode
from shpy.ir.nodes import Call, Function, If, Let, Loop, Region, Return, Stmt, Store, Value
from shpy.ir.traverse import changed_variables, defined, results, test_length, uses, variables_of
from shpy.ir.types import Base

MAX_DEPTH: Final = 32
"""Expressions nest no deeper: compilers give up at 256 brackets, readers before."""
MAX_WIDTH: Final = 100
"""Letters, about, of an expression that needs no name."""
_NONE: Final[frozenset[int]] = frozenset()


@dataclass(frozen=True, slots=True)
class Wishes:
    """The wishes that a target has for a plan."""

    apart: Callable[[set[int]], Collection[int]] = lambda inlined: ()
    """Gives the values that must have a name, of those that may stand where they are used."""
    repeats: Callable[[Let | Store], Collection[int]] = lambda s: ()
    """Gives the operands of a statement that the target writes more than once."""
    letters: Callable[[str], int] = lambda op: len(op) + 3
    """Gives the length of the name of the function that does an operation, nearly."""
    direct: Collection[int] = ()
    """Outputs that need no variable."""
    begun: Collection[int] = ()
    """Variables that are parameters."""
    result: int | None = None
    """The output that the function returns, as an expression where it can."""


@dataclass(slots=True)
class Plan:
    """The answers to what `structure` asks about one function."""

    survey: Survey
    """The facts from which it was made."""
    declared: dict[Place, list[int]] = field(default_factory=dict)
    """Variables that are declared before a statement."""
    zeroed: set[int] = field(default_factory=set)
    """Variables that may be read before they are stored."""
    named: set[int] = field(default_factory=set)
    """Values that are declared where they are made."""
    settled: dict[Place, list[int]] = field(default_factory=dict)
    """Values that are declared before a statement."""
    adopts: set[Place] = field(default_factory=set)
    """Stores whose variable stands from then on for the value that the statement before made."""
    starts: set[Place] = field(default_factory=set)
    """Stores that give the counter of the next loop its first value."""
    kept: set[Place] = field(default_factory=set)
    """Stores by which an input of the same name goes on as a variable."""
    returns: set[Place] = field(default_factory=set)
    """Stores of the result that end the function."""
    tests: dict[Place, int] = field(default_factory=dict)
    """The index at which the body goes on, of a loop whose first statements can be its test."""
    steps: set[Place] = field(default_factory=set)
    """Loops whose `continuing` is an assignment that can stand in the head of a `for`."""
    feet: set[Place] = field(default_factory=set)
    """Loops whose `continuing` does nothing but compute `until`, from what is known outside of the body."""
    updated: set[int] = field(default_factory=set)
    """Values for which the array of the first operand stands, which changes (`late`)."""
    adopting: set[Place] = field(default_factory=set)
    """Stores after which the variable stands for the value (`late`)."""
    results: dict[Place, dict[int, int]] = field(default_factory=dict)
    """By call, the variables whose names its results get (`late`)."""
    unnamed: int | None = None
    """The result, if it needs no variable: every way through the function ends with a store of it."""

    def is_expression(self, region: Region, number: int) -> bool:
        """Return whether nothing is declared in or before these first statements of a region."""
        places = [(number, index) for index in range(len(region))]
        if any(place in self.settled or place in self.declared for place in places):
            return False
        return not any(isinstance(s, Let) and s.value.id in self.named for s in region)


def plan(function: Function, callees: Mapping[str, Function], wishes: Wishes | None = None) -> Plan:
    """Plan the text of `function`; `callees` are all functions by name."""
    return Planner(function, callees, wishes or Wishes()).run()


class Planner:
    """One walk in program order."""

    def __init__(self, function: Function, callees: Mapping[str, Function], wishes: Wishes) -> None:
        self.function, self.callees, self.wishes = function, callees, wishes
        self.survey = survey = Survey(function, callees)
        self.inlined = self.find_inlined()
        self.homes: dict[int, int] = {}
        """The regions in which variables are declared."""
        self.plan = Plan(self.survey)
        self.declare()
        self.left = Counter(survey.uses)
        self.variable_names = {v.id: v.name for v in variables_of(function)}
        self.value_names = {v.id: v.name for v in defined(function)}
        self.inputs = {i.id for i in function.inputs if isinstance(i, Value)}
        self.begun = set(wishes.begun)
        self.reads: dict[int, frozenset[int]] = {}
        """The variables that the expressions of values without a name read."""
        self.read_first: dict[int, frozenset[int]] = {}
        """The same, whether they get a name later or not."""
        self.sizes: dict[int, tuple[int, int]] = {}
        """The depth and the letters of their expressions."""
        self.pending: dict[int, None] = {}
        """Values without a name that are still to be used."""

    def run(self) -> Plan:
        """Return the plan."""
        result = self.wishes.result
        if result is not None:
            self.find_returns(result)
        self.region(self.function.body, 0)
        return self.plan

    def find_inlined(self) -> set[int]:
        """Return the values that may stand where they are used."""
        inlined = {value for value in self.survey.lets if self.survey.may_inline(value)}
        return inlined.difference(self.wishes.apart(inlined))

    def declare(self) -> None:
        """Find where each variable is declared."""
        function = self.function
        for variable in variables_of(function):
            if variable in function.inputs:
                continue
            place = self.survey.place(variable, output=variable in function.outputs)
            if place is not None:
                where, zero = place
                self.plan.declared.setdefault(where, []).append(variable.id)
                self.homes[variable.id] = where[0]
                if zero:
                    self.plan.zeroed.add(variable.id)

    # Returns

    def find_returns(self, result: int) -> None:
        """Find the stores that become returns, and whether they are all that touches the result."""
        self.gives_variable = False
        ended = self._final_stores(self.function.body, 0, result, tail=True)
        others = self.survey.touched.get(result, {}).keys() - self.plan.returns
        if ended and not self.gives_variable and all(isinstance(self.survey.statement(at), Return) for at in others):
            self.plan.unnamed = result

    def _final_stores(self, region: Region, number: int, result: int, *, tail: bool) -> bool:
        """Return whether a region is always left by such a store; `tail`: the function ends where the region does."""
        end = len(region)
        while end and isinstance(region[end - 1], Return):
            end -= 1
        ended = False
        for index in range(end):
            s, last = region[index], index + 1 == end
            match s:
                case Store(variable, _, None, None) if variable == result and last and (tail or end < len(region)):
                    self.plan.returns.add((number, index))
                    ended = True
                case If():
                    inner = zip((s.then, s.orelse), self.survey.inner[number, index], strict=True)
                    ended = all([self._final_stores(r, n, result, tail=tail and last) for r, n in inner])
                case Loop():
                    for r, n in zip((s.body, s.continuing), self.survey.inner[number, index], strict=True):
                        self._final_stores(r, n, result, tail=False)
            if ended:
                break
        self.gives_variable = self.gives_variable or (end < len(region) and not ended)
        return ended

    # Uses and names

    def use(self, value: int) -> None:
        """Count a use."""
        self.left[value] -= 1
        if not self.left[value]:
            self.pending.pop(value, None)

    def name(self, value: int) -> None:
        """Note that from now on a name stands for the value."""
        self.pending.pop(value, None)
        self.reads.pop(value, None)
        self.sizes.pop(value, None)

    def settle(self, place: Place, values: Iterable[int]) -> None:
        """Let these be declared before a statement."""
        for value in values:
            self.plan.settled.setdefault(place, []).append(value)
            self.name(value)

    def change(self, place: Place, variables: Collection[int]) -> None:
        """Name what reads these variables and is used after the statement that changes them."""
        if self.pending and variables:
            self.settle(place, [v for v in self.pending if not self.reads[v].isdisjoint(variables)])

    def repeat(self, place: Place, values: Iterable[int]) -> None:
        """Name what a statement would write more than once, unless it is a name or a number."""
        self.settle(place, [v for v in values if self.sizes.get(v, (0, 0))[0] > 0])

    # Statements

    def region(self, region: Region, number: int) -> None:
        """Plan a region; what is pending at its end was its own."""
        before = set(self.pending)
        self.statements(region, number)
        self.pending = {v: None for v in self.pending if v in before}

    def statements(self, region: Region, number: int) -> None:
        """Plan the statements of a region."""
        for index, s in enumerate(region):
            place = number, index
            if place in self.plan.returns and isinstance(s, Store):
                self.use(s.value)
                continue
            for variable in self.plan.declared.get(place, ()):
                if variable in self.plan.zeroed or not (isinstance(s, Store) and s.variable == variable):
                    self.begun.add(variable)
            self.statement(s, place)

    def statement(self, s: Stmt, place: Place) -> None:
        """Plan one statement."""
        match s:
            case Let():
                self.let(s, place)
            case Store():
                self.store(s, place)
            case Call():
                for value in uses(s, self.callees):
                    self.use(value)
                self.change(place, changed_variables(s, self.callees))
            case If():
                self.use(s.condition)
                self.change(place, self.survey.stored[place])
                for inner, number in zip((s.then, s.orelse), self.survey.inner[place], strict=True):
                    self.region(inner, number)
            case Loop():
                self.loop(s, place)

    def let(self, s: Let, place: Place) -> None:
        """Plan the name of a value."""
        value = s.value.id
        if not self.survey.uses[value]:
            return
        self.repeat(place, self.wishes.repeats(s))
        depth, width = self.size(s)
        fits = depth <= MAX_DEPTH and (width <= MAX_WIDTH or self.is_given(value, place))
        reads = _NONE.union(*(self.reads.get(a, _NONE) for a in s.args))
        if s.op == "load" and isinstance(s.attr, int):
            reads |= {s.attr}
        for a in s.args:
            self.use(a)
        if fits and value in self.inlined:
            self.pending[value] = None
            self.reads[value] = self.read_first[value] = reads
            self.sizes[value] = depth, width
        elif fits and self.goes_into_a_variable(s.value, place):
            self.plan.adopts.add((place[0], place[1] + 1))
            self.reads[value] = reads
        else:
            self.plan.named.add(value)

    def is_given(self, value: int, place: Place) -> bool:
        """Return whether the next statement does nothing but return the value, or write it to an output."""
        store = self.survey.following(place)
        if not isinstance(store, Store) or store.value != value:
            return False
        return (place[0], place[1] + 1) in self.plan.returns or store.variable in self.wishes.direct

    def goes_into_a_variable(self, value: Value, place: Place) -> bool:
        """Return whether the next statement stores it: then that variable's name stands for it."""
        store = self.survey.following(place)
        if not isinstance(store, Store) or store.value != value.id or not is_whole(store):
            return False
        if value.name not in (None, self.variable_names[store.variable]) or store.variable in self.wishes.direct:
            return False
        return not self.opens_for(store, _NONE, (place[0], place[1] + 1))

    def store(self, s: Store, place: Place) -> None:
        """Plan a store: what it names, and whether it starts a variable."""
        self.use(s.value)
        if s.variable in self.wishes.direct:
            return
        if s.index is not None:
            self.change(place, [s.variable])
            self.repeat(place, self.wishes.repeats(s))
            self.use(s.index)
            return
        if s.variable in self.begun:
            self.change(place, [s.variable])
        elif self.goes_on(s):
            self.plan.kept.add(place)
        elif self.opens_for(s, self.reads.get(s.value, _NONE), place):
            self.plan.starts.add(place)
        self.begun.add(s.variable)
        if place in self.plan.adopts:
            self.reads[s.value] = frozenset({s.variable})
            if self.left[s.value]:
                self.pending[s.value] = None

    def goes_on(self, s: Store) -> bool:
        """Return whether the variable starts as an input of its name that is not used again."""
        if s.value not in self.inputs or self.left[s.value] or self.homes[s.variable]:
            return False
        return self.value_names[s.value] == self.variable_names[s.variable] is not None

    # Loops

    def loop(self, s: Loop, place: Place) -> None:
        """Plan a loop and its head."""
        self.change(place, self.survey.stored[place])
        self.iteration(s, place)
        continuing = self.survey.inner[place][1]
        if self.plan.is_expression(s.continuing, continuing) and not self._reads_body(s, place):
            if s.until is None and is_step(s.continuing):
                self.plan.steps.add(place)
            elif s.until is not None and all(isinstance(t, Let) for t in s.continuing):
                self.plan.feet.add(place)

    def iteration(self, s: Loop, place: Place) -> None:
        """Plan an iteration, and whether its first statements can be the test of the loop."""
        before = set(self.pending)
        body, continuing = self.survey.inner[place]
        self.statements(s.body, body)
        self.statements(s.continuing, continuing)
        if s.until is not None:
            self.use(s.until)
        self.pending = {v: None for v in self.pending if v in before}
        test = leading_test(s.body)
        if test is not None and self.plan.is_expression(s.body[: test + 1], body):
            self.plan.tests[place] = test + 1

    def _reads_body(self, s: Loop, place: Place) -> bool:
        """Return whether `continuing` or `until` use values of the body but those of its first test that stay."""
        changed = self.survey.stored_in[self.survey.inner[place][0]]
        start = self.plan.tests.get(place, 0) if s.until is None else 0
        inside = {
            v.id
            for index, t in enumerate(s.body)
            for v in results(t)
            if index >= start or not changed.isdisjoint(self.read_first.get(v.id, _NONE))
        }
        used = {v for t in s.continuing for v in uses(t)} | {s.until}
        return not inside.isdisjoint(used)

    def opens_for(self, s: Store, reads: frozenset[int], place: Place) -> bool:
        """Return whether the store gives a counter its first value, and only the loop that follows touches it.

        Stores of what that value does not read may come between.
        """
        if s.variable not in self.survey.counters:
            return False
        region, index, between = self.survey.regions[place[0]], place[1] + 1, set()
        while index < len(region) and isinstance(region[index], Let | Store):
            if isinstance(other := region[index], Store):
                between.add(other.variable)
            index += 1
        loop = region[index] if index < len(region) else None
        if not isinstance(loop, Loop) or loop.until is not None or not is_step(loop.continuing):
            return False
        step = loop.continuing[-1]
        if not isinstance(step, Store) or step.variable != s.variable or leading_test(loop.body) is None:
            return False
        inside = self.survey.touches_inside((place[0], index), s.variable)
        return reads.isdisjoint(between) and len(self.survey.touched[s.variable]) == inside + 1

    # Sizes

    def size(self, s: Let) -> tuple[int, int]:
        """Return how deep the expression nests and, nearly, how many letters it has."""
        sizes = [self.sizes.get(a) or (0, len(self.value_names.get(a) or "t10")) for a in s.args]
        depth, width = 1 + max([d for d, _ in sizes], default=-1), sum([w for _, w in sizes])
        match s.op:
            case "load" if not s.args:
                assert isinstance(s.attr, int)
                return 0, len(self.variable_names[s.attr] or "v10")
            case "const":
                return min(1, s.value.type.size - 1), _letters_of(s)
            case "swizzle":
                assert isinstance(s.attr, tuple)
                return sizes[0][0], width + 1 + len(s.attr)
            case "splat" | "construct":
                return depth, width + 6 + 2 * len(sizes)
            case "any_lane" | "all_lanes":
                return sizes[0][0], width
            case "not" | "neg":
                return depth, width + 1
            case "cond":
                brackets = sum([2 for a in s.args if a in self.sizes and self.survey.lets[a].op == "cond"])
                return depth, width + 6 + brackets
            case op if op in OPERATORS:
                return depth, width + 3
        name = len(s.attr) if isinstance(s.attr, str) else self.wishes.letters(s.op)
        if s.op == "table":
            name = 2 * name + 16
        return depth, width + name + 2 * len(sizes)


def _letters_of(const: Let) -> int:
    """Estimate the letters of a constant: a number or a vector of numbers."""
    type = const.value.type
    assert isinstance(const.attr, tuple)
    numbers = decode(type, const.attr[:1] if len(set(const.attr)) == 1 else const.attr)
    letters = sum([_digits(c) + 1 if type.base is Base.F else len(repr(c)) for c in numbers])
    return letters if type.size == 1 else letters + 8 + 2 * len(numbers)


def _digits(x: float) -> int:
    """Estimate the letters of a binary32."""
    text = f"{x:.8g}"
    return len(text) if x != x or "." in text or "e" in text else len(text) + 2


def is_whole(store: Store) -> bool:
    """Return whether all of a variable is stored."""
    return store.components is None and store.index is None


def leading_test(body: Region) -> int | None:
    """Return the index of the `If(c) { Break }` that comes after nothing but Lets."""
    at = test_length(body) - 1
    return at if at >= 0 and all(isinstance(s, Let) for s in body[:at]) else None


def is_step(region: Region) -> bool:
    """Return whether the region is Lets and then one store of a whole variable."""
    *lets, last = region or (None,)
    return isinstance(last, Store) and is_whole(last) and all(isinstance(s, Let) for s in lets)
