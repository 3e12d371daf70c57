"""Calls of derived functions: an outline's forward or reverse function, added to the recording and called.

Stage: record, and above; for `functions`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

from shpy.errors import RecordError
from shpy.ir.builder import Builder
from shpy.ir.nodes import Call, Function, Let, Module, Stmt, Value as IrValue, Variable
from shpy.ir.traverse import is_straight, rewrite, uses, walk
from shpy.ir.types import Type
from shpy.lang.programs.outline import Outline
from shpy.lang.recording.location import here
from shpy.passes.dead import remove_dead
from shpy.passes.derivatives.forward import ForwardFunctions
from shpy.passes.derivatives.loop_state import LoopLimits
from shpy.passes.derivatives.reverse import Reverse, ReverseFunctions
from shpy.passes.derivatives.structured import prepared
from shpy.passes.pipeline import optimise
from shpy.passes.promote import promote


def forward_functions(outline: Outline, what: str, labels: Sequence[str]) -> tuple[Function, ForwardFunctions]:
    """Return the outline without most of its slots, whose tangents would hide the zeros, and the makers of tangents."""
    module = _module_of(outline, what)
    module = optimise(module, fixed=False)
    simple = {g.name: g for g in module.functions[:-1]}
    find: Callable[[str], Function] = lambda name: simple.get(name) or outline.callees[name]  # noqa: E731
    rules = {g.name: find(g.tangent) for g in outline.callees.values() if g.tangent is not None}
    return module.entry, ForwardFunctions(labels, find, outline.frame.recording.function_name, rules)


def reverse_call(
    outline: Outline,
    what: str | None,
    kept: Sequence[int],
    most: int | None,
    *,
    rounding: bool = False,
    tables: Collection[str] = (),
    first: int | None = None,
) -> tuple[list[int], Reverse]:
    """Call the reverse function for a cotangent of 1.

    Return the outputs `kept`, by position, the bars of the derived inputs, with `rounding` the errors of lines, and a
    place and a bar for each read of the `tables`; and the function. `first` is the number of the first read in loops
    that it gives. Without `what`, the result need not depend on the inputs.
    """
    frame, recording = outline.frame, outline.frame.recording
    limits = LoopLimits(most, forward=not (rounding or tables))
    outline, slots = _by_value(outline)
    module = prepared(_module_of(outline, what), tables, defined=rounding)
    originals = {g.name: g for g in outline.reached}
    names = {
        g.name: g.name if originals.get(g.name) == g else recording.function_name(g.name) for g in module.functions[:-1]
    }
    functions = [replace(_with_callees(g, names), name=names.get(g.name, g.name)) for g in module.functions]
    *callees, entry = functions
    by_name = {g.name: g for g in callees}
    rules = {} if rounding else {g.name: by_name[g.tangent] for g in callees if g.tangent}
    world = ReverseFunctions(by_name.__getitem__, recording.function_name, rules, limits, rounding, frozenset(tables))
    moving = moving_inputs(outline, entry)
    stored = range(len(entry.outputs) - len(slots), len(entry.outputs))
    reverse = world.reversed(entry, moving, (*kept, *stored), unit=True)
    others = [g for g in callees if g.name in originals]
    new = [g for g in callees if g.name not in originals]
    more = () if first is None or len(reverse.function.inputs) == len(outline.arguments) else (first,)
    results = iter(call_derived(outline, others, [*new, *world.callees], reverse.function, more, "reverse"))
    handles = [next(results) for _ in kept]
    for slot in slots:
        frame.store(slot, next(results))
    active = world.activities.in_function(entry, moving).inputs
    for v, moves in zip((v for m in outline.moved for v in m.inputs), active, strict=False):
        handles.append(next(results) if moves else zero(outline, v.type))
    return [*handles, *results], reverse


def call_derived(
    outline: Outline,
    others: Sequence[Function],
    callees: Sequence[Function],
    derived: Function,
    more: Sequence[int],
    suffix: str,
) -> list[int]:
    """Add a derived function and its `callees` to the recording, simplified, and call it; return the results.

    `others` are functions of the recording that these call. `more` are arguments that follow those of the outline.
    """
    recording = outline.frame.recording
    name = recording.function_name(derived_name(outline.name, suffix))
    module = optimise(Module("m", (), (), (), (), (*others, *callees, replace(derived, name=name))), fixed=False)
    *callees, derived = module.functions[len(others) :]
    values = not any(isinstance(p, Variable) for p in derived.inputs)
    derived = replace(derived, pure=is_straight(derived.body) and len(derived.outputs) == 1 and values)
    recording.functions += [*callees, derived]
    return outline.frame.call(derived, (*outline.arguments, *more))


def moving_inputs(outline: Outline, function: Function) -> tuple[bool, ...]:
    """Return which inputs of the function are those that the derivative is taken by."""
    ids = {v.id for m in outline.moved for v in m.inputs}
    return tuple(isinstance(p, IrValue) and p.id in ids for p in function.inputs)


def zero(outline: Outline, type: Type) -> int:
    """Record the constant zero."""
    return outline.frame.const(type, (0,) * type.size)


def derived_name(name: str, suffix: str) -> str:
    """Return the name of a derived function."""
    return f"{name}_{suffix}" if name else suffix


def _by_value(outline: Outline) -> tuple[Outline, list[int]]:
    """Return the outline with the variables around it, but arrays, as values and last outputs; and their ids."""
    b = Builder(function=outline.function)
    b.inputs, arguments, slots = [], [], []
    for port, argument in zip(outline.function.inputs, outline.arguments, strict=True):
        if isinstance(port, IrValue) or port.length is not None:
            b.inputs.append(port)
            arguments.append(argument)
        else:
            b.store(port, b.input(port.type, port.name), loc=port.loc)
            b.outputs.append(port)
            arguments.append(outline.frame.let("load", (), port.type, argument))
            slots.append(argument)
    b.extend(outline.function.body)
    return replace(outline, function=b.finish(), arguments=arguments), slots


def _module_of(outline: Outline, what: str | None) -> Module:
    """Return the outline with its callees; RecordError for an argument that the result does not depend on."""
    module = Module("m", (), (), (), (), (*outline.reached, outline.function))
    if what is None:
        return module
    read = {u for s in walk(remove_dead(promote(module)).entry.body) for u in uses(s)}
    for m in outline.moved:
        if not any(v.id in read for v in m.inputs):
            raise RecordError(
                f"{what} by {m.name}: {outline.spoken} does not depend on {m.name}",
                loc=here(),
                cure=f"use the argument {m.name} in {outline.spoken}, not a value from around it; or wrt= another one",
            )
    return module


def _with_callees(function: Function, names: Mapping[str, str]) -> Function:
    """Return a function whose callees, and the rule of its tangent, have other names."""

    def renamed(s: Stmt) -> Stmt:
        match s:
            case Let(op="call", attr=str(name)):
                return replace(s, attr=names.get(name, name))
            case Call(name):
                return replace(s, function=names.get(name, name))
        return s

    tangent = names.get(function.tangent or "", function.tangent)
    return replace(function, body=rewrite(function.body, renamed), tangent=tangent)
