"""Which variables are still needed where, and which a lane may have changed: notes beside a function's statements.

Stage: improve. Takes a function in which no `Return` stands inside a loop (see `returns.py`); gives a tree of notes
that runs in step with its statements. The statements themselves stay as they are. After a `Discard` only the status,
the last output, is needed.

A variable is live at a point if some way from there loads it before it is stored as a whole. It is dirty at a point
of a loop if some way from the loop's entry to that point stores it. Both are about one element on its own, whatever
runs beside it: that is why `vectorize` can ask them about lanes that have left.

    n = n + 1            before {n, z}   after {n, z}     dirty {n, z}  (z was stored in the turn before)
    if n > 9: break      before {n, z}   after {n, z}
    z = n                before {n}      after {n, z}
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from shpy.ir.nodes import Break, Continue, Discard, Function, If, Let, Loop, Region, Return, Stmt, Store
from shpy.ir.traverse import regions_of, walk
from shpy.passes.uniformity import LoopFacts

__all__ = ["Note", "annotate", "loops", "stored_in"]

Set = frozenset[int]
_NONE: Set = frozenset()


@dataclass(slots=True)
class Note:
    """What is known about one statement.

    `regions` holds the notes of the regions directly inside it: then and orelse, or body and continuing; `inner` the
    variables live where each of them begins. `stored` are the variables that it stores anywhere inside, `exits`
    whether it leaves a region around it, `ends` whether an If always does. For a loop, `dirty_at_until` is what is
    dirty when `until` is tested.
    """

    before: Set
    after: Set
    dirty: Set = _NONE
    regions: tuple[list[Note], ...] = ()
    inner: tuple[Set, ...] = ()
    stored: Set = _NONE
    exits: bool = False
    ends: bool = False
    dirty_at_until: Set = _NONE
    facts: LoopFacts = field(default_factory=LoopFacts)


@dataclass(frozen=True, slots=True)
class _Targets:
    """What is live where exits lead to."""

    leave: Set
    turn: Set
    end: Set
    discard: Set


def annotate(function: Function) -> list[Note]:
    """The notes of the function's body."""
    end = frozenset(v.id for v in function.outputs)
    targets = _Targets(end, end, end, frozenset(v.id for v in function.outputs[-1:]))
    notes = _notes(function.body, end, targets, frozenset(v.id for v in function.variables if v.length is not None))
    _dirty(function.body, notes, _NONE, _Leaving())
    return notes


def _before(statement: Stmt, after: Set, targets: _Targets) -> Set:
    """What is live before the statement."""
    match statement:
        case Let(_, "load", _, int(variable)):
            return after | {variable}
        case Store(variable, _, None, None):
            return after - {variable}
        case If(_, then, orelse):
            return _live(then, after, targets) | _live(orelse, after, targets)
        case Loop():
            # Liveness is G | (X & P) in what is live at the head X: its least fixed point is its value at nothing.
            return _loop_heads(statement, after, targets, _NONE)[0]
        case Break():
            return targets.leave
        case Continue():
            return targets.turn
        case Return():
            return targets.end
        case Discard():
            return targets.discard
    return after


def _live(region: Region, after: Set, targets: _Targets) -> Set:
    for statement in reversed(region):
        after = _before(statement, after, targets)
    return after


def _loop_heads(loop: Loop, after: Set, targets: _Targets, head: Set) -> tuple[Set, Set]:
    """What is live where a turn begins and where `continuing` begins, if `head` is where the next turn begins."""
    test = head if loop.until is None else head | after
    step = _live(loop.continuing, test, targets)
    return _live(loop.body, step, _Targets(after, step, targets.end, targets.discard)), step


def _notes(region: Region, after: Set, targets: _Targets, arrays: Set) -> list[Note]:
    made = []
    for statement in reversed(region):
        note = _note(statement, after, targets, arrays)
        made.append(note)
        after = note.before
    made.reverse()
    return made


