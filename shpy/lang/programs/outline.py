"""Outline: the statements that a call of a Python function records, cut out as a function of their own.

Stage: record, for derivatives. What the function reads of the function around it becomes an argument:

    sh.gradient(lambda q: sh.length(q - c) - r)(p)     ->     function (%q, %c, %r) -> ($result), called with p, c, r
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from shpy.errors import RecordError, ShpyTypeError
from shpy.ir.nodes import Break, Call, Continue, Function, Let, Region, Return, Store, Value as IrValue, Variable
from shpy.ir.traverse import callee_of, has_exit, is_straight, results, uses, walk
from shpy.ir.types import Base
from shpy.lang.functions.subroutine import input_value
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import Frame, OpenRegion, need_frame, stores_in
from shpy.lang.values import arithmetic
from shpy.lang.values.structure import Layout, flatten, is_value, layout_from, leaves
from shpy.lang.values.value import CLASSES

Place = int | str
"""An argument by position or by keyword."""

UNNAMED = ""
"""The name of a function without one."""


@dataclass
class DerivedArgument:
    """An argument that a derivative is taken by: its name, its layout, and its leaves as inputs of the outline."""

    name: str
    layout: Layout
    inputs: list[IrValue]


@dataclass
class Outline:
    """A call of a Python function, as a function of the IR; its first inputs are those of `moved`.

    `arguments` are those of a call of it, `layout` is the layout of the result, `callees` are the functions that it may
    call.
    """

    frame: Frame
    name: str
    function: Function
    arguments: list[int]
    moved: list[DerivedArgument]
    layout: Layout
    callees: dict[str, Function]

    @property
    def spoken(self) -> str:
        """The function as messages call it."""
        return "the function" if self.name == UNNAMED else self.name

    @property
    def reached(self) -> list[Function]:
        """The functions that the outline calls, with the rules of their tangents, callees first."""
        order: dict[str, Function] = {}

        def reach(function: Function) -> None:
            for callee in filter(None, (function.tangent, *map(callee_of, walk(function.body)))):
                if callee not in order:
                    reach(self.callees[callee])
                    order[callee] = self.callees[callee]

        reach(self.function)
        return list(order.values())


def outlined(
    what: str, f: Callable[..., Any], args: Sequence[Any], named: Mapping[str, Any], places: Sequence[Place]
) -> Outline:
    """Call f on symbolic arguments in place of those at `places`, and cut the statements out of the recording.

    What f reads of the enclosing function comes in by value; what it stores there, and arrays, come in by reference.
    Raises RecordError where f leaves a block around it, ShpyTypeError for an argument without a derivative.
    """
    frame = need_frame(what)
    values = [_floats(what, _name_of(f, p), args[p] if isinstance(p, int) else named[p]) for p in places]
    moved = [
        DerivedArgument(_name_of(f, p), layout_from(x, "an argument"), []) for p, x in zip(places, values, strict=True)
    ]
    passed = [leaf._read(frame) for m, x in zip(moved, values, strict=True) for leaf in flatten(m.layout, x, m.name)]
    first_slot = len(frame.variables)
    region = OpenRegion(what, here(), frame.scope)
    frame.scopes.append(region)
    try:
        symbolic: dict[Any, Any] = {**dict(enumerate(args)), **named}
        for place, m in zip(places, moved, strict=True):
            symbolic[place], m.inputs = input_value(frame, m.layout, m.name, here())
        result = f(*(symbolic[k] for k in range(len(args))), **{k: symbolic[k] for k in named})
        layout = layout_from(result, what)
        outputs = []
        for entry, (leaf, _, cls) in zip(flatten(layout, result, what), leaves(layout, ""), strict=True):
            handle = arithmetic.convert(frame, entry, cls.type, what)
            slot = frame.variable(cls.type, name=leaf or "result", loc=here())
            frame.store(slot, handle)
            outputs.append(frame.named(frame.variables[slot]))
        if frame.scope is not region:
            raise RecordError(f"the {frame.scope.what} in the function of {what} is still open at its end", loc=here())
    finally:
        del frame.scopes[frame.scopes.index(region) :]
        region.closed = True
    body = tuple(region.statements)
    if has_exit(body, Break | Continue) or any(isinstance(s, Return) for s in walk(body)):
        raise RecordError(
            f"the function of {what} leaves a loop or a function that is around it",
            loc=here(),
            cure="@sh.subroutine above a function that returns early",
        )
    unique = f"the function of {what}"  # no function of the recording has spaces in its name
    function, arguments = _cut(frame, body, moved, passed, outputs, first_slot, unique)
    callees = {g.name: g for g in frame.recording.functions}
    return Outline(frame, called(f), function, arguments, moved, layout, callees)


def called(f: Any) -> str:
    """Return the name of a function, UNNAMED for a lambda."""
    name = str(getattr(f, "name", None) or getattr(f, "__name__", UNNAMED))
    return name if name.isidentifier() else UNNAMED


def parameters(f: Any) -> list[str]:
    """Return the names of a function's parameters or a program's inputs; none where there is no signature."""
    inputs = getattr(f, "inputs", None)
    if isinstance(inputs, Mapping):
        return list(inputs)
    try:
        return list(inspect.signature(getattr(f, "function", f)).parameters)
    except (TypeError, ValueError):
        return []


def _name_of(f: Any, place: Place) -> str:
    names = parameters(f)
    return place if isinstance(place, str) else names[place] if place < len(names) else "x"


def _floats(what: str, name: str, x: Any) -> Any:
    """Return an argument as a value of floats."""
    if not is_value(x):
        x = CLASSES["Attrib", arithmetic.operand(x, what).size, Base.F](x)
    wrong = next((cls for _, _, cls in leaves(layout_from(x, name), name) if not cls.type.is_float), None)
    if wrong is not None:
        raise ShpyTypeError(
            f"{what} by {name}: an {wrong.__name__} has no derivative, it moves in steps",
            loc=here(),
            cure=f"sh.Attrib{wrong.size}f({name}) as the argument, or wrt= another one",
        )
    return x


def _cut(
    frame: Frame,
    body: Region,
    moved: Sequence[DerivedArgument],
    passed: list[int],
    outputs: list[Variable],
    first_slot: int,
    name: str,
) -> tuple[Function, list[int]]:
    """Return the statements as a function, and the arguments of a call of it."""
    callees = {g.name: g for g in frame.recording.functions}
    inputs: list[IrValue | Variable] = [v for m in moved for v in m.inputs]
    arguments = list(passed)
    own = {v.id for s in walk(body) for v in results(s)} | {v.id for v in inputs}
    outer = {v.id: v for region in frame.scopes for s in walk(tuple(region.statements)) for v in results(s)}
    for value in dict.fromkeys(u for s in walk(body) for u in uses(s, callees) if u not in own):
        inputs.append(outer[value])
        arguments.append(value)
    stored = stores_in(body)
    touched: dict[int, None] = dict.fromkeys(v.id for v in outputs)
    for s in walk(body):
        match s:
            case Store(slot) | Let(op="load", attr=int(slot)):
                touched[slot] = None
            case Call():
                stored |= frame.recording.referenced(s)
                touched.update(dict.fromkeys(frame.recording.referenced(s)))
    local: list[Variable] = []
    copies: list[Store] = []
    for slot in list(touched)[len(outputs) :]:
        variable = frame.named(frame.variables[slot])
        if slot >= first_slot:
            local.append(variable)
        elif variable.length is not None or slot in stored:
            inputs.append(variable)
            arguments.append(slot)
        else:
            incoming = frame.new_value(variable.type, variable.name, variable.loc)
            inputs.append(incoming)
            arguments.append(frame.let("load", (), variable.type, slot))
            local.append(variable)
            copies.append(Store(slot, incoming.id, None, None, variable.loc))
    whole = (*copies, *body)
    pure = is_straight(whole) and len(outputs) == 1 and not any(isinstance(i, Variable) for i in inputs)
    return Function(name, tuple(inputs), tuple(outputs), tuple(local), whole, pure, here()), arguments
