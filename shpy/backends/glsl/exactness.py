"""Which conditions must be named, so that they can be `precise`.

Stage: emit, before a function is printed. Mesa turns `!(a < b)` into `a >= b`, which is something else where one is
NaN, and it negates conditions of its own accord (of an `if` with a `return` on both sides, say). It takes `a + b == a`
for `b == 0`, whatever was rounded. What is assigned to a `precise` variable is left as it is, so a condition that
compares floats becomes one, where it is not part of a bool or float that becomes one anyway:

    if (a < b && c) { ... }     ->   precise bool t = a < b && c;
                                     if (t) { ... }
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from shpy.ir.nodes import Function, Let, Store, Variable
from shpy.ir.traverse import defined, uses, walk
from shpy.ir.types import Type

_COMPARISONS: Final = frozenset({"lt", "le", "gt", "ge", "eq", "ne"})


def precise_conditions(function: Function, callees: Mapping[str, Function]) -> set[int]:
    """The bool values that compare floats and are used in anything but a bool or float expression or variable."""
    types = {v.id: v.type for v in defined(function)}
    slots = {s.id: s.type for s in (*function.outputs, *function.variables)}
    slots |= {s.id: s.type for s in function.inputs if isinstance(s, Variable)}
    comparing: set[int] = set()
    kept: set[int] = set()
    for s in walk(function.body):
        if isinstance(s, Let):
            if _compares(s, types, comparing):
                comparing.add(s.value.id)
            if _is_precise(s.value.type) and s.op not in ("call", "any_lane", "all_lanes"):
                continue
            kept.update(s.args)
        elif not isinstance(s, Store) or not _is_precise(slots[s.variable]):
            kept.update(uses(s, callees))
    return comparing & kept


def _compares(let: Let, types: dict[int, Type], comparing: set[int]) -> bool:
    if let.op in _COMPARISONS and types[let.args[0]].is_float:
        return True
    return let.value.type.is_bool and any(a in comparing for a in let.args)


def _is_precise(type: Type) -> bool:
    return type.is_bool or type.is_float
