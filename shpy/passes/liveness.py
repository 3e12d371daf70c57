"""Liveness: the variables that are live, or that a lane may have changed, as notes beside a function's statements.

Stage: improve. Takes a function in which no `Return` stands inside a loop (see `returns.py`); gives a tree of notes
that runs in step with its statements. The statements themselves stay as they are. After a `Discard` only the status,
the last output, is needed.

A variable is live at a point if some path from there loads it before a store of the whole variable. It is dirty at a
point of a loop if some path from the loop's entry to that point stores it. Both describe a single element, whatever
other lanes do, so that `vectorize` can use them for lanes that have left.

    n = n + 1            before {n, z}   after {n, z}     dirty {n, z}  (z: stored an iteration before)
    if n > 9: break      before {n, z}   after {n, z}
    z = n                before {n}      after {n, z}
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import or_

import numpy as np

from shpy.ir.nodes import Break, Continue, Discard, Function, If, Let, Loop, Region, Return, Stmt, Store
from shpy.ir.traverse import regions_of, walk
from shpy.passes.uniformity import LoopFacts

Set = frozenset[int]
Bits = int
"""A set of variables: bit 1 << id for each. Each statement has such sets, so they have to be small."""


def _members(bits: Bits) -> Set:
    if bits.bit_length() <= 64:
        return frozenset(n for n, digit in enumerate(reversed(f"{bits:b}")) if digit == "1")
    octets = np.frombuffer(bits.to_bytes(bits.bit_length() // 8 + 1, "little"), np.uint8)
    return frozenset(np.flatnonzero(np.unpackbits(octets, bitorder="little")).tolist())


@dataclass(slots=True)
class Note:
    """The facts about one statement.

    `live` are the variables live before and after it, `dirt` those dirty before it. `regions` holds the notes of the
    regions directly inside it: then and orelse, or body and continuing. `entries` are the variables live where each of
    these begins, and `stored` those stored anywhere inside. `exits`: the statement may leave an enclosing region.
    `ends`: an If always does. For a loop, `dirt_at_until` are the variables dirty when `until` is tested.
    """

    live: tuple[Bits, Bits]
    dirt: Bits = 0
    regions: tuple[list[Note], ...] = ()
    entries: tuple[Bits, ...] = ()
    stored: Set = frozenset()
    exits: bool = False
    ends: bool = False
    dirt_at_until: Bits = 0
    facts: LoopFacts = field(default_factory=LoopFacts)

    @property
    def before(self) -> Set:
        """The variables live before the statement."""
        return _members(self.live[0])

    @property
    def after(self) -> Set:
        """The variables live after it."""
        return _members(self.live[1])

    @property
    def inner(self) -> tuple[Set, ...]:
        """The variables live at the start of each region inside."""
        return tuple(map(_members, self.entries))

    @property
    def dirty(self) -> Set:
        """The variables dirty before it."""
        return _members(self.dirt)

    @property
    def dirty_at_until(self) -> Set:
        """The variables dirty when `until` is tested."""
        return _members(self.dirt_at_until)


@dataclass(frozen=True, slots=True)
class _Targets:
    """The variables that are live at the targets of Break, Continue, Return and Discard."""

    leave: Bits
    again: Bits
    end: Bits
    discard: Bits


def annotate(function: Function) -> list[Note]:
    """Return the notes of the function's body."""
    end = sum(1 << v.id for v in function.outputs)
    targets = _Targets(end, end, end, sum(1 << v.id for v in function.outputs[-1:]))
    notes = _notes(function.body, end, targets)
    _dirty(function.body, notes, 0, _Leaving())
    return notes


def _before(statement: Stmt, after: Bits, targets: _Targets) -> Bits:
    """Return the variables that are live before the statement."""
    if isinstance(statement, Let):  # nearly always, and faster than a pattern
        if statement.op == "load" and isinstance(statement.attr, int):
            return after | 1 << statement.attr
        return after
    match statement:
        case Store(variable, _, None, None):
            return after & ~(1 << variable)
        case If(_, then, orelse):
            return _live(then, after, targets) | _live(orelse, after, targets)
        case Loop():
            # With X live at the head, liveness is G | (X & P). Its least fixed point is G, its value for empty X.
            return _loop_heads(statement, after, targets, 0)[0]
        case Break():
            return targets.leave
        case Continue():
            return targets.again
        case Return():
            return targets.end
        case Discard():
            return targets.discard
    return after


def _live(region: Region, after: Bits, targets: _Targets) -> Bits:
    for statement in reversed(region):
        after = _before(statement, after, targets)
    return after


def _loop_heads(loop: Loop, after: Bits, targets: _Targets, head: Bits) -> tuple[Bits, Bits]:
    """Return the variables live at the start of an iteration and of `continuing`, given those at the next `head`."""
    test = head if loop.until is None else head | after
    step = _live(loop.continuing, test, targets)
    return _live(loop.body, step, _Targets(after, step, targets.end, targets.discard)), step


