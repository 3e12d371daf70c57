"""Copy a function's statements in program order; a pass is a subclass that overrides some hooks.

Stage: improve. `alias[old] = new` replaces every later use of a value by another, visible value:

    class DoubleNegation(Rewriter):
        def let(self, let: Let) -> None:
            inner = self.lets.get(let.args[0]) if let.op == "not" else None
            if inner is not None and inner.op == "not":
                self.replace(let.value, inner.args[0])
            else:
                self.emit(let)

Each hook receives its statement with the aliases applied, and emits any number of statements in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from shpy.ir.constants import encode
from shpy.ir.nodes import EXITS, Attr, Call, Function, If, Let, Loc, Loop, Module, Region, Stmt, Store, Value
from shpy.ir.traverse import defined, map_regions
from shpy.ir.types import Type

Functions = Mapping[str, Function]


class Rewriter:
    """Rewrites one function; `functions` are those of its module, by name.

    `lets` maps the id of a value to its emitted Let, and `types` maps it to its type, for all values so far.
    `loc` is the line of the current statement.
    """

    def __init__(self, function: Function, functions: Functions) -> None:
        self.function = function
        self.functions = functions
        self.alias: dict[int, int] = {}
        self.lets: dict[int, Let] = {}
        self.types: dict[int, Type] = {i.id: i.type for i in function.inputs if isinstance(i, Value)}
        self.loc: Loc | None = None
        self._open: list[list[Stmt]] = []
        self._next_value: int | None = None

    def run(self) -> Function:
        """Return the function with its body rewritten."""
        return replace(self.function, body=self.region(self.function.body))

    # Making

    def emit(self, statement: Stmt) -> None:
        """Append a statement to the open region."""
        if isinstance(statement, Let):
            value = statement.value
            self.lets[value.id] = statement
            self.types[value.id] = value.type
        elif isinstance(statement, Call):
            self.types.update({r.id: r.type for r in statement.results})
        self._open[-1].append(statement)

    def replace(self, old: Value, new: int) -> None:
        """Replace every later use of `old` by `new`, which must be visible wherever `old` is."""
        self.alias[old.id] = new

    def value(self, type: Type, name: str | None = None) -> Value:
        """Return a fresh value."""
        if self._next_value is None:
            self._next_value = max((v.id for v in defined(self.function)), default=-1) + 1
        self._next_value += 1
        return Value(self._next_value - 1, type, name, self.loc)

    def make(self, op: str, *args: int, type: Type, attr: Attr = None) -> int:
        """Emit a Let of a fresh value; return its id."""
        value = self.value(type)
        self.let(Let(value, op, args, attr))
        return self.alias.get(value.id, value.id)

    def const(self, type: Type, *components: float | int | bool) -> int:
        """Emit a constant; a single component is repeated for all."""
        size = type.size if len(components) == 1 else 1
        return self.make("const", type=type, attr=encode(type, components * size))

    # The walk

    def region(self, region: Region) -> Region:
        """Return the region, rewritten."""
        self._open.append([])
        self.statements(region)
        return tuple(self._open.pop())

    def statements(self, region: Region) -> None:
        """Rewrite these statements into the region that is being made."""
        for statement in region:
            self.statement(statement)

    def statement(self, statement: Stmt) -> None:
        """Hand a statement to its hook, aliases applied."""
        use = self.alias.get
        if isinstance(statement, Let):  # nearly always, and faster than a pattern
            self.loc = statement.value.loc
            args = statement.args
            if not self.alias.keys().isdisjoint(args):
                statement = Let(statement.value, statement.op, tuple([use(a, a) for a in args]), statement.attr)
            self.let(statement)
            return
        match statement:
            case Store(variable, stored, components, index, loc):
                self.loc = loc
                at = None if index is None else use(index, index)
                new_value = use(stored, stored)
                same = new_value == stored and at == index
                self.store(statement if same else Store(variable, new_value, components, at, loc))
            case If(condition, then, orelse, loc):
                self.loc = loc
                self.branch(If(use(condition, condition), then, orelse, loc))
            case Loop():
                self.loc = statement.loc
                self.loop(statement)
            case Call(name, args, results, loc):
                self.loc = loc
                inputs = self.functions[name].inputs
                mapped = (use(a, a) if isinstance(i, Value) else a for a, i in zip(args, inputs, strict=True))
                self.call(Call(name, tuple(mapped), results, loc))
            case _:
                self.loc = statement.loc
                self.exit(statement)

    # Hooks

    def let(self, let: Let) -> None:
        """Rewrite a Let."""
        self.emit(let)

    def store(self, store: Store) -> None:
        """Rewrite a Store."""
        self.emit(store)

    def call(self, call: Call) -> None:
        """Rewrite a Call statement."""
        self.emit(call)

    def branch(self, branch: If) -> None:
        """Rewrite an If and its regions."""
        self.emit(If(branch.condition, self.region(branch.then), self.region(branch.orelse), branch.loc))

    def loop(self, loop: Loop) -> None:
        """Rewrite a Loop and its regions, one of which may compute the value `until`."""
        body = self.region(loop.body)
        continuing = self.region(loop.continuing)
        until = None if loop.until is None else self.alias.get(loop.until, loop.until)
        self.emit(Loop(body, continuing, until, loop.turns, loop.loc))

    def exit(self, exit: Stmt) -> None:
        """Rewrite a Break, Continue, Return or Discard."""
        self.emit(exit)


def each_function(module: Module, f: Callable[[Function, Functions], Function]) -> Module:
    """Return the module with `f(function, functions by name)` in place of every function, callees first."""
    functions = {g.name: g for g in module.functions}
    for name, function in functions.items():
        functions[name] = f(function, functions)
    return replace(module, functions=tuple(functions.values()))


def map_exits(body: Region, f: Callable[[Stmt], Region]) -> Region:
    """Return the body of a loop, or of a function, with each exit outside of inner loops replaced by what `f` gives."""
    statements: list[Stmt] = []
    for s in body:
        inner = map_regions(s, lambda r: map_exits(r, f)) if isinstance(s, If) else s
        statements += f(s) if isinstance(s, EXITS) else (inner,)
    return tuple(statements)


def falls_through(region: Region) -> bool:
    """Return whether control can reach the region's end."""
    while region:
        last = region[-1]
        if isinstance(last, EXITS):
            return False
        if not isinstance(last, If) or falls_through(last.then):
            return True
        region = last.orelse
    return True
