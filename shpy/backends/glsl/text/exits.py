"""Finds the variables whose value before a loop a driver must not know, where it gets exits of loops wrong.

Stage: emit, before a loop is printed. Mesa before 23.1 counts the iterations of a loop from the first value of a
variable, the step and the constant that an exit compares it with. Where the comparison follows the step and holds for
the first value, it takes 0 iterations, and leaves the loop at once:

    int v = 0;                          int v = 0;
    while (...) {                       v += int(zero);  // a 0 that the driver does not know
        v += 1;                  ->     while (...) {
        if (v < 1) { return; }              v += 1;
    }                                       if (v < 1) { return; }
"""

from __future__ import annotations

import operator
from collections.abc import Iterator
from typing import Final

from shpy.backends.emit.plan import is_whole
from shpy.ir.constants import decode
from shpy.ir.nodes import Break, Function, If, Let, Loop, Region, Return, Store, Variable
from shpy.ir.traverse import walk

_COMPARISONS: Final = {
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "eq": operator.eq,
    "ne": operator.ne,
}


class Exits:
    """The exits of the loops of one function."""

    def __init__(self, function: Function) -> None:
        self.lets = {s.value.id: s for s in walk(function.body) if isinstance(s, Let)}
        self.stores = [s for s in walk(function.body) if isinstance(s, Store)]
        self.handed = {p.id for p in function.inputs if isinstance(p, Variable)}

    def misread(self, loop: Loop) -> list[int]:
        """Return the variables that the loop changes and an exit compares, but for exits that the driver gets right."""
        inside = [s for s in walk((loop,)) if isinstance(s, Store)]
        changed = {s.variable for s in inside}
        begins = {v: self._first_values(v, inside) for v in changed}
        found: set[int] = set()
        for condition in _conditions(loop):
            if not self._is_right(condition, begins, inside):
                found |= self._read(condition) & changed
        return sorted(found)

    def _first_values(self, variable: int, inside: list[Store]) -> list[float | None]:
        """Return what the loop's variable may begin with, None for a value that is not a constant."""
        if variable in self.handed:
            return [None]
        outside = [s for s in self.stores if s.variable == variable and not any(s is other for other in inside)]
        return [self._constant(s.value) if is_whole(s) else None for s in outside] or [0]

    def _constant(self, value: int) -> float | None:
        """Return the number that a value is; None if it is no constant of one component."""
        let = self.lets.get(value)
        if let is None or let.op != "const" or let.value.type.size > 1:
            return None
        assert isinstance(let.attr, tuple)
        number: float = decode(let.value.type, let.attr)[0]
        return number

    def _read(self, value: int) -> set[int]:
        """Return the variables that a value is computed from."""
        pending, seen, read = [value], set[int](), set[int]()
        while pending:
            let = self.lets.get(pending.pop())
            if let is None or let.value.id in seen:
                continue
            seen.add(let.value.id)
            pending += let.args
            if let.op == "load" and isinstance(let.attr, int):
                read.add(let.attr)
        return read

    def _is_right(self, condition: int, begins: dict[int, list[float | None]], inside: list[Store]) -> bool:
        """Return whether the condition compares a variable with a constant, and holds for no first value."""
        let = self.lets.get(condition)
        if let is None or let.op not in _COMPARISONS:
            return False
        compare = _COMPARISONS[let.op]
        a, b = let.args
        x, y = self._constant(a), self._constant(b)
        if y is not None and (v := self._held(a, inside)) is not None:
            return all(n is not None and not compare(n, y) for n in begins.get(v, ()))
        if x is not None and (v := self._held(b, inside)) is not None:
            return all(n is not None and not compare(x, n) for n in begins.get(v, ()))
        return False

    def _held(self, value: int, inside: list[Store]) -> int | None:
        """Return the variable that the loop stores a value in, or that the value is loaded from; None without one."""
        let = self.lets.get(value)
        if let is not None and let.op == "load" and isinstance(let.attr, int) and not let.args:
            return let.attr
        return next((s.variable for s in inside if s.value == value and is_whole(s)), None)


def _conditions(loop: Loop) -> Iterator[int]:
    """Yield the conditions of a loop's exits, but for those before which it stores nothing."""
    rest = list(loop.body)
    while rest and (isinstance(rest[0], Let) or (isinstance(rest[0], If) and _leaves((rest[0],)))):
        del rest[0]
    pending = [s for s in (*rest, *loop.continuing) if isinstance(s, If)]
    while pending:
        choice = pending.pop()
        if _leaves((choice,)):
            yield choice.condition
            pending += [s for s in (*choice.then, *choice.orelse) if isinstance(s, If)]
    if loop.until is not None:
        yield loop.until


def _leaves(region: Region) -> bool:
    """Return whether a statement of the region leaves the loop around it, or the function."""
    return any(
        isinstance(s, Break | Return) or (isinstance(s, If) and (_leaves(s.then) or _leaves(s.orelse))) for s in region
    )
