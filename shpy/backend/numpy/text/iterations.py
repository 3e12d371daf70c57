"""Find the counted loops of which several iterations may be computed at once.

Stage: emit. Part of the numpy printer. Where a tile has few lanes, numpy spends most of its time on starting functions.
If a loop leaves nothing behind but sums, its body is computed for many values of the counter at once, in arrays
(iterations, lanes) with a row for each value. The rows are then added in the order of the iterations, so the result has
the same bits:

    while j < 4096:                                  for j in iterations_of(j, 4096, 1, lanes):
        away = bodies.at(j)[0] - x           ->          away = bodies.gather(j)[0] - x
        total = total + away * away                      total = fold(np.add, total, away * away)
        j = j + 1
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace

from shpy.ir.constants import to_array
from shpy.ir.nodes import Break, Function, If, Let, Loop, Region, Stmt, Store, Value
from shpy.ir.traverse import defined, map_regions, uses, walk
from shpy.passes.calls import LaneFacts
from shpy.passes.components import SCALED
from shpy.passes.liveness import annotate, loops

_FOLDS = {"add": "np.add", "mul": "np.multiply"}
_VECTORS = frozenset({"table", "construct", *SCALED})
"""Operations that may give vectors, whose components come first, or take them."""
_NOT_IN_ROWS = frozenset({"neighbour", "lane_any", "lane_min", "lane_max", "load", "component"})
_NOT_IN_FUNCTIONS = frozenset({"neighbour", "lane_any", "any_lane", "component"})


@dataclass(frozen=True, slots=True)
class Sum:
    """`slot = slot op term`, once in each iteration: `fold` is numpy's function, `value` what is stored."""

    slot: int
    term: int
    fold: str
    load: Let
    value: Value


@dataclass(frozen=True, slots=True)
class Iterations:
    """A loop that counts a slot up or down to the value `stop`, by `step`; `first` are constants in front of its test.

    `body` holds the statements of an iteration besides its `sums`; `rows` are the values that depend on the counter.
    """

    counter: int
    stop: int
    step: int
    first: tuple[Let, ...]
    body: tuple[Let, ...]
    sums: tuple[Sum, ...]
    rows: frozenset[int]


def lanes_alone(functions: Iterable[Function]) -> frozenset[str]:
    """Find the pure functions that may be called with rows of iterations: callees come first.

    An array has one element a lane, and any_lane asks the lanes of one iteration.
    """
    names: set[str] = set()
    for f in functions:
        lets = [s for s in walk(f.body) if isinstance(s, Let)]
        plain = not any(s.op in _NOT_IN_FUNCTIONS or (s.op == "call" and s.attr not in names) for s in lets)
        if f.pure and plain and not any(v.length for v in f.variables):
            names.add(f.name)
    return frozenset(names)


def with_counters(function: Function) -> dict[int, tuple[Iterations, Region]]:
    """Find the loops of a function that test a counter and step it, with their statements, by `id` of the loop."""
    every = [s for s in walk(function.body) if isinstance(s, Loop)]
    lets = _lets(function) if every else {}
    return {id(loop): iterations for loop in every if (iterations := _iterations(loop, lets))}


def counted(function: Function, facts: LaneFacts, alone: frozenset[str]) -> dict[int, Iterations]:
    """Find such loops of a function, by `id` of the loop; `alone` are the functions that `lanes_alone` finds."""
    candidates = with_counters(function)
    if not candidates:
        return {}
    lets = _lets(function)
    used = Counter(v for s in walk(function.body) for v in uses(s))
    sizes = {v.id: v.type.size for v in defined(function)}
    summed = {k: _summed(*iterations, facts, lets, used, sizes, alone) for k, iterations in candidates.items()}
    iterations_by_loop = {k: iterations for k, iterations in summed.items() if iterations}
    if not iterations_by_loop:  # most often: liveness takes longer than all before
        return {}
    after = {id(loop): note.after for loop, note in loops(function.body, annotate(function))}
    return {k: iterations for k, iterations in iterations_by_loop.items() if iterations.counter not in after[k]}


def rewritten(function: Function, iterations_by_loop: dict[int, Iterations]) -> tuple[Function, dict[int, Iterations]]:
    """Return the function in which each loop of `iterations_by_loop` adds its terms by a `fold` at an iteration's end.

    Also returns the rewritten loops with their Iterations, by `id`.
    """
    new_iterations: dict[int, Iterations] = {}

    def region(r: Region) -> Region:
        return tuple([statement(s) for s in r])

    def statement(s: Stmt) -> Stmt:
        iterations = iterations_by_loop.get(id(s))
        if not isinstance(s, Loop) or iterations is None:
            return map_regions(s, region)
        at = next(k for k, t in enumerate(s.body) if isinstance(t, If))
        test = s.body[: at + 1]
        sums: list[Stmt] = []
        for total in iterations.sums:
            sums += [total.load, Let(total.value, "fold", (total.load.value.id, total.term), total.fold)]
            sums.append(Store(total.slot, total.value.id, loc=total.value.loc))
        loop = replace(s, body=(*test, *(t for t in iterations.body if t not in test), *sums))
        new_iterations[id(loop)] = iterations
        return loop

    return (
        (replace(function, body=region(function.body)), new_iterations)
        if iterations_by_loop
        else (function, new_iterations)
    )