def _notes(region: Region, after: Bits, targets: _Targets) -> list[Note]:
    notes = []
    for statement in reversed(region):
        note = _note(statement, after, targets)
        notes.append(note)
        after = note.live[0]
    notes.reverse()
    return notes


def _note(statement: Stmt, after: Bits, targets: _Targets) -> Note:
    if isinstance(statement, Let):
        return Note((_before(statement, after, targets), after))
    match statement:
        case If(_, then, orelse):
            sides = _notes(then, after, targets), _notes(orelse, after, targets)
            entries = _first(sides[0], after), _first(sides[1], after)
            return Note(
                (entries[0] | entries[1], after),
                regions=sides,
                entries=entries,
                stored=_stored(then, sides[0]) | _stored(orelse, sides[1]),
                exits=any(note.exits for side in sides for note in side),
            )
        case Loop(body, continuing, until):
            head = _loop_heads(statement, after, targets, 0)[0]
            step = _loop_heads(statement, after, targets, head)[1]
            inside = _Targets(after, step, targets.end, targets.discard)
            parts = (
                _notes(body, step, inside),
                _notes(continuing, head if until is None else head | after, inside),
            )
            stored = _stored(body, parts[0]) | _stored(continuing, parts[1])
            return Note((head, after), regions=parts, entries=(head, step), stored=stored)
        case Break() | Continue() | Return() | Discard():
            return Note((_before(statement, after, targets), after), exits=True)
    return Note((_before(statement, after, targets), after))


def _stored(region: Region, notes: Sequence[Note]) -> Set:
    """Return the variables that the region stores, at any depth, some of which its statements' notes have."""
    return frozenset([s.variable for s in region if isinstance(s, Store)]).union(*[note.stored for note in notes])


def _first(notes: Sequence[Note], after: Bits) -> Bits:
    return notes[0].live[0] if notes else after


def stored_in(region: Region) -> Set:
    """Return the variables that the region stores, at any depth."""
    return frozenset(s.variable for s in walk(region) if isinstance(s, Store))


def live_before(region: Region) -> Set:
    """Return the variables live before the region if none is after it: those that it may load before it stores them."""
    return _members(_live(region, 0, _Targets(0, 0, 0, 0)))


@dataclass(slots=True)
class _Leaving:
    """The variables that are dirty at the exits and at the Continues of a loop's body."""

    exits: Bits = 0
    continues: Bits = 0


def _dirty(region: Region, notes: list[Note] | None, dirty: Bits, leaving: _Leaving) -> Bits | None:
    """Return the variables dirty at the region's end, None if that is unreachable, and fill in the notes, if any."""
    for at, statement in enumerate(region):
        note = None if notes is None else notes[at]
        if note is not None:
            note.dirt = dirty
        if isinstance(statement, Let):
            continue
        match statement:
            case Store(variable):
                dirty |= 1 << variable
            case If(_, then, orelse):
                sides = note.regions if note is not None else (None, None)
                ends = [_dirty(r, n, dirty, leaving) for r, n in zip((then, orelse), sides, strict=True)]
                reached = [end for end in ends if end is not None]
                if not reached:
                    if note is not None:
                        note.ends = True
                    return None
                dirty = reduce(or_, reached)
            case Loop():
                dirty |= _dirty_loop(statement, note)
            case Break() | Discard():
                leaving.exits |= dirty
                return None
            case Continue():
                leaving.continues |= dirty
                return None
            case Return():
                return None
    return dirty


def _dirty_loop(loop: Loop, note: Note | None) -> Bits:
    """Return the variables that are dirty where the loop is left.

    Along a path a dirty variable stays dirty, so one iteration adds the same variables as all iterations.
    """
    leaving = _Leaving()
    once = _iteration(loop, None, 0, leaving)
    if note is not None:
        note.dirt_at_until = _iteration(loop, note, once, _Leaving())
    return leaving.exits | once


def _iteration(loop: Loop, note: Note | None, dirty: Bits, leaving: _Leaving) -> Bits:
    """Return the variables that are dirty after one iteration that begins with `dirty`."""
    body, continuing = note.regions if note is not None else (None, None)
    end = _dirty(loop.body, body, dirty, leaving)
    at_step = leaving.continues if end is None else leaving.continues | end
    at_until = _dirty(loop.continuing, continuing, at_step, leaving)
    return at_step if at_until is None else at_until


def loops(region: Region, notes: Sequence[Note]) -> Iterator[tuple[Loop, Note]]:
    """Yield the loops of a region and of those inside, from the first on, with their notes."""
    for s, note in zip(region, notes, strict=True):
        if isinstance(s, Loop):
            yield s, note
        for inner, inner_notes in zip(regions_of(s), note.regions, strict=False):
            yield from loops(inner, inner_notes)
