"""Remove stores whose value is overwritten or forgotten before anyone reads it.

Stage: improve; part of `promote`. A walk against program order tracks which components of which variables are live:

    store $x = %0           |
    store $x.y = %1         |
    store $x = %2           ->   store $x = %2
    %3 = load $x            |    %3 = load $x
    store $x = %4           |

At the end of the function and at a Return, outputs and inputs by reference are live; at a Discard nothing is live. At a
loop's head, components are live that the loop may read before it stores them, or that are live after the loop.
A set of components is an int with four bits for each variable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
    Discard,
    Function,
    If,
    Let,
    Loop,
    Module,
    Region,
    Return,
    Stmt,
    Store,
    Variable as Slot,
)
from shpy.ir.traverse import variables_of
from shpy.passes.dead import remove_dead
from shpy.passes.rewriter import Functions, each_function


def remove_dead_stores(module: Module) -> Module:
    """Return the module without dead stores; the values that they stored are left to `remove_dead`."""
    return each_function(module, without_dead_stores)


def without_dead_stores(function: Function, functions: Functions) -> Function:
    """Return the function without dead stores; `functions` are those it may call."""
    return _Liveness(function, functions).run()


@dataclass(frozen=True, slots=True)
class _After:
    """The live variables at each target of a jump: after the loop, at its `continuing`, after the function."""

    breaking: int
    continuing: int
    returning: int


class _Liveness:
    def __init__(self, function: Function, functions: Functions) -> None:
        self.function = function
        self.functions = functions
        self._first = {v.id: 4 * i for i, v in enumerate(variables_of(function))}
        self._whole = {
            v.id: ((1 << (v.type.size if v.length is None else 1)) - 1) << self._first[v.id]
            for v in variables_of(function)
        }
        self._read_first: dict[int, int] = {}

    def run(self) -> Function:
        f = self.function
        self._walk(f.body, 0, _After(0, 0, 0), removing=False)
        end = 0
        for slot in (*f.outputs, *f.inputs):
            if isinstance(slot, Slot):
                end |= self._whole[slot.id]
        body, _ = self._walk(f.body, end, _After(0, 0, end), removing=True)
        return replace(f, body=body)

    def _walk(self, region: Region, live: int, after: _After, *, removing: bool) -> tuple[Region, int]:
        """Return the region without dead stores, and the components live before it, given those `live` after it.

        The first walk starts with nothing live and removes nothing: it finds what each loop reads before it stores it.
        """
        kept: list[Stmt] = []
        for s in reversed(region):
            if isinstance(s, Let):  # nearly always, and faster than a pattern
                if s.op == "load" and isinstance(s.attr, int):
                    live |= self._whole[s.attr]
                kept.append(s)
                continue
            new: Stmt | None = s
            match s:
                case Store():
                    dead, live = self._store(s, live)
                    new = None if dead and removing else s
                case If(condition, then, orelse, loc):
                    then, live_then = self._walk(then, live, after, removing=removing)
                    orelse, live_orelse = self._walk(orelse, live, after, removing=removing)
                    live = live_then | live_orelse
                    new = If(condition, then, orelse, loc)
                case Loop():
                    new, live = self._loop(s, live, after, removing)
                case Call(name, args):
                    for argument, port in zip(args, self.functions[name].inputs, strict=True):
                        if isinstance(port, Slot):
                            live |= self._whole[argument]
                case Break():
                    live = after.breaking
                case Continue():
                    live = after.continuing
                case Return():
                    live = after.returning
                case Discard():
                    live = 0
            if new is not None:
                kept.append(new)
        return tuple(reversed(kept)), live

    def _store(self, store: Store, live: int) -> tuple[bool, int]:
        """Return whether the store is dead, and the components that are live before it."""
        whole = self._whole[store.variable]
        if store.index is not None:
            return not live & whole, live
        stored = whole
        if store.components is not None:
            stored = sum(1 << self._first[store.variable] + c for c in store.components)
        return not live & stored, live & ~stored

    def _loop(self, loop: Loop, live: int, after: _After, removing: bool) -> tuple[Loop, int]:
        head = self._read_first.get(id(loop), 0) | live | after.returning if removing else 0
        before_test = head if loop.until is None else head | live
        continuing, at_continuing = self._walk(loop.continuing, before_test, after, removing=removing)
        inside = _After(live, at_continuing, after.returning)
        body, at_head = self._walk(loop.body, at_continuing, inside, removing=removing)
        if not removing:
            self._read_first[id(loop)] = at_head
        return (replace(loop, body=body, continuing=continuing) if removing else loop), at_head


def select_outputs(module: Module, indices: Sequence[int]) -> Module:
    """Return the module with the outputs `indices` of its entry, in this order, without code for the others.

        select_outputs(module, [0, 2])         outputs a, b, c        ->   outputs a, c; what only b needed is gone

    The entry's last output may be the status, which has no port: its index, if given, must be the last.
    """
    entry = module.entry
    outputs = tuple(entry.outputs[i] for i in indices)
    others = tuple(o for i, o in enumerate(entry.outputs) if i not in set(indices))
    ports = tuple(module.outputs[i] for i in indices if i < len(module.outputs))
    fewer = replace(entry, outputs=outputs, variables=(*entry.variables, *others))
    selected = replace(module, outputs=ports, functions=(*module.functions[:-1], fewer))
    return remove_dead(remove_dead_stores(remove_dead(selected)))
