"""Replace varying control flow by masks, so that many elements ("lanes") run as one; keep uniform control flow.

Stage: improve. Takes a module without `Discard`, whose functions take values only (`exits.py`, `by_value.py`). Returns
one whose `If`s and `Loop`s test only uniform values, with the values and variables that hold a number for each lane.

    loop:                                  $live = lane_mask
        %d = dot($z, $z)                   loop:
        if %d > 4: break                       %d = dot($z, $z)             # one a lane
        $n = $n + 1                ->          %active = $live & (%d > 4)
    ...$n...                                   if lane_any(%active):
                                                   $n_out = cond(%active, $n, $n_out)
                                                   $live = $live & ~%active
                                                   if not lane_any($live): break
                                               $n = $n + 1                  # one for all
                                           ...$n_out...

How it works, for one variable at a time:

- At every point a variable is uniform (its uniform slot holds the value of all active lanes) or varies (its lanes slot
  holds the values). A store makes it one or the other; where paths join, it varies if it varies on one of them.
- Lanes that are masked off resume somewhere: at the other side or the join of an If, at a loop's `continuing`, at the
  function's end. A variable live there is *kept*: a store to it becomes a select and it varies. Any other store is
  plain, since masked-off lanes cannot read the variable before they store it themselves (`liveness.py`).
- Inside a loop that lanes leave in different iterations, or that does not run for all lanes, a variable that other
  lanes still need has a slot of its own. Lanes that leave save their value, with one select, in the outer slot.

At the entry of a loop it is not known whether lanes leave it together and which variables vary. The best case is
assumed first; if the end of the loop contradicts it, the loop is translated again (`LoopFacts`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial

from shpy.ir.constants import Base
from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
    Discard,
    Function,
    If,
    Let,
    Loop,
    Module,
    Region,
    Return,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.ops import LANE_OPS
from shpy.ir.traverse import continues, uses, walk
from shpy.passes.calls import CallBuilder, Callees, LaneFacts
from shpy.passes.lanes import BOOL, Here, MaskScope, of_all_lanes
from shpy.passes.liveness import Note, annotate, stored_in
from shpy.passes.uniformity import varies

_WORTH_SKIPPING = 8
"""The least number of operations of a masked region that is skipped if no lane is active; smaller ones always run."""
_FREE = frozenset({"const", "load", "swizzle", "splat", "param"})


@dataclass(frozen=True, slots=True)
class VectorModule:
    """A module for many lanes, and the varying values of its entry and of each other function that is not pure."""

    module: Module
    facts: dict[str, LaneFacts]

    @property
    def entry(self) -> LaneFacts:
        """The varying values of the entry."""
        return self.facts[self.module.entry.name]


def vectorize(module: Module, *, padded: bool = False, alone: bool = False) -> VectorModule:
    """Return the module for many lanes. `padded`: some lanes have no element (`lane_mask`); `alone`: see `Callees`."""

    def make(
        function: Function, varying_inputs: frozenset[int], mask: Value | None, callees: Callees
    ) -> tuple[Function, LaneFacts]:
        work = _Vectorizer(function, varying_inputs, callees, mask, padded and function.name == module.entry.name)
        result = work.run()
        return result, LaneFacts(frozenset(work.varying), frozenset(work.slots.varying), work.slots.live())

    callees = Callees(module, make, alone=alone)
    named = callees.named(callees.entry())
    pure = (of_all_lanes(f) for f in module.functions if f.pure)
    functions = (*pure, *callees.alone.values(), *(copy.function for copy in named.values()))
    alike = dict.fromkeys(callees.alone, LaneFacts(frozenset(), frozenset()))
    return VectorModule(replace(module, functions=functions), alike | {name: c.facts for name, c in named.items()})


class _Vectorizer(CallBuilder):
    """Translates a function; repeats a loop until its facts hold, and the function until its facts and arrays hold."""

    def __init__(
        self, function: Function, varying_inputs: frozenset[int], callees: Callees, mask: Value | None, padded: bool
    ) -> None:
        super().__init__(function, varying_inputs, callees)
        self.active = mask
        self.padded = padded
        self.either = {s.value.id: s for s in walk(function.body) if padded and isinstance(s, Let) and s.op == "or"}
        self.notes = annotate(function)

    def run(self) -> Function:
        """Return the function for many lanes."""
        while True:
            size = self.facts.size() + len(self.varying_arrays)
            self.begin()
            self.b.push()
            self.body()
            body = self.b.pop()
            if self.scope.late or self.facts.size() + len(self.varying_arrays) > size:
                continue
            spread = self.spread_only(body)
            if not spread:
                return self.finished(body)
            self.always |= spread

    def spread_only(self, body: Region) -> set[int]:
        """Return the variables whose uniform slot is only copied to the lanes slot: they should vary from the start."""
        uniform = {self.slots.uniform(v).id: v for v in self.variables}
        loaded: dict[int, int] = {}
        spread: set[int] = set()
        read: set[int] = set()
        for s in walk(body):
            if isinstance(s, Let) and s.op == "load" and isinstance(s.attr, int) and s.attr in uniform:
                loaded[s.value.id] = uniform[s.attr]
            fills = isinstance(s, Store) and s.variable in self.slots.varying and s.components is None
            for value in uses(s):
                if value in loaded:
                    (spread if fills else read).add(loaded[value])
        return spread - read - self.always

    def body(self) -> None:
        mask = None if self.active is None else self.active.id
        if self.padded:
            mask = self.let("lane_mask", type=BOOL, name="active")
        if self.facts.varying:
            self.b.store(self.scope.live, self.mask(Here(mask, whole=True)))
        if not self.region(self.function.body, self.notes, Here(mask, whole=True)):
            self.meet_outside(frozenset(self.outputs), frozenset(self.outputs))

    def finished(self, body: Region) -> Function:
        outputs = [self.slots.lanes(v.id) if v.id in self.facts.exit else self.slots.uniform(v.id)
                   for v in self.function.outputs]  # fmt: skip
        used = {v.id for v in outputs}
        for s in walk(body):
            if isinstance(s, Store):
                used.add(s.variable)
            elif isinstance(s, Let) and s.op == "load" and isinstance(s.attr, int):
                used.add(s.attr)
        named = self.slots.named(used)
        first = tuple(named.pop(v.id) for v in outputs)
        return replace(self.function, outputs=first, variables=tuple(named.values()), body=body)

    # Statements

    def region(self, region: Region, notes: list[Note], here: Here) -> bool:
        """Append the translation of a region; return whether it ends in a jump, so that no statement follows it."""
        for at, (statement, note) in enumerate(zip(region, notes, strict=True), 1):
            if self.statement(statement, note, here):
                return True
            if at == len(region) or note.ends:
                return False
            if not here.thinned:
                continue
            here.thinned = False
            if not here.whole:
                rest = partial(self.region, region[at:], notes[at:], here)
                self.guarded(self.mask(here), rest, note.after | notes[-1].after | self.kept(here))
                return False
            if self.scope.note is None and _worth_skipping(region[at:]):
                self.return_if_none(self.mask(here))
        return False

    def statement(self, s: Stmt, note: Note, here: Here) -> bool:
        match s:
            case Let():
                self.operation(s, here)
            case Store() if s.variable in self.arrays:
                self.store_element(self.renamed(s), here)
            case Store():
                self.store(self.renamed(s), here)
            case If() if self.same.get(s.condition, s.condition) in self.varying:
                self.varying_if(s, note, here)
            case If():
                return self.uniform_if(s, note, here)
            case Loop():
                self.loop(s, note, here)
            case Call():
                self.call(s, here)
            case Break():
                return self.leave_loop(s, note, here)
            case Continue():
                return self.skip_iteration(s, here)
            case Discard() if self.scope.note is not None:
                return self.leave_loop(Break(s.loc), note, here, needed=self.outputs[-1:])
            case Return() | Discard():
                return self.leave_function(s, here)
            case _:
                raise TypeError(f"vectorize does not know {type(s).__name__}")
        return False

    def renamed(self, s: Store) -> Store:
        index, value = None if s.index is None else self.same.get(s.index, s.index), self.same.get(s.value, s.value)
        return s if (value, index) == (s.value, s.index) else replace(s, value=value, index=index)

    def operation(self, s: Let, here: Here) -> None:
        args = tuple(self.same.get(a, a) for a in s.args)
        varying = varies(s.op, (a in self.varying for a in args)) or (s.op == "call" and s.attr in self.callees.placed)
        self.same.pop(s.value.id, None)  # an entry from an earlier attempt, in which the argument was still uniform
        if s.op in LANE_OPS:
            if args[0] not in self.varying:
                self.same[s.value.id] = args[0]
                return
            s = self.over_lanes(s.value, s.op, args[0], here.mask)
        elif s.op == "load" and isinstance(s.attr, int):
            slot = self.array(s.attr) if s.attr in self.arrays else self.current(s.attr)
            varying = varying or slot.id in self.slots.varying
            s = Let(s.value, "load", args, slot.id)
        elif args != s.args:
            s = Let(s.value, s.op, args, s.attr)
        self.b.append(s)
        if varying:
            self.varying.add(s.value.id)
        else:
            self.varying.discard(s.value.id)

    def store(self, s: Store, here: Here) -> None:
        variable, value = s.variable, s.value
        kept = variable in self.kept(here)
        varying = value in self.varying
        if not kept and s.components is None:
            if varying or variable in self.always:
                self.state.add(variable)
            else:
                self.state.discard(variable)
        elif (kept or varying) and variable not in self.state:
            self.spread(variable)
            self.state.add(variable)
        slot = self.current(variable)
        if kept:
            assert here.mask is not None
            value = self.select(here.mask, value, self.part(self.load(slot), s.components))
        self.b.append(Store(slot.id, value, s.components, s.index, s.loc))

    def part(self, value: int, components: tuple[int, ...] | None) -> int:
        if components is None:
            return value
        return self.let("swizzle", value, type=self.b.type_of(value).sized(len(components)), attr=components)

    def array(self, variable: int) -> Variable:
        return self.slots.array(variable, variable in self.varying_arrays)

    def store_element(self, s: Store, here: Here) -> None:
        variable, value, index = s.variable, s.value, s.index
        assert index is not None
        kept = variable in self.kept(here)
        if kept or value in self.varying or index in self.varying:
            self.varying_arrays.add(variable)
        slot = self.array(variable)
        if kept and index in self.varying:
            assert here.mask is not None  # masked-off lanes store out of range, which has no effect
            type = self.b.type_of(index)
            nowhere = self.b.const(type, [-1 if type.base is Base.I else 2**32 - 1])
            index = self.let("cond", here.mask, index, nowhere.id)
        elif kept:
            assert here.mask is not None
            value = self.select(here.mask, value, self.part(self.load(slot, index), s.components))
        self.b.append(replace(s, variable=slot.id, value=value, index=index))

    # Conditions

    def uniform_if(self, s: If, note: Note, here: Here) -> bool:
        before = set(self.state)
        sides, states, ended = [], [], []
        for region, notes in zip((s.then, s.orelse), note.regions, strict=True):
            self.state = set(before)
            self.b.push()
            ended.append(self.region(region, notes, replace(here, thinned=False)))
            sides.append(self.b.pop())
            states.append(self.state)
        if not any(ended):
            self.state = states[0] | states[1]
            left: set[int] = self.scope.kept if note.exits else set()  # needed by lanes that left on either side
            needed = self.state & (note.after | self.kept(here) | left)
            sides = [self.with_spread(side, needed - state) for side, state in zip(sides, states, strict=True)]
        else:
            self.state = states[0] if ended[1] else states[1]
        condition = self.same.get(s.condition, s.condition)
        self.b.append(If(condition, sides[0], sides[1], s.loc))
        if note.exits and not all(ended):
            self.thin(here)
        return all(ended)

    def with_spread(self, region: Region, variables: Iterable[int]) -> Region:
        self.b.push()
        for variable in sorted(variables):
            self.spread(variable)
        return region + self.b.pop()

    def varying_if(self, s: If, note: Note, here: Here) -> None:
        condition = self.same.get(s.condition, s.condition)
        then, orelse = note.regions
        self.spread_early(s, note, here)
        needed = note.before | note.after | note.inner[1] | self.kept(here)
        if s.then:
            active = self.both(here.mask, condition, "leaving" if _exits(then) else "active")
            inside = Here(active, whole=False, kept=here.kept | note.inner[1])
            self.guarded(active, partial(self.region, s.then, then, inside), needed, _exits(then))
        if s.orelse:
            active = self.both(here.mask, self.let("not", condition), "leaving" if _exits(orelse) else "active")
            inside = Here(active, whole=False, kept=here.kept | note.after)
            self.guarded(active, partial(self.region, s.orelse, orelse, inside), needed, _exits(orelse))
        if note.exits:
            self.thin(here)

    def spread_early(self, s: If, note: Note, here: Here) -> None:
        """Spread, before an If whose sides may be skipped, the variables that its stores would spread."""
        kept = self.kept(here)
        masked = stored_in(s.then) & (kept | note.inner[1]) | stored_in(s.orelse) & (kept | note.after)
        for variable in sorted((masked & note.before) - self.arrays - self.state):
            self.spread(variable)
            self.state.add(variable)

    def guarded(self, mask: int, work: Callable[[], object], needed: frozenset[int], always: bool = False) -> None:
        """Append what `work` appends; if it is worth skipping, inside an If that tests whether a lane is active."""
        before = set(self.state)
        self.b.push()
        work()
        inside = self.b.pop()
        if not always and not _worth_skipping(inside):
            self.b.extend(inside)
            return
        self.state, after = before | self.state, self.state
        inside = self.with_spread(inside, (self.state - after) & needed)
        skipped = self.with_spread((), (self.state - before) & needed)
        self.b.append(If(self.let("lane_any", mask, type=BOOL), inside, skipped))

    def thin(self, here: Here) -> None:
        """Restrict the mask to the lanes still in this iteration, if some may have left."""
        scope = self.scope
        if not (scope.facts.varying or scope.facts.continues):
            return
        left = self.load(scope.iterating)
        here.mask = left if here.whole else self.both(here.mask, left)
        here.thinned = True

    # Loops

    def loop(self, s: Loop, note: Note, here: Here) -> None:
        before = set(self.state)
        while True:
            size = note.facts.size()
            self.state = set(before)
            self.b.push()
            scope = self.attempt(s, note, here)
            region = self.b.pop()
            if note.facts.size() == size and not scope.late:
                self.b.extend(region)
                return

    def attempt(self, s: Loop, note: Note, here: Here) -> MaskScope:
        """Append the translation of a loop under the facts known so far; return the loop's scope."""
        facts, outer, kept = note.facts, self.scope, self.kept(here)
        stored = note.stored - self.arrays
        inner = frozenset(v for v in stored if v in kept or (facts.varying and v in facts.copied))
        for variable in sorted(inner - self.state):
            if variable in kept or variable in note.before:
                self.spread(variable)
        entry = frozenset(self.state)
        facts.head |= entry & stored & note.inner[0]
        scope = self.enter(note, inner)
        self.fill(facts.head, entry, scope)
        self.state = set(entry - stored) | facts.head | self.always
        start = self.mask(here) if facts.varying or facts.continues else here.mask
        if facts.varying and start is not None:
            self.b.store(scope.live, start)
        still_kept = (kept | note.after if facts.varying else kept) & self.arrays
        loop = self.iteration(s, note, Here(start, whole=True, kept=still_kept))
        self.scope = outer
        self.b.append(loop)
        self.state = self.always | inner | (entry if facts.varying else (entry - stored) | facts.exit)
        if not facts.varying:
            self.merge(inner & note.after, facts.exit, here, scope)
        return scope

    def enter(self, note: Note, inner: frozenset[int]) -> MaskScope:
        live = self.slots.mask("live", id(note))
        iterating = self.slots.mask("iterating", id(note)) if note.facts.continues else live
        self.scope = MaskScope(note.facts, live, iterating, note, self.scope, inner)
        return self.scope

    def fill(self, variables: set[int], entry: frozenset[int], scope: MaskScope) -> None:
        """Initialise a loop's lanes slots with the values of the variables at its entry."""
        for variable in sorted(variables):
            if variable not in entry:
                self.spread(variable)
            elif variable in scope.inner:
                self.b.store(self.lanes(variable), self.load(self.lanes(variable, scope.outer)))

    def merge(self, variables: frozenset[int], varying: set[int], here: Here, scope: MaskScope) -> None:
        """Copy variables that a loop changed to the outer slots, for a loop that all its lanes leave together."""
        for variable in sorted(variables):
            slot = self.lanes(variable, scope) if variable in varying else self.slots.uniform(variable)
            outside = self.lanes(variable)
            self.b.store(outside, self.select(self.mask(here), self.load(slot), self.load(outside)))

    def iteration(self, s: Loop, note: Note, here: Here) -> Loop:
        """Return the translated loop: its body, `continuing` and test."""
        scope, facts = self.scope, note.facts
        start = here.mask
        self.b.push()
        if facts.varying:
            here.mask = self.load(scope.live)
        begin = here.mask
        ended = self.region(s.body, note.regions[0], here)
        if not ended:
            self.meet(facts.step, note.stored - self.arrays, note.inner[1])
        body = self.b.pop()
        if facts.continues and begin is not None:
            body = _before_use(scope.iterating.id, Store(scope.iterating.id, begin), body)
        if not continues(s) and (ended or any(n.ends for n in note.regions[0])):
            return Loop(body, (), None, s.turns, s.loc)
        self.state = (self.state - note.stored) | facts.step | self.always
        scope.kept.clear()
        scope.continued = False
        self.b.push()
        step = Here(self.load(scope.live) if facts.varying else start, whole=True, kept=here.kept)
        self.region(s.continuing, note.regions[1], step)
        self.meet(facts.head, note.stored - self.arrays, note.inner[0])
        until = self.test(s, note, step)
        continuing = self.b.pop()
        if facts.varying and until is None and not facts.jumps:
            return Loop(body + continuing, (), None, s.turns, s.loc)
        return Loop(body, continuing, until, s.turns, s.loc)

    def test(self, s: Loop, note: Note, here: Here) -> int | None:
        """Append the test at the end of an iteration; return the value for `until`, or None if no test remains."""
        if s.until is None:
            return None
        until = self.same.get(s.until, s.until)
        if until in self.varying:
            return self.varying_test(s, note, self.mask(here), until)
        self.b.push()
        if note.facts.varying:
            self.put_aside(note.dirty_at_until, note.after, self.mask(here))
        else:
            self.meet_outside(note.stored - self.arrays, note.after)
        leaving = self.b.pop()
        if leaving:
            self.b.append(If(until, leaving, (), s.loc))
        return until

    def varying_test(self, s: Loop, note: Note, mask: int, until: int) -> int | None:
        """Append the test by which lanes of `mask` leave, some before others; return the value for `until`, or None."""
        scope, facts, sides = self.scope, note.facts, self.sides(self.either.get(until))
        facts.varying = True
        active = self.both(mask, until if sides is None else sides[0], "leaving")
        some = self.let("lane_any", active, type=BOOL)
        some = some if sides is None else self.let("or", sides[1], some)
        self.b.push()
        active = active if sides is None else self.let("or", active, self.both(mask, sides[1]))
        self.put_aside(note.dirty_at_until, note.after, active)
        self.remove(scope.live, active)
        if not facts.jumps:
            self.b.append(If(self.none(self.load(scope.live)), (Break(s.loc),), (), s.loc))
        self.b.append(If(some, self.b.pop(), (), s.loc))
        return self.none(self.load(scope.live)) if facts.jumps else None


def _before_use(slot: int, store: Store, region: Region) -> Region:
    """Return the region with `store` inserted before the first statement that loads or stores the slot."""
    for at, statement in enumerate(region):
        for s in walk((statement,)):
            if (isinstance(s, Store) and s.variable == slot) or (
                isinstance(s, Let) and s.op == "load" and s.attr == slot
            ):
                return (*region[:at], store, *region[at:])
    return region


def _exits(notes: list[Note]) -> bool:
    return any(note.exits for note in notes)


def _worth_skipping(region: Region) -> bool:
    """Return whether a test for active lanes costs less than running the region without any."""
    work = 0
    for s in walk(region):
        if isinstance(s, Loop | Call) or (isinstance(s, Let) and s.op in ("table", "call")):
            return True
        work += isinstance(s, Let) and s.op not in _FREE
    return work >= _WORTH_SKIPPING