def _note(statement: Stmt, after: Set, targets: _Targets, arrays: Set) -> Note:
    before = _before(statement, after, targets)
    match statement:
        case If(_, then, orelse):
            sides = _notes(then, after, targets, arrays), _notes(orelse, after, targets, arrays)
            return Note(
                before,
                after,
                regions=sides,
                inner=(_first(sides[0], after), _first(sides[1], after)),
                stored=stored_in(then) | stored_in(orelse),
                exits=any(note.exits for side in sides for note in side),
            )
        case Loop(body, continuing, until):
            head = _loop_heads(statement, after, targets, _NONE)[0]
            step = _loop_heads(statement, after, targets, head)[1]
            inside = _Targets(after, step, targets.end, targets.discard)
            parts = (
                _notes(body, step, inside, arrays),
                _notes(continuing, head if until is None else head | after, inside, arrays),
            )
            return Note(
                before, after, regions=parts, inner=(head, step), stored=stored_in(body) | stored_in(continuing)
            )
        case Break() | Continue() | Return() | Discard():
            return Note(before, after, exits=True)
    return Note(before, after)


def _first(notes: Sequence[Note], after: Set) -> Set:
    return notes[0].before if notes else after


def stored_in(region: Region) -> Set:
    """The variables that the region stores, at any depth."""
    return frozenset(s.variable for s in walk(region) if isinstance(s, Store))


@dataclass(slots=True)
class _Leaving:
    """What is dirty along the ways out of a loop's body."""

    exits: Set = _NONE
    turns: Set = _NONE


def _dirty(region: Region, notes: list[Note] | None, dirty: Set, leaving: _Leaving) -> Set | None:
    """What is dirty at the region's end, None if that is never reached; fills in the notes if they are given."""
    for at, statement in enumerate(region):
        note = None if notes is None else notes[at]
        if note is not None:
            note.dirty = dirty
        match statement:
            case Store(variable):
                dirty = dirty | {variable}
            case If(_, then, orelse):
                sides = note.regions if note is not None else (None, None)
                ends = [_dirty(r, n, dirty, leaving) for r, n in zip((then, orelse), sides, strict=True)]
                reached = [end for end in ends if end is not None]
                if not reached:
                    if note is not None:
                        note.ends = True
                    return None
                dirty = frozenset().union(*reached)
            case Loop():
                dirty = dirty | _dirty_loop(statement, note)
            case Break() | Discard():
                leaving.exits |= dirty
                return None
            case Continue():
                leaving.turns |= dirty
                return None
            case Return():
                return None
    return dirty


def _dirty_loop(loop: Loop, note: Note | None) -> Set:
    """What is dirty where the loop is left.

    What is dirty only ever grows along a way, so what one turn adds is what all turns add.
    """
    leaving = _Leaving()
    one_turn = _turn(loop, None, _NONE, leaving)
    if note is not None:
        note.dirty_at_until = _turn(loop, note, one_turn, _Leaving())
    return leaving.exits | one_turn


def _turn(loop: Loop, note: Note | None, dirty: Set, leaving: _Leaving) -> Set:
    """What is dirty after one turn that begins with `dirty`."""
    body, continuing = note.regions if note is not None else (None, None)
    end = _dirty(loop.body, body, dirty, leaving)
    at_step = leaving.turns if end is None else leaving.turns | end
    at_until = _dirty(loop.continuing, continuing, at_step, leaving)
    return at_step if at_until is None else at_until


def loops(region: Region, notes: Sequence[Note]) -> Iterator[tuple[Loop, Note]]:
    """The loops of a region and of those inside, from the first on, with their notes."""
    for s, note in zip(region, notes, strict=True):
        if isinstance(s, Loop):
            yield s, note
        for inner, inner_notes in zip(regions_of(s), note.regions, strict=False):
            yield from loops(inner, inner_notes)
