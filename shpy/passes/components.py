"""Split vectors into scalars: a value of three components becomes three values, a variable three variables.

Stage: improve, after `lower` and `by_value`, for targets whose registers hold one number for each of many elements.
Takes a module without composite operations, whose functions take values only; gives one that computes with scalars:

    var $z: f2                         var $z_x: f
                                       var $z_y: f
    %1: f2 = load $z             ->    %3: f = load $z_x
                                       %4: f = load $z_y
    %2: f2 = mul %1, %c                %5: f = mul %3, %c_x
    store $z = %2                      ...

A vector from outside (an input, a param, an element of a table, the result of a function) stays a vector, and a swizzle
for each component follows it. An operand that has to be a vector (an index, an argument) is constructed again. Each
output of the module and each port of a function becomes one port per component. A pure function keeps its ports, since
expressions call it. With `throughout` its ports are split too, and a statement calls a function that returns a vector.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

from shpy.ir.builder import Builder
from shpy.ir.nodes import Call, Function, If, Let, Loop, Module, Port, Region, Return, Stmt, Store, Value, Variable
from shpy.ir.ops import COMPOSITES, OPS
from shpy.ir.traverse import Copy, rewrite, walk

COMPONENTS = "xyzw"
SCALED = frozenset({"length", "distance", "normalize"})
"""Operations on whole vectors that some targets have."""
_KEPT = frozenset({"param", "table", "table_size", "grid_index", "grid_shape", "call"})
_SCALAR = frozenset({"convert", "half", "any_lane", "all_lanes"})
GEOMETRY = frozenset(name for name in COMPOSITES if not OPS[name].componentwise) - SCALED
"""Operations that are not component-wise; an earlier pass lowers them."""


def take_apart(module: Module, *, throughout: bool = False) -> Module:
    """Return the module with every function on scalars; TypeError for an operation that `lower` should have removed."""
    *others, entry = module.functions
    expressions = _expressions(others) if throughout else {f.name for f in others if f.pure}
    functions = [
        _with_scalar_ports(f)
        if f.alone and not throughout
        else _Apart(replace(f, pure=f.name in expressions), expressions, throughout).run()
        for f in others
    ]
    ports = [
        Port(_named(port.name, slot.type.size, k) or port.name, port.kind)
        for port, slot in zip(module.outputs, entry.outputs, strict=False)
        for k in range(slot.type.size)
    ]
    functions.append(_Apart(entry, expressions, throughout, is_entry=True).run())
    return replace(module, outputs=tuple(ports), functions=tuple(functions))


def _expressions(functions: Sequence[Function]) -> set[str]:
    """Return the names of the functions that can stay pure: neither they nor their callees return a vector."""
    names: set[str] = set()
    for f in functions:
        called = {s.attr for s in walk(f.body) if isinstance(s, Let) and s.op == "call"}
        if f.pure and f.outputs[0].type.size == 1 and called <= names:
            names.add(f.name)
    return names


def _with_scalar_ports(function: Function) -> Function:
    """Return a function that still computes with vectors, but takes and returns their components."""
    b = Builder(function=function)
    b.inputs, b.outputs = [], []
    constructs: list[Stmt] = []
    stored: list[Stmt] = []
    for port in function.inputs:
        assert isinstance(port, Value)
        parts = [b.value(port.type.scalar, _named(port.name, port.type.size, k)) for k in range(port.type.size)]
        b.inputs += parts if len(parts) > 1 else [port]
        if len(parts) > 1:
            constructs.append(Let(port, "construct", tuple(v.id for v in parts)))
    for output in function.outputs:
        if output.type.size == 1:
            b.outputs.append(output)
            continue
        b.variables.append(output)
        b.push()
        for k in range(output.type.size):
            part = b.output(output.type.scalar, _named(output.name, output.type.size, k))
            b.store(part, b.swizzle(b.load(output), (k,)))
        stored += b.pop()
    b.extend(constructs)
    b.extend(rewrite(function.body, lambda s: (*_fresh(b, stored), s) if isinstance(s, Return) else s))
    b.extend(_fresh(b, stored))
    return b.finish()


def _fresh(b: Builder, statements: Sequence[Stmt]) -> tuple[Stmt, ...]:
    """Return a copy of Lets and Stores with new values."""
    copy = Copy(b.value, {})
    copy.slots = {v.id: v.id for v in (*b.variables, *b.outputs)}
    return copy.region(tuple(statements))


def _named(name: str | None, size: int, component: int) -> str | None:
    return f"{name}_{COMPONENTS[component]}" if name and size > 1 else name


class _Apart:
    """Copies one function. `parts` are the components of each value, `slots` the scalar slots of each variable.

    `expressions` are the functions called in expressions; these take vectors unless vectors are split `throughout`.
    """

    def __init__(self, function: Function, expressions: set[str], throughout: bool, *, is_entry: bool = False) -> None:
        self.function = function
        self.expressions = expressions
        self.throughout = throughout
        self.is_entry = is_entry
        self.b = Builder(function=function)
        self.parts: dict[int, tuple[int, ...]] = {}
        self.wholes: dict[int, int] = {}
        self.slots: dict[int, tuple[Variable, ...]] = {}

    def run(self) -> Function:
        """Return the function on scalars."""
        b, function = self.b, self.function
        b.variables, b.outputs = [], list(function.outputs)
        for variable in function.variables:
            self.slots[variable.id] = self.split(variable)
            b.variables += self.slots[variable.id]
        for output in function.outputs:
            self.slots[output.id] = self.split(output)
            if function.pure and output.type.size > 1:
                b.variables += self.slots[output.id]
        if not function.pure:
            b.outputs = [part for output in function.outputs for part in self.slots[output.id]]
        self.inputs()
        self.statements(function.body)
        if function.pure:
            self.gather_outputs()
        return b.finish()

    def inputs(self) -> None:
        """Keep the inputs of the entry, and of pure functions unless `throughout`, as vectors; split all others."""
        ports = [port for port in self.function.inputs if isinstance(port, Value)]
        if self.is_entry or (self.function.pure and not self.throughout):
            for port in ports:
                self.keep(port)
        else:
            self.b.inputs = [part for port in ports for part in self.values(port)]

    def split(self, variable: Variable) -> tuple[Variable, ...]:
        size = variable.type.size
        if size == 1:
            return (variable,)
        parts = []
        for k in range(size):
            parts.append(
                self.b.variable(variable.type.scalar, variable.length, _named(variable.name, size, k), variable.loc)
            )
            self.b.variables.pop()
        return tuple(parts)

    def gather_outputs(self) -> None:
        """Construct the vector outputs of a pure function from their scalar slots, at its end."""
        for output in self.function.outputs:
            if output.type.size > 1:
                loads = [self.b.load(part) for part in self.slots[output.id]]
                self.b.store(output, self.b.let("construct", *loads, type=output.type))

    # Values

    def keep(self, value: Value) -> None:
        """Keep a value as a vector, and append a swizzle for each component."""
        self.wholes[value.id] = value.id
        size = value.type.size
        if size == 1:
            self.parts[value.id] = (value.id,)
            return
        self.parts[value.id] = tuple(self.b.swizzle(value, (k,), loc=value.loc).id for k in range(size))

    def whole(self, value: int) -> int:
        """Return the id of a value as a vector, constructed from its components if need be."""
        parts = self.parts[value]
        if len(parts) == 1:
            return parts[0]
        if value not in self.wholes:
            type = self.b.type_of(value)
            return self.b.let("construct", *parts, type=type).id
        return self.wholes[value]

    def let(self, let: Let) -> None:
        """Rewrite the operation on scalars."""
        value, op, args, attr = let.value, let.op, let.args, let.attr
        match op:
            case "const":
                self.constant(let)
            case "load":
                self.load(let)
            case "construct":
                self.parts[value.id] = tuple(part for a in args for part in self.parts[a])
            case "splat":
                self.parts[value.id] = self.parts[args[0]] * value.type.size
            case "swizzle":
                assert isinstance(attr, tuple)
                self.parts[value.id] = tuple(self.parts[args[0]][k] for k in attr)
            case "component":
                self.component(let)
            case "any" | "all":
                fold = "or" if op == "any" else "and"
                self.parts[value.id] = (reduce(lambda x, y: self.b.let(fold, x, y).id, self.parts[args[0]]),)
            case "call" if attr not in self.expressions:
                parts = tuple(part for a in args for part in self.parts[a])
                self.b.append(Call(str(attr), parts, tuple(self.values(value)), value.loc))
            case "call" if self.throughout:
                self.b.append(Let(value, op, tuple(part for a in args for part in self.parts[a]), attr))
                self.keep(value)
            case _ if op in _KEPT or (op in SCALED and self.throughout):
                self.b.append(Let(value, op, tuple(self.whole(a) for a in args), attr))
                self.keep(value)
            case _:
                self.componentwise(let)

    def values(self, value: Value) -> list[Value]:
        """Return a new scalar value for each component of a value; the value itself if it is a scalar."""
        size = value.type.size
        if size == 1:
            parts = [value]
        else:
            parts = [self.b.value(value.type.scalar, _named(value.name, size, k), value.loc) for k in range(size)]
        self.parts[value.id] = tuple(v.id for v in parts)
        return parts

    def constant(self, let: Let) -> None:
        assert isinstance(let.attr, tuple)
        for value, component in zip(self.values(let.value), let.attr, strict=True):
            self.b.append(Let(value, "const", (), (component,)))

    def load(self, let: Let) -> None:
        assert isinstance(let.attr, int)
        args = tuple(self.parts[a][0] for a in let.args)
        for value, slot in zip(self.values(let.value), self.slots[let.attr], strict=True):
            self.b.append(Let(value, "load", args, slot.id))

    def component(self, let: Let) -> None:
        """Select a component by its index, clamped to the vector's size, with a chain of `cond`."""
        vector, index = let.args
        *parts, choice = self.parts[vector]
        at, number = self.parts[index][0], self.b.type_of(index)
        for k, part in reversed(list(enumerate(parts))):
            here = self.b.let("eq" if k else "le", at, self.b.const(number, [k]))
            choice = self.b.let("cond", here, part, choice).id
        self.parts[let.value.id] = (choice,)

    def componentwise(self, let: Let) -> None:
        sizes = {len(self.parts[a]) for a in let.args}
        is_componentwise = (let.op in OPS and OPS[let.op].componentwise) or let.op in _SCALAR
        if sizes != {let.value.type.size} or not is_componentwise:
            raise TypeError(f"{let.op} does not work on components: it comes after lower")
        columns = zip(*(self.parts[a] for a in let.args), strict=True)
        for value, args in zip(self.values(let.value), columns, strict=True):
            self.b.append(Let(value, let.op, args, let.attr))

    # Statements

    def statements(self, region: Region) -> None:
        for statement in region:
            self.statement(statement)

    def region(self, region: Region) -> Region:
        self.b.push()
        self.statements(region)
        return self.b.pop()

    def statement(self, s: Stmt) -> None:
        match s:
            case Let():
                self.let(s)
            case Store():
                self.store(s)
            case If(condition, then, orelse, loc):
                self.b.append(If(self.parts[condition][0], self.region(then), self.region(orelse), loc))
            case Loop(body, continuing, until, turns, loc):
                body, continuing = self.region(body), self.region(continuing)
                until = None if until is None else self.parts[until][0]
                self.b.append(Loop(body, continuing, until, turns, loc))
            case Call(name, args, results, loc):
                parts = tuple(part for a in args for part in self.parts[a])
                targets = tuple(part for result in results for part in self.values(result))
                self.b.append(Call(name, parts, targets, loc))
            case _:
                self.b.append(s)

    def store(self, s: Store) -> None:
        slots = self.slots[s.variable]
        chosen = range(len(slots)) if s.components is None else s.components
        index = None if s.index is None else self.parts[s.index][0]
        for k, part in zip(chosen, self.parts[s.value], strict=True):
            self.b.append(Store(slots[k].id, part, None, index, s.loc))
