"""Finds the variables whose value before a loop a driver must not know, where it gets exits of loops wrong.

Stage: emit, before a loop is printed. Mesa 22.3 counts the iterations of a loop from the first value of a
variable, the step and the constant that an exit compares it with. Where the comparison follows the step, and the first
value leaves by it, Mesa takes 0 iterations, and leaves the loop at once:

    int v = 0;                          int v = 0;
    while (...) {                       v += int(zero);  // a 0 that the driver does not know
        v += 1;                  ->     while (...) {
        if (v < 1) { return; }              v += 1;
    }                                       if (v < 1) { return; }

`if (v >= 1) { continue; } return;` leaves by the opposite of its comparison, and so does an exit in an `else`.
"""

from __future__ import annotations

import operator
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final

from shpy.backend.emit.operations import COMPARISONS
from shpy.backend.emit.plan import is_whole
from shpy.ir.constants import decode
from shpy.ir.nodes import Break, Call, Continue, Discard, Function, If, Let, Loop, Region, Return, Stmt, Store, Variable
from shpy.ir.traverse import changed_variables, has_exit, walk

_STEPPED: Final = frozenset({"load", "add", "sub", "neg", "swizzle", "component", "construct", "splat"})
"""Operations whose results step as their operands do, so that a driver may count by them."""


class Exits:
    """The exits of the loops of one function."""

    def __init__(self, function: Function, callees: Mapping[str, Function]) -> None:
        self.callees = callees
        self.lets = {s.value.id: s for s in walk(function.body) if isinstance(s, Let)}
        self.stores = _by_variable(function.body)
        self.handed = {p.id for p in function.inputs if isinstance(p, Variable)} | self._handed_on(function.body)
        """The variables that come by reference, or are handed on so."""

    def misread(self, loop: Loop) -> list[int]:
        """Return the variables that the loop changes and an exit compares, but for exits that the driver gets right."""
        inside = _by_variable((loop,))
        held = {s.value: v for v, stores in inside.items() for s in stores if is_whole(s)}
        handed = self._handed_on((loop,))
        begins = {v: self._first_values(v, inside.get(v, [])) for v in handed | inside.keys()}
        conditions = list(_conditions(loop))
        found = handed if conditions else set()  # a subroutine may compare what it changes
        for comparison, holds in self._comparisons(conditions, inside):
            if not self._is_right(comparison, holds, begins, held):
                found |= self._read(comparison.args) & begins.keys()
        return sorted(found)

    def _handed_on(self, region: Region) -> set[int]:
        """Return the variables that calls may change."""
        return {v for s in walk(region) if isinstance(s, Call) for v in changed_variables(s, self.callees)}

    def _comparisons(
        self, conditions: list[tuple[int, bool]], inside: dict[int, list[Store]]
    ) -> Iterator[tuple[Let, bool]]:
        """Yield the comparisons that conditions are made of, through variables that the loop stores them in.

        Each comes with its value where the loop is left, and twice where it may have either.
        """
        pending, seen = list(conditions), set[tuple[int, bool]]()
        while pending:
            value, holds = pending.pop()
            let = self.lets.get(value)
            if let is None or (value, holds) in seen:
                continue
            seen.add((value, holds))
            if let.op in COMPARISONS and not any(a in self.lets and self.lets[a].value.type.is_bool for a in let.args):
                yield let, holds
            elif let.op == "load" and isinstance(let.attr, int):
                pending += [(s.value, holds) for s in inside.get(let.attr, [])]
            elif let.op in ("and", "or"):
                pending += [(a, holds) for a in let.args]
            elif let.op == "not":
                pending += [(a, not holds) for a in let.args]
            else:
                pending += [(a, either) for a in let.args for either in (True, False)]

    def _first_values(self, variable: int, inside: list[Store]) -> list[float | None]:
        """Return what the loop's variable may begin with, None for a value that is not a constant."""
        if variable in self.handed:
            return [None]
        ours = {id(s) for s in inside}
        outside = [s for s in self.stores.get(variable, []) if id(s) not in ours]
        return [self._constant(s.value) if is_whole(s) else None for s in outside] or [0]

    def _constant(self, value: int) -> float | None:
        """Return the number that a value is; None if it is no constant of one component."""
        let = self.lets.get(value)
        if let is None or let.op != "const" or let.value.type.size > 1:
            return None
        assert isinstance(let.attr, tuple)
        number: float = decode(let.value.type, let.attr)[0]
        return number

    def _read(self, values: tuple[int, ...], through: Collection[str] | None = None) -> set[int]:
        """Return the variables that values are computed from, by these operations alone if any are given."""
        pending, seen, read = list(values), set[int](), set[int]()
        while pending:
            let = self.lets.get(pending.pop())
            if let is None or let.value.id in seen or not (through is None or let.op in through):
                continue
            seen.add(let.value.id)
            pending += let.args
            if let.op == "load" and isinstance(let.attr, int):
                read.add(let.attr)
        return read

    def _is_right(self, let: Let, holds: bool, begins: dict[int, list[float | None]], held: dict[int, int]) -> bool:
        """Return whether a comparison with a constant leaves the loop for no first value, or is none that counts."""
        compare = getattr(operator, let.op)
        a, b = let.args
        x, y = self._constant(a), self._constant(b)
        if y is not None and (v := self._held(a, held)) is not None:
            return all(n is not None and compare(n, y) != holds for n in begins.get(v, ()))
        if x is not None and (v := self._held(b, held)) is not None:
            return all(n is not None and compare(x, n) != holds for n in begins.get(v, ()))
        return self._read(let.args, _STEPPED).isdisjoint(begins)

    def _held(self, value: int, held: dict[int, int]) -> int | None:
        """Return the variable that the loop stores a value in, or that the value is loaded from; None without one."""
        let = self.lets.get(value)
        if let is not None and let.op == "load" and isinstance(let.attr, int) and not let.args:
            return let.attr
        return held.get(value)


def _by_variable(region: Region) -> dict[int, list[Store]]:
    """Return the stores of a region, by the variable."""
    found: dict[int, list[Store]] = {}
    for s in walk(region):
        if isinstance(s, Store):
            found.setdefault(s.variable, []).append(s)
    return found


def _conditions(loop: Loop) -> Iterator[tuple[int, bool]]:
    """Yield the conditions of a loop's exits with their values there, but for those before which it stores nothing."""
    rest = list(loop.body)
    while rest and (isinstance(rest[0], Let) or (isinstance(rest[0], If) and _leaves((rest[0],)))):
        del rest[0]
    yield from _decisions(rest, leaves_after=False)
    yield from _decisions(loop.continuing, leaves_after=False)
    if loop.until is not None:
        yield loop.until, True


def _decisions(region: Sequence[Stmt], leaves_after: bool) -> Iterator[tuple[int, bool]]:
    """Yield the conditions on which it depends whether a region leaves the loop, with their values where it does.

    With `leaves_after`, something leaves the loop after the region. A `continue` in the region keeps elements from it.
    """
    for s in reversed(region):
        if isinstance(s, If):
            for branch, holds in ((s.then, True), (s.orelse, False)):
                if _leaves(branch):
                    yield s.condition, holds
                if leaves_after and has_exit(branch, Continue):
                    yield s.condition, not holds
                yield from _decisions(branch, leaves_after)
        leaves_after = leaves_after or _leaves((s,))


def _leaves(region: Sequence[Stmt]) -> bool:
    """Return whether a statement of the region leaves the loop around it, the function, or ends the element."""
    return has_exit(region, Break | Return | Discard)
