"""The state of a loop that reverse mode keeps: the variables that iterations hand on, and those that they only read.

Stage: improve; for `reverse`.
"""

from __future__ import annotations

from dataclasses import dataclass

from shpy.errors import RecordError
from shpy.ir.builder import Builder
from shpy.ir.nodes import MAX_ARRAY, Function, If, Let, Loop, Region, Store, Variable
from shpy.ir.traverse import results, uses, walk
from shpy.ir.types import Base, vec


@dataclass(frozen=True)
class LoopState:
    """The slots of a loop: the count of iterations, the variables that change, and those that only stay, before it."""

    count: Variable
    arrays: dict[int, Variable]
    steady: dict[int, Variable]
    most: int
    over: Variable | None


def make_loop_state(b: Builder, function: Function, loop: Loop, most: int | None) -> LoopState:
    """Return new slots for a loop of a function; `most` is the number of iterations where it has no known bound.

    Raises RecordError for a loop without a bound or with too large a one, and for an array that it changes.
    """
    most = loop.turns if loop.turns is not None else most
    if most is None:
        raise RecordError(
            "reverse mode keeps the state of each iteration, and this loop has no known bound",
            loc=loop.loc,
            cure="SH_FOR with numbers of Python and SH_BREAK(c) in it; or most=64, where elements that take more "
            'iterations give NaN; or mode="forward"',
        )
    if most > MAX_ARRAY:
        raise RecordError(
            f"reverse mode keeps the states of {most:,} iterations, and an array has at most {MAX_ARRAY:,}",
            loc=loop.loc,
            cure='mode="forward", or fewer iterations',
        )
    changing, steady = _handed_on((*loop.body, *loop.continuing))
    slots = {v.id: v for v in (*function.variables, *function.outputs)}
    for v in sorted(changing | steady):
        changes = v in changing or (slots[v].length is not None and _is_stored_after(function, loop, v))
        if slots[v].length is not None and changes:
            raise RecordError(
                f"reverse mode: the array {slots[v].name or v} changes in a loop, or after one that reads it",
                loc=loop.loc,
                cure='mode="forward", or values in place of the array',
            )
    arrays = {v: b.variable(slots[v].type, most, f"{slots[v].name or 'state'}_kept") for v in sorted(changing)}
    single = [v for v in sorted(steady) if slots[v].length is None]
    before = {v: b.variable(slots[v].type, None, f"{slots[v].name or 'state'}_before") for v in single}
    over = b.variable(vec(Base.B), None, "over") if loop.turns is None else None
    return LoopState(b.variable(vec(Base.I), None, "turns"), arrays, before, most, over)


def _is_stored_after(function: Function, loop: Loop, variable: int) -> bool:
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


def _handed_on(body: Region) -> tuple[set[int], set[int]]:
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
