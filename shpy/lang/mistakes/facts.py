"""The state at one point of a function's text: which assignments each name may come from.

Stage: record. `Flow` (flow.py) walks the statements in order and keeps a `State`; each `Fact` is one assignment that
reaches here. Recording runs the body of a block once, straight through, while the user means it to run sometimes or
many times: what a block leaves behind in a name is therefore marked as *escaped* when the block ends.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import TypeAlias

from shpy.lang.mistakes.kinds import Kind, Known

NO_OBJECT = 0

Place: TypeAlias = str  # a name, or a path as it is written: `self.k`, `d['k']`


@dataclass(eq=False, slots=True)
class Block:
    """A `with SH_…` that is open, or (`control` None) a loop of Python."""

    control: str | None
    written: str
    line: int
    start: int = 0
    exposed: list[Use] = field(default_factory=list)

    @property
    def is_loop(self) -> bool:
        """Return whether the body is meant to run many times."""
        return self.control in (None, "SH_WHILE", "SH_DO", "SH_FOR")


@dataclass(eq=False, slots=True)
class Fact:
    """One assignment of a place: where, when (in the order of the text), of what kind, and to which object."""

    place: Place
    node: ast.AST
    when: int
    known: Known
    object: int
    before: tuple[Fact, ...] = ()
    existed: bool = False  # it had a meaning before, outside all blocks that are closed
    value: ast.expr | None = None
    alias: ast.stmt | None = None
    index: bool = False
    escaped: Block | None = None

    def suspicious(self, *others: Fact) -> bool:
        """Return whether it matters that the block may not run, or runs again: not for strings, lists and the like.

        `others` are further assignments that the place may have had before.
        """
        if self.index or self.known.kind is Kind.VALUE:
            return True
        before = (*self.before, *others)
        if not before and not self.existed:
            return False  # made here first, and not certainly a value: the recorder will know
        return self.known.kind is not Kind.HOST or any(f.known.kind in (Kind.VALUE, Kind.NUMBER) for f in before)


@dataclass(frozen=True, slots=True)
class Use:
    """A place that is read where no assignment inside the loop has reached it: it is older, or the last iteration's."""

    place: Place
    node: ast.AST
    fact: Fact | None
    reads: bool
    asks_none: bool


@dataclass(frozen=True, slots=True)
class Change:
    """A store into an object, through one of its names."""

    place: Place
    node: ast.stmt
    when: int
    fact: Fact


State: TypeAlias = "dict[Place, tuple[Fact, ...]]"  # the assignments that reach a point


def joined(start: State, ends: list[State], when: int) -> State:
    """Return the state where Python's branches, or a loop's exits, join.

    A place that any branch assigned has the assignments of those branches only, as if the others were never taken:
    Python's `if` is decided once, while recording, and correlated conditions must not look like mistakes. Aliases
    that only some branches made are forgotten: choosing a variable that way is legitimate.
    """
    facts = dict(start)
    for place in dict.fromkeys(p for end in ends for p in end):
        new: list[Fact] = []
        for end in ends:
            for fact in end.get(place, ()):
                if fact.when >= when and fact not in new:
                    if fact.alias is not None:
                        fact.alias, fact.object = None, NO_OBJECT
                    new.append(fact)
        if new:
            facts[place] = tuple(new)
    return facts
