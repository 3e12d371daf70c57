"""The state of a loop that reverse mode keeps: the variables that iterations hand on, and those that they only read.

Stage: improve; for `reverse`.
"""

from __future__ import annotations

from dataclasses import dataclass

from shpy.ir.nodes import Function, If, Let, Loop, Region, Store, Variable
from shpy.ir.traverse import results, uses, walk


@dataclass(frozen=True)
class LoopState:
    """The slots of a loop: the count of iterations, the variables that change, and those that only stay, before it."""

    count: Variable
    arrays: dict[int, Variable]
    steady: dict[int, Variable]
    most: int
    over: Variable | None


def is_stored_after(function: Function, loop: Loop, variable: int) -> bool:
    """Return whether a statement that follows the loop stores a variable."""
    inside = {id(s) for s in walk((loop,))}
    behind = False
    for s in walk(function.body):
        behind = behind or s is loop
        if behind and id(s) not in inside and isinstance(s, Store) and s.variable == variable:
            return True
    return False


def free_values(body: Region) -> list[int]:
    """Return the values that statements read from outside."""
    own = {v.id for s in walk(body) for v in results(s)}
    return list(dict.fromkeys(u for s in walk(body) for u in uses(s) if u not in own))


def handed_on(body: Region) -> tuple[set[int], set[int]]:
    """Return the variables that iterations hand on and store, and those that they only read."""
    stored = {s.variable for s in walk(body) if isinstance(s, Store)}
    first: set[int] = set()
    _read_first(body, set(), first)
    return first & stored, first - stored


def _read_first(region: Region, whole: set[int], first: set[int]) -> None:
    """Enter the variables that a region loads before it has stored the whole variable, as those of `whole` are."""
    for s in region:
        match s:
            case Let(op="load", attr=int(variable)) if variable not in whole:
                first.add(variable)
            case Store(variable, _, components, index):
                if components is None and index is None:
                    whole.add(variable)
                elif variable not in whole:
                    first.add(variable)
            case If(_, then, orelse):
                one, other = set(whole), set(whole)
                _read_first(then, one, first)
                _read_first(orelse, other, first)
                whole |= one & other
            case Loop(body, continuing):
                _read_first((*body, *continuing), set(whole), first)
