"""The users' rules of tangents: derivatives of a function call its rule and leave its body alone.

Stage: improve; for `forward` and `reverse`. A rule takes the outputs, the inputs, and a tangent of each input of
floats:

    function f_forward(%x, %d_x) -> ($y, $d_y)    |    function f_reverse(%x, %y, %bar_y) -> ($bar_x)
      %1 = call f(%x)                             |      %1 = call f_tangent_reverse(%y, %x, 0, %bar_y)
      %2 = call f_tangent(%1, %x, %d_x)           |

The derivative of the rule by its tangents is the same at all tangents, since it is linear in them, which is checked.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NoReturn

from shpy.errors import RecordError
from shpy.ir.builder import Builder
from shpy.ir.constants import decode
from shpy.ir.nodes import Call, Function, Let, Loc, Store, Value
from shpy.ir.traverse import walk
from shpy.passes.derivatives.activity import Activities, Moving
from shpy.passes.derivatives.loop_state import LoopLimits

_FIRST = frozenset({"div", "component", "ldexp", "splat", "swizzle", "convert", "neg"})
"""The operations that are linear in the first operand."""
_EACH = frozenset({"mul", "dot", "cross"})
"""The operations that are linear in each of two operands by itself."""
_ALL = frozenset({"add", "sub", "construct"})
"""The operations that are linear in all operands together."""


def forward_by_rule(
    function: Function, rule: Function, moving: Moving, names: Callable[[str | None], Sequence[str | None]]
) -> Function:
    """Return the forward function; `names` returns those of the tangents of a value, one for each direction."""
    b = Builder(function.name, loc=function.loc)
    arguments = [b.input(p.type, p.name) for p in function.inputs]
    tangents: list[list[Value]] = []
    for port, moves in zip(function.inputs, moving, strict=True):
        if moves:
            tangents.append([b.input(port.type, name) for name in names(port.name)])
        elif port.type.is_float:
            tangents.append([b.const(port.type, [0] * port.type.size)] * len(names(None)))
    values = b.call(function, *arguments)
    changes = [b.call(rule, *values, *arguments, *direction) for direction in zip(*tangents, strict=True)]
    outputs = [b.output(v.type, v.name) for v in function.outputs]
    results = list(values)
    for v, parts in zip(function.outputs, zip(*changes, strict=True), strict=True):
        outputs += [b.output(v.type, name) for name in names(v.name)]
        results += parts
    for output, result in zip(outputs, results, strict=True):
        b.store(output, result)
    return b.finish()


def reverse_by_rule(function: Function, moving: Moving, reverse: Function, moves: Moving) -> Function:
    """Return the reverse function, which takes the outputs of the function after its inputs, and the bars last.

    It calls `reverse`, the reverse function of the rule by the tangents of the inputs that are `moving`, which takes
    the bars of the outputs that `moves` names.
    """
    b = Builder(function.name, loc=function.loc)
    arguments = [b.input(p.type, p.name) for p in function.inputs]
    values = [b.input(v.type, v.name) for v in function.outputs]
    bars = [b.input(v.type, f"bar_{v.name}") for v in function.outputs]
    tangents = [b.const(v.type, [0] * v.type.size) for v in arguments if v.type.is_float]  # any numbers would do
    results = b.call(reverse, *values, *arguments, *tangents, *(bar for bar, m in zip(bars, moves, strict=True) if m))
    ports = [port for port, m in zip(function.inputs, moving, strict=True) if m]
    for port, result in zip(ports, results, strict=True):
        b.store(b.output(port.type, f"bar_{port.name}"), result)
    return b.finish()


def check_linear(
    function: Function, moving: Moving, activities: Activities, limits: LoopLimits, outputs: Collection[int]
) -> None:
    """Raise RecordError unless all values that move are linear in the inputs that are `moving`.

    A variable that holds such a value somewhere has to do so everywhere, and so do `outputs` in any case.
    """
    activity = activities.of(function.name, moving)

    def fail(loc: Loc | None) -> NoReturn:
        raise RecordError(
            "reverse mode runs this rule of a tangent backwards, and sees no sum of products with tangents here",
            loc=loc,
            cure=limits.cure("+ and - of tangents, * and / with other values, conditions without tangents"),
        )

    zeros = set[int]()
    variables = {*activity.variables, *outputs}
    for s in walk(function.body):
        match s:
            case Let(op="call") | Call():
                args = tuple(a in activity.values for a in s.args)
                if any(args):
                    name = str(s.attr) if isinstance(s, Let) else s.function
                    check_linear(activities.functions(name), args, activities, limits, ())
            case Let(value, op, args, attr):
                if op == "const" and isinstance(attr, tuple) and not any(decode(value.type, attr)):
                    zeros.add(value.id)
                linear = [a in activity.values for a in args]
                sums = value.type.is_float and _is_linear(op, linear, [a in zeros for a in args])
                if any(linear) and not sums:
                    fail(value.loc)
            case Store(variable, value) if variable in variables and value not in activity.values | zeros:
                fail(s.loc)


def _is_linear(op: str, linear: Sequence[bool], zeros: Sequence[bool]) -> bool:
    """Return whether an operation is linear in its operands that are linear in the tangents."""
    if op in _ALL:
        return all(a or b for a, b in zip(linear, zeros, strict=True))
    if op == "cond":
        return not linear[0] and _is_linear("add", linear[1:], zeros[1:])
    return (op in _EACH or (op in _FIRST and linear[0])) and sum(linear) == 1
