"""Record: run the user's function once on symbolic arguments; its operations become a module.

Stage: record, its end. Takes a function whose inputs are annotated, gives a `RecordedProgram`: the module, the layouts
of inputs and outputs, and the params and tables that it uses by closure.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import CodeType
from typing import Any

from shpy.errors import RecordError, ShpyError, ShpyTypeError, hide_frames
from shpy.ieee import in_ieee_arithmetic
from shpy.ir import nodes
from shpy.ir.collector import uncollected
from shpy.ir.constants import encode
from shpy.ir.metadata import NOTHING
from shpy.ir.nodes import Loc, Module, Port
from shpy.ir.traverse import walk
from shpy.ir.verifier import verify
from shpy.lang.data.defaults import check_default
from shpy.lang.data.params import Param
from shpy.lang.data.tables import Table, TableType, argument
from shpy.lang.data.textures import TextureArgument, TextureType
from shpy.lang.functions.returns import Returns
from shpy.lang.functions.subroutine import input_value
from shpy.lang.recording.location import at, here, loc_in
from shpy.lang.recording.recorder import Frame, Recording, recording
from shpy.lang.recording.signature import bodies_of, fixed_by_partials, hints_of, loc_of, plain_function, return_loc
from shpy.lang.values.dependent import first_value
from shpy.lang.values.structure import Layout, layout_of, leaves, outside

InputType = Layout | TableType | TextureType


@dataclass(frozen=True, eq=False)
class RecordedProgram:
    """A module with the data that the host needs to run it; `defaults` are the values of inputs that a call omits."""

    module: Module
    inputs: dict[str, InputType]
    output: Layout
    params: dict[str, Any] = field(default_factory=dict)
    tables: dict[str, Any] = field(default_factory=dict)
    defaults: dict[str, Any] = field(default_factory=dict)

    @property
    def discards(self) -> bool:
        """True if SH_DISCARD stands in the program or in a function that it calls."""
        return any(isinstance(s, nodes.Discard) for function in self.module.functions for s in walk(function.body))


def input_type(annotation: Any, name: str) -> InputType:
    """Return the type that an input's annotation names."""
    if isinstance(annotation, TableType | TextureType):
        return annotation
    return outside(layout_of(annotation, name), name)


RESERVED = ("out", "shape", "where")


def record(function: Callable[..., Any], name: str | None = None) -> RecordedProgram:
    """Record `function`; raises RecordError or ShpyTypeError at the user's line."""
    loc = loc_of(function)
    _check_kind(plain_function(function))
    types, defaults = _input_types(function, loc)
    title: str = name or str(getattr(plain_function(function), "__name__", "program"))
    with uncollected(), recording("program" if title == "<lambda>" else title, loc) as context:
        hint = hints_of(function).get("return")
        layout = None if _is_open(hint) else layout_of(hint, "what it gives back")
        body = lambda arguments: _called(function, arguments)  # noqa: E731
        recorded = record_body(context, types, layout, body, return_loc(function), bodies_of(function))
        return replace(recorded, defaults=defaults)


def _check_kind(function: Any) -> None:
    """Raise RecordError for a coroutine or a generator: a call of it returns before its body runs."""
    code = getattr(function, "__code__", None)
    if code is None:
        return
    if code.co_flags & (inspect.CO_COROUTINE | inspect.CO_ASYNC_GENERATOR):
        kind, cure = "coroutine", f"def {code.co_name}"
    elif code.co_flags & inspect.CO_GENERATOR:
        kind, cure = "generator", "return a, b"
    else:
        return
    text = f"{code.co_name} is a {kind}, and its body does not run when it is called"
    raise RecordError(text, loc=loc_in(code, code.co_firstlineno), cure=cure)


def _is_open(annotation: Any) -> bool:
    """Return whether an annotation leaves the type of a result open, as a dict does, which does not list its names."""
    open_types = (None, type(None), Any, dict, list, tuple)
    return annotation in open_types or typing.get_origin(annotation) in (dict, list)


def _input_types(function: Callable[..., Any], loc: Loc | None) -> tuple[dict[str, InputType], dict[str, Any]]:
    """Return the type of each input, and the defaults.

    A default without a type of the language, and what a partial fixes, is metaprogramming: known while recording.
    """
    hints = hints_of(function)
    fixed = fixed_by_partials(function)
    types: dict[str, InputType] = {}
    defaults: dict[str, Any] = {}
    for name, parameter in _signature(function).parameters.items():
        optional = parameter.default is not parameter.empty
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            raise RecordError(f"{parameter} takes any number of inputs", loc=loc, cure="name them one by one")
        if name in RESERVED:
            raise RecordError(f"{name} is a reserved name for an input", loc=loc, cure=f"{name}_")
        if optional and (name in fixed or not _is_type(hints.get(name), name)):
            continue
        if name not in hints:
            in_a_lambda = getattr(function, "__name__", "") == "<lambda>"  # a lambda cannot have annotations
            cure = f"def f({name}: sh.Attrib1f): …" if in_a_lambda else f"{name}: sh.Attrib1f"
            raise RecordError(f"the input {name} is not annotated", loc=loc, cure=cure)
        types[name] = _at(loc, input_type, hints[name], name)
        if optional:
            defaults[name] = _at(loc, check_default, types[name], parameter.default, name)
    return types, defaults


