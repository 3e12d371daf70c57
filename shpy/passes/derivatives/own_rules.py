"""The users' rules of tangents: derivatives of a function call its rule and leave its body alone.

Stage: improve; for `forward` and `reverse`. A rule takes the outputs, the inputs, and a tangent of each input of
floats:

    function f_forward(%x, %d_x) -> ($y, $d_y)    |    function f_reverse(%x, %y, %bar_y) -> ($bar_x)
      %1 = call f(%x)                             |      the statements of f_tangent, transposed
      %2 = call f_tangent(%1, %x, %d_x)           |

Reverse mode transposes the statements of the rule that depend on tangents, which it checks to be linear.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NoReturn

from shpy.errors import RecordError
from shpy.ir.builder import Builder
from shpy.ir.constants import decode
from shpy.ir.nodes import Function, Let, Loc, Region, Store, Value
from shpy.ir.traverse import Copy, calls_of, uses, walk
from shpy.passes.derivatives.activity import Moving
from shpy.passes.derivatives.linear import Live, Tangent, TangentBuilder, Zero, dense
from shpy.passes.derivatives.loop_state import LoopLimits
from shpy.passes.derivatives.transposed import Transposition

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


def reverse_by_rule(
    function: Function, rule: Function, moving: Moving, functions: Callable[[str], Function], limits: LoopLimits
) -> Function:
    """Return the reverse function, which takes the outputs of the function after its inputs, and the bars last.

    Raises RecordError for a rule that is not linear in the tangents, or not seen to be so.
    """
    b = TangentBuilder(Function(function.name, function.inputs, (), (), (), loc=function.loc))
    arguments = [port for port in function.inputs if isinstance(port, Value)]
    values = [b.input(v.type, v.name) for v in function.outputs]
    bars = [b.input(v.type, f"bar_{v.name}") for v in function.outputs]
    marks = [b.value(v.type) if v.type.is_float else None for v in arguments]
    copy = Copy(b.value, {name: functions(name) for name in calls_of(rule)})
    inputs = (*values, *arguments, *(mark for mark in marks if mark is not None))
    copy.values.update({port.id: v.id for port, v in zip(rule.inputs, inputs, strict=True)})
    copy.slots.update({v.id: b.variable(v.type, v.length, v.name).id for v in (*rule.outputs, *rule.variables)})
    body = copy.region(rule.body)
    placeholders = {mark.id for mark in marks if mark is not None}
    outputs = [copy.slots[v.id] for v in rule.outputs]
    changes = _linear_results(body, outputs, placeholders, limits)
    results: dict[int, Tangent] = {}
    for value, bar in zip(changes, bars, strict=True):
        if value is None:
            continue
        results[value] = results[value] + Live(b, bar) if value in results else Live(b, bar)
    statements = [s for s in body if not (isinstance(s, Store) and s.variable in outputs)]
    transposition = Transposition(b, placeholders)
    transposition.run(statements, results)
    for port, mark, moves in zip(arguments, marks, moving, strict=True):
        if moves:
            assert mark is not None
            output = b.output(port.type, f"bar_{port.name}")
            b.store(output, dense(transposition.bars.get(mark.id, Zero(b, port.type))).value)
    return b.finish()


def _linear_results(
    body: Region, outputs: Sequence[int], tangents: Collection[int], limits: LoopLimits
) -> list[int | None]:
    """Return the values that a rule stores into its outputs, None for zero.

    Raises RecordError unless they are linear in the tangents.
    """
    linear, zeros = set(tangents), set[int]()
    stored: dict[int, int] = {}

    def fail(loc: Loc | None) -> NoReturn:
        raise RecordError(
            "reverse mode runs this rule of a tangent backwards, and sees no sum of products with tangents here",
            loc=loc,
            cure=limits.cure("+ and - of tangents, * and / with other values, and sh.cond in place of SH_IF"),
        )

    for s in body:
        match s:
            case Let(value, op, args, attr):
                if op == "const" and isinstance(attr, tuple) and not any(decode(value.type, attr)):
                    zeros.add(value.id)
                if any(a in linear for a in args):
                    if not (
                        value.type.is_float and _is_linear(op, [a in linear for a in args], [a in zeros for a in args])
                    ):
                        fail(value.loc)
                    linear.add(value.id)
            case Store(variable, value, None, None) if variable in outputs and value in linear | zeros:
                stored[variable] = value
            case _:
                inside = tuple(walk((s,)))
                if any(u in linear for x in inside for u in uses(x)):
                    fail(s.loc)
                if any(isinstance(x, Store) and x.variable in outputs for x in inside):
                    fail(s.loc)
    return [stored.get(v) for v in outputs]


def _is_linear(op: str, linear: Sequence[bool], zeros: Sequence[bool]) -> bool:
    """Return whether an operation is linear in its operands that are linear in the tangents."""
    if op in _ALL:
        return all(a or b for a, b in zip(linear, zeros, strict=True))
    if op == "cond":
        return not linear[0] and _is_linear("add", linear[1:], zeros[1:])
    return (op in _EACH or (op in _FIRST and linear[0])) and sum(linear) == 1
