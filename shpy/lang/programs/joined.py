"""Programs made of programs: recorded anew by a body that calls them, without the copies that joining leaves.

Stage: record, from recordings to a recording.

    rerecorded("double_then_add", add, types, layout, body, defaults)
    guarded(shade, None, "alive")        # shade with one more input, alive: Attrib1b
    guarded(shade, is_alive, "")         # shade with the inputs of is_alive, evaluated first
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from shpy.ir.nodes import Function, Let, Module, Stmt, Store
from shpy.ir.traverse import rewrite, uses, walk
from shpy.ir.types import Base
from shpy.lang.programs.control import SH_DISCARD
from shpy.lang.programs.inline import call_recorded
from shpy.lang.programs.record import InputType, RecordedProgram, record_body
from shpy.lang.recording.recorder import recording
from shpy.lang.values.structure import Layout, Leaf
from shpy.lang.values.value import CLASSES

MASK = CLASSES["Attrib", 1, Base.B]


def rerecorded(
    name: str,
    like: RecordedProgram,
    types: dict[str, InputType],
    layout: Layout | None,
    body: Callable[[dict[str, Any]], Any],
    defaults: Mapping[str, Any],
) -> RecordedProgram:
    """Record `body`, which calls `like`, at the line of that; keep the defaults of the inputs that are left."""
    with recording(name, like.module.entry.loc) as context:
        recorded = record_body(context, types, layout, body)
    return replace(
        recorded, module=_without_copies(recorded.module), defaults={n: d for n, d in defaults.items() if n in types}
    )


def guarded(recorded: RecordedProgram, condition: RecordedProgram | None, mask: str) -> RecordedProgram:
    """Return `recorded` with the elements discarded first for which the condition does not hold.

    The condition is a program that returns one bool; its inputs are shared by name. Without a condition, the input
    `mask` decides, which is added if it is missing. Who calls it has checked that shared inputs have one type.
    """
    added: Mapping[str, InputType] = {mask: Leaf(MASK)} if condition is None else condition.inputs
    types = {**recorded.inputs, **{name: type_ for name, type_ in added.items() if name not in recorded.inputs}}

    def body(arguments: Mapping[str, Any]) -> Any:
        if condition is None:
            holds = arguments[mask]
        else:
            holds = call_recorded(condition, {name: arguments[name] for name in condition.inputs})
        SH_DISCARD(~holds)
        return call_recorded(recorded, {name: arguments[name] for name in recorded.inputs})

    defaults = {**(condition.defaults if condition is not None else {}), **recorded.defaults}
    return rerecorded(recorded.module.name, recorded, types, recorded.output, body, defaults)


def _without_copies(module: Module) -> Module:
    """Return the module without the slots of its entry that only hand values on.

    A call of a program copies its inputs and its results, so each join of a joined program would copy those of all
    earlier joins again, and the module would grow with the square of their number. A slot that has the name of a user's
    variable stays: traces show it.

        store $x.0 = %x; %2 = load $x.0; store $x.3 = %2      →      store $x.3 = %x
    """
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
            case Let(target, "load", index, int(slot)):
                loads[target.id] = slot
                slots -= {loads.get(value, -1) for value in index}  # the place in an array is a use
            case Store(slot, value, None, None):
                stores[slot] += 1
            case Store(slot, value, _, index):
                slots -= {slot, loads.get(value, -1), loads.get(index if index is not None else -1, -1)}
            case _:
                slots -= {loads.get(value, -1) for value in uses(statement, callees)}
                slots -= set(getattr(statement, "args", ()) if not isinstance(statement, Let) else ())
    return {slot: stored[slot] for slot in slots if slot in stored and stores[slot] == 1}
