"""Finds the loops whose live lanes may be compacted, and the stores by which lanes leave them.

Stage: emit. Part of the numpy printer. Takes a vectorised function; gives a plan for each loop that lanes leave one by
one, if all that such a loop changes for the code behind it are *exit copies*: a select under the mask of those that
leave, of a slot that the loop does not read. The other lanes of that slot are out of the loop's sight, so that an exit
copy can be written as a store into some lanes of the whole array, whatever lanes the loop itself still has:

    $n_out = cond(%leaving, $n, $n_out)      ->      put_aside(n_out, lane, leaving, n)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from shpy.ir.nodes import Function, If, Let, Loop, Region, Return, Stmt, Store
from shpy.ir.traverse import regions_of, uses, walk
from shpy.passes.liveness import annotate, loops


@dataclass(frozen=True, slots=True)
class ExitCopy:
    """`slot = cond(mask, new, old)`: the values, of which `mask` may be a splat, and `old` is the slot's load."""

    mask: int
    new: int
    old: int


@dataclass(frozen=True, slots=True)
class CompactionPlan:
    """A loop that may be compacted: the slot of its live mask, and its exit copies by the value that they store."""

    live: int
    copies: dict[int, ExitCopy] = field(default_factory=dict)
    slots: frozenset[int] = frozenset()


def plans(function: Function, live: frozenset[int], varying: frozenset[int]) -> dict[int, CompactionPlan]:
    """Return the plans of a function's loops, by `id` of the loop; `live` are the loops' masks, `varying` slots."""
    plans_by_loop: dict[int, CompactionPlan] = {}
    if not live:
        return plans_by_loop
    used = Counter(v for s in walk(function.body) for v in uses(s))
    for loop, note in loops(function.body, annotate(function)):
        masks = live & note.inner[0] & {s.variable for s in _direct(loop) if isinstance(s, Store)}
        changed = note.stored & note.after & varying
        if len(masks) != 1 or masks & changed or any(isinstance(s, Return) for s in walk((loop,))):
            continue
        copies = _copies(loop, changed, used)
        touched = Counter(slot for s in walk((loop,)) if (slot := _touched(s)) in changed)
        if all(touched[slot] == 2 * sum(c[0] == slot for c in copies.values()) for slot in changed):
            plans_by_loop[id(loop)] = CompactionPlan(next(iter(masks)), {v: c for v, (_, c) in copies.items()}, changed)
    return plans_by_loop


def _direct(loop: Loop) -> Iterator[Stmt]:
    """Return the statements of a loop that are in none of the loops inside."""
    for region in _regions(loop):
        yield from region


def _regions(s: Stmt) -> Iterator[Region]:
    for region in regions_of(s):
        yield region
        for inner in region:
            if isinstance(inner, If):
                yield from _regions(inner)


def _touched(s: Stmt) -> int | None:
    """Return the slot that a statement loads or stores."""
    if isinstance(s, Store):
        return s.variable
    return s.attr if isinstance(s, Let) and s.op == "load" and isinstance(s.attr, int) else None


def _copies(loop: Loop, changed: frozenset[int], used: Counter[int]) -> dict[int, tuple[int, ExitCopy]]:
    """Return the exit copies of a loop to the slots `changed`, with their slots, by the value that they store."""
    loads = {s.value.id: s.attr for s in _direct(loop) if isinstance(s, Let) and s.op == "load" and not s.args}
    copies = {}
    for region in _regions(loop):
        for s, following in pairwise(region):
            match s, following:
                case Let(value, "cond", (mask, new, old)), Store(slot, stored, None, None):
                    once = used[value.id] == 1 and used[old] == 1
                    if stored == value.id and once and slot in changed and loads.get(old) == slot:
                        copies[stored] = slot, ExitCopy(mask, new, old)
    return copies
