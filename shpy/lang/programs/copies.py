"""Copies that joining programs leaves: slots that only hand a value on to another slot.

Stage: record, after programs are joined. A call of a program copies its inputs and its results, so each join of a
joined program would copy those of all earlier joins again, and the module would grow with the square of their number. A
slot that has the name of a user's variable stays: traces show it.

    store $x.0 = %x; %2 = load $x.0; store $x.3 = %2      →      store $x.3 = %x
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from shpy.ir.nodes import Function, Let, Module, Stmt, Store
from shpy.ir.traverse import rewrite, uses, walk


def without_copies(module: Module) -> Module:
    """Return the module without the slots of its entry that only hand values on."""
    *others, entry = module.functions
    passed = _passed_on(entry, {f.name: f for f in others})
    if not passed:
        return module
    variables = tuple(v for v in entry.variables if v.id not in passed)
    values: dict[int, int] = {}

    def shorter(statement: Stmt) -> Stmt | None:
        match statement:
            case Let(value, "load", _, int(slot)) if slot in passed:
                stored = passed[slot]
                values[value.id] = values.get(stored, stored)
                return None
            case Store(slot, _) if slot in passed:
                return None
            case Store(_, value) if value in values:
                return replace(statement, value=values[value])
        return statement

    body = rewrite(entry.body, shorter)
    return replace(module, functions=(*others, replace(entry, variables=variables, body=body)))


def _passed_on(entry: Function, callees: dict[str, Function]) -> dict[int, int]:
    """Return the stored value of each slot that is stored once, whole and outside of blocks, and only handed on."""
    slots = {v.id for v in entry.variables if v.length is None and (not v.name or v.loc == entry.loc)}
    stored: dict[int, int] = {}
    for statement in entry.body:
        match statement:
            case Store(slot, value, None, None) if slot in slots:
                stored.setdefault(slot, value)
            case Let(_, "load", _, int(slot)) if slot not in stored:
                slots.discard(slot)  # read before it is stored
    loads: dict[int, int] = {}
    stores: Counter[int] = Counter()
    for statement in walk(entry.body):
        match statement:
            case Let(target, "load", _, int(slot)):
                loads[target.id] = slot
            case Store(slot, value, None, None):
                stores[slot] += 1
            case Store(slot, value, _, index):
                slots -= {slot, loads.get(value, -1), loads.get(index if index is not None else -1, -1)}
            case _:
                slots -= {loads.get(value, -1) for value in uses(statement, callees)}
                slots -= set(getattr(statement, "args", ()) if not isinstance(statement, Let) else ())
    return {slot: stored[slot] for slot in slots if slot in stored and stores[slot] == 1}