def _lets(function: Function) -> dict[int, Let]:
    return {s.value.id: s for s in walk(function.body) if isinstance(s, Let)}


def _iterations(loop: Loop, lets: dict[int, Let]) -> tuple[Iterations, Region] | None:
    """Return the loop with its statements if it begins with a test of a counter that it steps at its end."""
    at = next((k for k, s in enumerate(loop.body) if isinstance(s, If)), len(loop.body))
    match loop.body[:at], loop.body[at:], loop.continuing:
        case (
            (*first, Let(tested, "ge" | "le" as test, (now, stop))),
            (If(condition, (Break(),), ()), *body),
            (*steps, Let(stepped, "add", (before, by)), Store(counter, stored, None, None)),
        ) if condition == tested.id and stored == stepped.id and loop.until is None:
            pass
        case _:
            return None
    loads = [s for s in first if isinstance(s, Let) and s.op == "load" and s.attr == counter]
    consts = tuple(s for s in (*first, *steps) if isinstance(s, Let) and s.op == "const")
    step = _constant(lets, by)
    straight = len(loads) + len(consts) == len(first) + len(steps) and all(isinstance(s, (Let, Store)) for s in body)
    one = {now, before} <= {s.value.id for s in loads}
    if not (straight and one and _ends(test, step, loop.turns)):
        return None
    return Iterations(counter, stop, step, consts, (), (), frozenset()), (*loads, *body)


def _constant(lets: dict[int, Let], value: int) -> int:
    let = lets.get(value)
    return int(to_array(let.value.type, let.attr).item()) if let and isinstance(let.attr, tuple) else 0


def _ends(test: str, step: int, most: int | None) -> bool:
    """Return whether the counter reaches its bound without a step past the largest number."""
    return step * (1 if test == "ge" else -1) > 0 and (abs(step) == 1 or most is not None)


def _summed(
    iterations: Iterations,
    region: Region,
    facts: LaneFacts,
    lets: dict[int, Let],
    used: Counter[int],
    sizes: dict[int, int],
    alone: frozenset[str],
) -> Iterations | None:
    """Return the loop with its sums if all else depends on the counter and on values from before the loop."""
    stores = [s for s in region if isinstance(s, Store)]
    sums = [_sum(s, lets, used) for s in stores]
    totals = tuple(total for total in sums if total)
    slots = [total.slot for total in totals]
    if not slots or len(set(slots)) < len(stores) or not facts.slots.issuperset(slots):
        return None
    summing = {v for s, total in zip(stores, totals, strict=True) for v in (s.value, *lets[s.value].args)}
    summing -= {total.term for total in totals}
    body = [s for s in region if isinstance(s, Let) and s.value.id not in summing]
    rows: set[int] = set()
    for s in body:
        if s.op == "load" and s.attr in slots:
            return None
        if s.op == "load" and s.attr == iterations.counter:
            rows.add(s.value.id)
        elif rows.intersection(s.args):
            wide = max(sizes[v] for v in (s.value.id, *s.args)) > 1
            if s.op == "call" and s.attr not in alone:
                return None
            if s.op in _NOT_IN_ROWS or (wide and s.op != "swizzle" and s.op not in _VECTORS):
                return None
            rows.add(s.value.id)
    if not all(total.term in rows for total in totals):
        return None
    return replace(iterations, body=tuple(body), sums=totals, rows=frozenset(rows))


def _sum(s: Store, lets: dict[int, Let], used: Counter[int]) -> Sum | None:
    """Return the sum that a store makes in its slot; None if the store does something else."""
    let = lets.get(s.value)
    if s.components is not None or s.index is not None or let is None or let.op not in _FOLDS or used[s.value] > 1:
        return None
    for load, term in (let.args, let.args[::-1]):
        loaded = lets.get(load)
        if loaded and loaded.op == "load" and loaded.attr == s.variable and used[load] == 1 and not loaded.args:
            stored = replace(let.value, loc=lets[term].value.loc) if term in lets else let.value
            return Sum(s.variable, term, _FOLDS[let.op], loaded, stored)
    return None
