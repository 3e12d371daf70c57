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

`sizes` are the vectors to be split: a packet of elements keeps vectors of eight whole where all elements share them,
and GLSL lacks these alone. No target has them as ports.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import reduce

from shpy.ir.builder import Builder
from shpy.ir.nodes import Call, Function, If, Let, Loop, Module, Port, Region, Return, Stmt, Store, Value, Variable
from shpy.ir.ops import COMPOSITES, LANE_OPS, OPS
from shpy.ir.traverse import Copy, defined, rewrite, variables_of, walk
from shpy.ir.types import SIZES, WIDEST_PORT

COMPONENTS = "x", "y", "z", "w", "s4", "s5", "s6", "s7"
ALL = SIZES[1:]
"""The sizes of all vectors."""
SHORT = tuple(size for size in ALL if size <= WIDEST_PORT)
LONG = tuple(size for size in ALL if size > WIDEST_PORT)
SCALED = frozenset({"length", "distance", "normalize"})
"""Operations on whole vectors that some targets have."""
_KEPT = frozenset({"param", "table", "table_size", "grid_index", "grid_shape", "call"})
_SCALAR = frozenset({"convert", "half"}) | LANE_OPS
GEOMETRY = frozenset(name for name in COMPOSITES if not OPS[name].componentwise) - SCALED
"""Operations that are not component-wise; an earlier pass lowers them."""


def take_apart(
    module: Module, *, throughout: bool = False, sizes: Collection[int] = ALL, called: Collection[str] = ()
) -> Module:
    """Return the module with every function on scalars; TypeError for an operation that `lower` should have removed.

    Vectors of other sizes than `sizes` stay whole. Functions of `called` become functions that a statement calls.
    """
    *others, entry = module.functions
    whole = frozenset(ALL).difference(sizes)
    expressions, callees = _expressions(others, throughout, whole, called), {f.name: f for f in others}
    functions = [
        _with_scalar_ports(f)
        if f.alone and not throughout and not whole.issuperset(SHORT)
        else _Apart(replace(f, pure=f.name in expressions), expressions, throughout, whole, callees).run()
        for f in others
    ]
    ports = [
        Port(_named(port.name, slot.type.size, k) or port.name, port.kind)
        for port, slot in zip(module.outputs, entry.outputs, strict=False)
        for k in range(1 if slot.type.size in whole else slot.type.size)
    ]
    functions.append(_Apart(entry, expressions, throughout, whole, callees, is_entry=True).run())
    return replace(module, outputs=tuple(ports), functions=tuple(functions))


def has_long(module: Module) -> bool:
    """Return whether a function computes with vectors of eight."""
    functions = module.functions
    types = [*(v.type for f in functions for v in defined(f)), *(v.type for f in functions for v in variables_of(f))]
    return any(type.size in LONG for type in types)


def _expressions(
    functions: Sequence[Function], throughout: bool, whole: Collection[int], called_by_statements: Collection[str]
) -> set[str]:
    """Return the names of the functions that can stay pure: neither they nor their callees return a split vector.

    Unless vectors are split `throughout`, only those of eight are ports that have to be split.
    """
    split = frozenset(ALL if throughout else LONG).difference(whole)
    names: set[str] = set()
    for f in functions:
        called = {s.attr for s in walk(f.body) if isinstance(s, Let) and s.op == "call"}
        ports = f.outputs if throughout else (*f.inputs, *f.outputs)
        stays = f.pure and f.name not in called_by_statements
        if stays and called <= names and split.isdisjoint(port.type.size for port in ports):
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
    Vectors whose size is in `whole` are not split; their components are picked where an operation needs them.
    """

    def __init__(
        self,
        function: Function,
        expressions: set[str],
        throughout: bool,
        whole: Collection[int],
        callees: Mapping[str, Function],
        *,
        is_entry: bool = False,
    ) -> None:
        self.function, self.callees = function, callees
        self.expressions = expressions
        self.throughout = throughout
        self.unsplit = frozenset({1, *whole})
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
            if function.pure and output.type.size not in self.unsplit:
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
        ports = self.function.inputs
        if self.is_entry or (self.function.pure and not self.throughout):
            for port in ports:
                assert isinstance(port, Value)
                self.keep(port)
            return
        self.b.inputs = []
        for port in ports:
            if isinstance(port, Value):
                self.b.inputs += self.values(port)
            else:  # by reference
                self.slots[port.id] = self.split(port)
                self.b.inputs += self.slots[port.id]
        for port in ports:
            if isinstance(port, Value) and port.type.size in self.unsplit:
                self.keep(port)

    def split(self, variable: Variable) -> tuple[Variable, ...]:
        size = variable.type.size
        if size in self.unsplit:
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
            if output.type.size not in self.unsplit:
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
            case _ if self.stays(let):
                if op == "load":
                    assert isinstance(attr, int)
                    attr = self.slots[attr][0].id
                self.b.append(Let(value, op, tuple(self.whole(a) for a in args), attr))
                self.keep(value)
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
                self.call(Call(str(attr), args, (value,), value.loc))
            case "call" if self.throughout:
                self.b.append(Let(value, op, tuple(part for a in args for part in self.parts[a]), attr))
                self.keep(value)
            case _ if op in _KEPT or (op in SCALED and self.throughout):
                self.b.append(Let(value, op, tuple(self.whole(a) for a in args), attr))
                self.keep(value)
            case _:
                self.componentwise(let)
        if value.id not in self.wholes and value.type.size > 1 and value.type.size in self.unsplit:
            self.wholes[value.id] = self.whole(value.id)

    def stays(self, let: Let) -> bool:
        """Return whether an operation works on vectors that are not split, and on no other vectors."""
        types = [let.value.type, *(self.b.type_of(a) for a in let.args)]
        vectors = {t.size for t in types if t.size > 1}
        return bool(vectors) and vectors <= self.unsplit and (let.op != "call" or let.attr in self.expressions)

    def values(self, value: Value) -> list[Value]:
        """Return a new scalar value for each component of a value; the value itself if it is not split."""
        size = value.type.size
        if size in self.unsplit:
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
            case Call():
                self.call(s)
            case _:
                self.b.append(s)

    def call(self, s: Call) -> None:
        args: list[int] = []
        for port, a in zip(self.callees[s.function].inputs, s.args, strict=True):
            if isinstance(port, Variable):
                args += [part.id for part in self.slots[a]]
            else:
                args += [self.whole(a)] if port.type.size in self.unsplit else self.parts[a]
        targets = tuple(part for result in s.results for part in self.values(result))
        self.b.append(Call(s.function, tuple(args), targets, s.loc))
        for result in s.results:
            if result.type.size in self.unsplit:
                self.keep(result)

    def store(self, s: Store) -> None:
        slots = self.slots[s.variable]
        index = None if s.index is None else self.parts[s.index][0]
        if len(slots) == 1:
            self.b.append(Store(slots[0].id, self.whole(s.value), s.components, index, s.loc))
            return
        chosen = range(len(slots)) if s.components is None else s.components
        for k, part in zip(chosen, self.parts[s.value], strict=True):
            self.b.append(Store(slots[k].id, part, None, index, s.loc))
