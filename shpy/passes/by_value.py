"""Replace parameters by reference: each becomes an input by value, an output, or both.

Stage: improve, for `vectorize`, where a variable may live in several slots. Arrays stay references, which the entry
alone may have: `inline` comes first and copies the other functions that take arrays to their calls.

    function advance($p, %v)           |    function advance(%p, %v) -> $p
        %1 = load $p                   |        store $p = %p
        %2 = add %1, %v                |        %1 = load $p
        store $p = %2                  |        ...
    ...                            ->  |    ...
    call advance($x, %v)               |    %3 = load $x
                                       |    %4 = call advance(%3, %v)
                                       |    store $x = %4

A parameter that is stored before it is read becomes an output only; one that is never stored becomes an input only. The
new outputs follow the function's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from shpy.ir.builder import Builder
from shpy.ir.nodes import Call, Function, Module, Stmt, Value, Variable
from shpy.ir.traverse import rewrite
from shpy.passes.liveness import annotate, stored_in
from shpy.passes.returns import returns_outside_loops


def takes_array(function: Function) -> bool:
    """Return whether the function takes an array, by reference."""
    return any(isinstance(port, Variable) and port.length is not None for port in function.inputs)


def pass_by_value(module: Module) -> Module:
    """Return the module whose functions take values, and the entry arrays; TypeError for another that takes one."""
    converted: dict[str, _Conversion] = {}
    for function in module.functions:
        if takes_array(function) and function is not module.entry:
            raise TypeError(f"{function.name} takes an array: it comes after inline")
        converted[function.name] = _convert(function, _Caller(function, converted).run())
    return replace(module, functions=tuple(c.after for c in converted.values()))


@dataclass(frozen=True, slots=True)
class _Conversion:
    """A function before and after conversion. `goes_in`: the inputs by reference whose value is now an input."""

    before: Function
    after: Function
    goes_in: frozenset[int] = frozenset()

    @property
    def comes_back(self) -> tuple[int, ...]:
        """The inputs by reference that are now outputs, in the order of the outputs."""
        return tuple(output.id for output in self.after.outputs[len(self.before.outputs) :])


def _convert(before: Function, function: Function) -> _Conversion:
    """Replace the parameters by reference of a function whose own calls pass values already.

    A parameter that is read becomes an input, one that is stored becomes an output.
    """
    references = [port for port in function.inputs if isinstance(port, Variable) and port.length is None]
    if not references:
        return _Conversion(before, function)
    stored = stored_in(function.body)
    function = replace(function, outputs=(*function.outputs, *(v for v in references if v.id in stored)))
    notes = annotate(returns_outside_loops(function))
    read = notes[0].before if notes else frozenset()
    b = Builder(function=function)
    b.inputs = []
    b.variables += [v for v in references if v.id not in stored]
    for port in function.inputs:
        if isinstance(port, Value) or port.length is not None:
            b.inputs.append(port)
        elif port.id in read:
            b.store(port, b.input(port.type, port.name, port.loc), loc=port.loc)
    b.extend(function.body)
    return _Conversion(before, b.finish(), frozenset(v.id for v in references) & read)


class _Caller:
    """Rewrites the calls in one function."""

    def __init__(self, function: Function, converted: Mapping[str, _Conversion]) -> None:
        self.function = function
        self.converted = converted
        self.b = Builder(function=function)

    def run(self) -> Function:
        """Return the function with its calls by value."""
        self.b.extend(rewrite(self.function.body, self._statement))
        return self.b.finish()

    def _statement(self, s: Stmt) -> Stmt | tuple[Stmt, ...]:
        return self._call(s) if isinstance(s, Call) else s

    def _call(self, call: Call) -> tuple[Stmt, ...]:
        b, callee = self.b, self.converted[call.function]
        b.loc = call.loc
        b.push()
        args: list[int] = []
        arguments: dict[int, int] = {}
        for port, argument in zip(callee.before.inputs, call.args, strict=True):
            if isinstance(port, Value):
                args.append(argument)
                continue
            arguments[port.id] = argument
            if port.id in callee.goes_in:
                args.append(b.load(argument).id)
        variables = [b.slot(arguments[port]) for port in callee.comes_back]
        results = tuple(b.value(v.type, v.name) for v in variables)
        b.append(Call(call.function, tuple(args), (*call.results, *results), call.loc))
        for variable, result in zip(variables, results, strict=True):
            b.store(variable, result)
        return b.pop()
