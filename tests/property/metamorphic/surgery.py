"""Places in a function, and how to change what stands there: the ground on which the changes stand.

Stage: test. A `Place` is a run of statements in one region; `replaced` puts others there. What the statements made and
what is used behind them can be carried out of a new region by variables.

    before; [ a; b ]; after(a)      ->      before; loop { a; b; store $kept = a }; a' = load $kept; after(a')
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from shpy.ir.builder import Builder
from shpy.ir.nodes import (
    EXITS,
    Break,
    Call,
    Continue,
    Function,
    If,
    Let,
    Loop,
    Region,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.traverse import map_regions, results, test_length


@dataclass(frozen=True)
class Place:
    """Statements `start` to `stop` of `region`, where the values `seen` are visible at its start."""

    region: Region
    start: int
    stop: int
    seen: tuple[Value, ...]

    @property
    def statements(self) -> Region:
        """The statement at the place."""
        return self.region[self.start : self.stop]


@dataclass(frozen=True)
class _Spot:
    """A region in which something can be changed: from statement `head` on."""

    region: Region
    head: int
    seen: tuple[Value, ...]


class Surgeon:
    """Changes one function at places drawn by `rng`; `functions` are those that it may call."""

    def __init__(self, function: Function, functions: dict[str, Function], rng: random.Random) -> None:
        self.function = function
        self.functions = functions
        self.rng = rng
        self.b = Builder(function=function)

    # Places

    def spots(self) -> list[_Spot]:
        """Find every region that is not empty; the statements before a loop's test stay: iterations count from it."""
        inputs = tuple(p for p in self.function.inputs if isinstance(p, Value))
        return [spot for spot in self._spots(self.function.body, inputs, 0) if spot.region]

    def _spots(self, region: Region, seen: tuple[Value, ...], head: int) -> Iterator[_Spot]:
        yield _Spot(region, head, seen)
        for s in region:
            match s:
                case If(_, then, orelse):
                    yield from self._spots(then, seen, 0)
                    yield from self._spots(orelse, seen, 0)
                case Loop(body, continuing, _, turns):
                    yield from self._spots(body, seen, test_length(body) if turns is None else 0)
                    # What a Continue skips is not seen there; the values from outside are.
                    yield from self._spots(continuing, seen, 0)
            seen = (*seen, *results(s))

    def place(self, at_most: int, fits: Callable[[Region], bool] = lambda statements: True) -> Place | None:
        """Up to `at_most` statements somewhere, none where it is 0; None if there is no place that fits."""
        spots = [s for s in self.spots() if len(s.region) > s.head]
        self.rng.shuffle(spots)
        for spot in spots[:8]:
            last = len(spot.region)
            if at_most == 0 and spot.region and isinstance(spot.region[-1], EXITS):
                last -= 1
            start = self.rng.randint(spot.head, max(spot.head, last - (at_most > 0)))
            stop = min(len(spot.region), start + self.rng.randint(1, at_most)) if at_most else start
            seen = (*spot.seen, *(v for s in spot.region[:start] for v in results(s)))
            found = Place(spot.region, start, stop, seen)
            if fits(found.statements):
                return found
        return None

    # Changes

    def replaced(self, place: Place, statements: Region, renamed: dict[int, int] | None = None) -> Function:
        """Return the function with other statements there; uses of `renamed` values outside them read others."""
        made = place.region[: place.start] + statements + place.region[place.stop :]

        def change(region: Region) -> Region:
            if region is place.region:
                head, tail = made[: place.start], made[place.start + len(statements) :]
                return (*map(fix, head), *statements, *map(fix, tail))
            return tuple(map(fix, region))

        def fix(s: Stmt) -> Stmt:
            return self.renamed(map_regions(s, change), renamed or {})

        return replace(self.b.finish(), body=change(self.function.body))

    def renamed(self, s: Stmt, names: dict[int, int]) -> Stmt:
        """Return the statement reading other values."""
        if not names:
            return s

        def new(id: int) -> int:
            return names.get(id, id)

        match s:
            case Let():
                return replace(s, args=tuple(map(new, s.args)))
            case Store():
                return replace(s, value=new(s.value), index=None if s.index is None else new(s.index))
            case If():
                return replace(s, condition=new(s.condition))
            case Loop():
                return replace(s, until=None if s.until is None else new(s.until))
            case Call(name, args):
                ports = self.functions[name].inputs
                changed = (a if isinstance(p, Variable) else new(a) for a, p in zip(args, ports, strict=True))
                return replace(s, args=tuple(changed))
        return s

    def carried(self, statements: Region) -> tuple[Region, Region, dict[int, int]]:
        """Return the statements with stores of their results, the loads to put behind them, and the new values' ids."""
        b = self.b
        values = [v for s in statements for v in results(s)]
        slots = [b.variable(v.type) for v in values]
        b.push()
        if not (statements and isinstance(statements[-1], EXITS)):
            for slot, value in zip(slots, values, strict=True):
                b.store(slot, value)
        stores = b.pop()
        b.push()
        loads = [b.load(slot) for slot in slots]
        return statements + stores, b.pop(), {v.id: new.id for v, new in zip(values, loads, strict=True)}


def leaves_a_loop(statements: Region) -> bool:
    """Return True if a Break or Continue among them goes to a loop around them."""
    pending = list(statements)
    while pending:
        match pending.pop():
            case Break() | Continue():
                return True
            case If(_, then, orelse):
                pending += (*then, *orelse)
    return False
