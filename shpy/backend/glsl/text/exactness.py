"""The conditions and operands that must be named, so that they can be `precise`.

Stage: emit, before a function is printed. Mesa turns `!(a < b)` into `a >= b`, which is something else where one is
NaN, and it negates conditions of its own accord (of an `if` with a `return` on both sides, say). It takes `a + b == a`
for `b == 0`, whatever was rounded. What is assigned to a `precise` variable is left as it is, so a condition that
compares floats becomes one, where it is not part of a bool or float that becomes one anyway:

    if (a < b && c) { ... }     ->   precise bool t = a < b && c;
                                     if (t) { ... }
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

from shpy.backend.emit.operations import COMPARISONS
from shpy.ir.nodes import Call, Function, Let, Store, Variable
from shpy.ir.ops import LANE_OPS
from shpy.ir.traverse import defined, uses, walk
from shpy.ir.types import Type


def precise_conditions(function: Function, callees: Mapping[str, Function]) -> set[int]:
    """Return the bools that compare floats and are used in anything but a bool or float expression or variable."""
    types = {v.id: v.type for v in defined(function)}
    slots = {s.id: s.type for s in (*function.outputs, *function.variables)}
    slots |= {s.id: s.type for s in function.inputs if isinstance(s, Variable)}
    comparing: set[int] = set()
    kept: set[int] = set()
    for s in walk(function.body):
        if isinstance(s, Let):
            if _compares(s, types, comparing):
                comparing.add(s.value.id)
            if _is_precise(s.value.type) and s.op not in {"call", *LANE_OPS}:
                continue
            kept.update(s.args)
        elif not isinstance(s, Store) or not _is_precise(slots[s.variable]):
            kept.update(uses(s, callees))
    return comparing & kept


def choices_and_arguments(function: Function) -> set[int]:
    """Return the conditions of choices and the arguments of calls, for drivers that take choices for maxima."""
    values: set[int] = set()
    for s in walk(function.body):
        if isinstance(s, Call) or (isinstance(s, Let) and s.op == "call"):
            values.update(s.args)
        elif isinstance(s, Let) and s.op == "cond":
            values.add(s.args[0])
    return values


def _compares(let: Let, types: dict[int, Type], comparing: set[int]) -> bool:
    if let.op in COMPARISONS and types[let.args[0]].is_float:
        return True
    # An element that runs alone is asked by its own condition, which has a name already.
    return let.value.type.is_bool and let.op not in LANE_OPS and any(a in comparing for a in let.args)


def _is_precise(type: Type) -> bool:
    return type.is_bool or type.is_float


_ROUNDED: Final = frozenset({"add", "sub", "mul", "div"})
_PART_OF_IT: Final = frozenset(
    {"neg", "abs", "floor", "ceil", "round", "trunc", "sqrt", "any", "all", "and", "or", "xor"}
)
"""Operations that Mesa makes part of the expression that they stand in, as it does operators."""
_PLAIN: Final = COMPARISONS.keys() | _ROUNDED | _PART_OF_IT | {"not", "swizzle", "construct", "splat", "component"}


def precise_operands(
    function: Function, inlined: Collection[int], callees: Mapping[str, Function], least: int, hidden: Collection[str]
) -> set[int]:
    """Return the values that are rounded `least` times or more in an argument of a function, or in a choice.

    Mesa computes these in any order, `(0.9 * x) * x` as `0.9 * (x * x)`, whatever becomes of the result: neither a
    parameter that is `precise` nor the variable that takes `c ? a : b` counts there. Mesa 26 also takes `a - a` for 0
    there, which is rounded once. Mesa 22 does so in a condition, and takes `x - y < x` for `0 < y`: one rounding counts
    there. Operations that are `hidden` are arguments of a function as well.

        f(0.9 * x * x)    ->   precise float t = 0.9 * x * x;
                               f(t)
    """
    roundings: dict[int, int] = {}
    bools = {v.id for v in defined(function) if v.type.is_bool}

    def counts(value: int) -> bool:
        return roundings.get(value, 0) >= (1 if value in bools else least)

    kept: set[int] = set()
    for s in walk(function.body):
        if isinstance(s, Let):
            count = sum(roundings.get(a, 0) for a in s.args if a in inlined and a not in kept)
            if s.op not in _PLAIN or s.op in hidden:
                kept.update(filter(counts, s.args))
                count = 0
            roundings[s.value.id] = count + (s.op in _ROUNDED and s.value.type.is_float)
        elif isinstance(s, Call):
            kept.update(filter(counts, uses(s, callees)))
    return kept