def _signature(function: Any) -> inspect.Signature:
    try:
        return inspect.signature(function)
    except (TypeError, ValueError):  # not callable, or a function of C without a signature
        cure = "@sh.program above a def whose inputs are annotated"
        raise ShpyTypeError(f"sh.program takes a function, not {function!r}", loc=here(), cure=cure) from None


def _is_type(annotation: Any, name: str) -> bool:
    """Return whether an annotation makes an input."""
    try:
        input_type(annotation, name)
    except ShpyTypeError:
        return False
    return True


def _at(loc: Loc | None, f: Callable[..., Any], *args: Any) -> Any:
    """Call f; give an error without a line the line of the function, `loc`."""
    try:
        return f(*args)
    except ShpyTypeError as error:
        raise ShpyTypeError(error.message, loc=loc, cure=error.cure) from None


_EXPLAINED = (TypeError, ValueError, AttributeError, NameError, RecursionError)


def _called(function: Callable[..., Any], arguments: dict[str, Any]) -> Any:
    positional = [
        arguments[name]
        for name, p in inspect.signature(function).parameters.items()
        if p.kind is p.POSITIONAL_ONLY and name in arguments
    ]
    named = {
        name: arguments[name]
        for name, p in inspect.signature(function).parameters.items()
        if p.kind is not p.POSITIONAL_ONLY and name in arguments
    }
    return call_explained(function, positional, named)


def call_explained(function: Callable[..., Any], args: Sequence[Any], named: Mapping[str, Any]) -> Any:
    """Call a function; raise shpy's own error for one of Python or numpy about values of the language."""
    try:
        return function(*args, **named)
    except Exception as error:
        hide_frames()
        if isinstance(error, ShpyError) or not isinstance(error, _EXPLAINED):
            raise
        from shpy.lang.programs.python_errors import explain_python_error  # here: few programs need it

        explained = explain_python_error(error, str(getattr(plain_function(function), "__name__", "")))
        if explained is None:
            raise
        raise explained from error


@in_ieee_arithmetic
def record_body(
    context: Recording,
    types: dict[str, InputType],
    layout: Layout | None,
    body: Callable[[dict[str, Any]], Any],
    end: Loc | None = None,
    bodies: frozenset[CodeType] = frozenset(),
) -> RecordedProgram:
    """Record `body` with fresh inputs of these types: the common part of `record`, `<<` and `&`.

    `end` is the line of the last return, `bodies` the code of the user's function.
    """
    frame = context.frame
    frame.returned = returns = Returns(frame, layout, context.name, bodies)
    inputs, ports, arguments = _open_inputs(frame, types)
    result = body(arguments)
    with at(end or frame.loc):
        returns.finish(result)
    if returns.layout is None or not returns.slots:
        raise RecordError(
            f"{context.name} gives nothing back", loc=frame.loc, cure="return a value, or SH_RETURN(value)"
        )
    outside(returns.layout, "what it gives back")
    functions = context.with_names((*context.functions, frame.finish(tuple(inputs), tuple(returns.slots))))
    module = Module(
        context.name,
        tuple(ports),
        tuple(Port(name, kind) for name, kind in returns.ports),
        tuple(_declare_param(name, p) for name, p in context.params.items()),
        tuple(_declare_table(name, t) for name, t in context.tables.items()),
        functions,
    )
    verify(module)
    return RecordedProgram(module, dict(types), returns.layout, dict(context.params), dict(context.tables))


def _open_inputs(frame: Frame, types: dict[str, InputType]) -> tuple[list[nodes.Value], list[Port], dict[str, Any]]:
    inputs: list[nodes.Value] = []
    ports: list[Port] = []
    arguments: dict[str, Any] = {}
    for name, type_ in types.items():
        if isinstance(type_, TableType):
            arguments[name] = argument(name, type_)
            continue
        if isinstance(type_, TextureType):
            arguments[name] = TextureArgument(name, type_)
            continue
        arguments[name], new = input_value(frame, type_, name, frame.loc)
        inputs += new
        ports += [Port(leaf, kind) for leaf, kind, _ in leaves(type_, name)]
    return inputs, ports, arguments


def _declare_param(name: str, param: Any) -> nodes.Param:
    about = param._about if isinstance(param, Param) else NOTHING  # a dependent uniform has none
    return nodes.Param(name, type(param).__name__, param.type, encode(param.type, first_value(param)), about)


def _declare_table(name: str, table: Table) -> nodes.Table:
    return nodes.Table(name, table.type.type, table.rank, table.source.shape)
