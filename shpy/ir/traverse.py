"""Traversals of a function's tree of statements, for passes and checks.

Stage: represent. They visit statements in program order, an If or Loop before the statements inside it.

    deepest = [s for s in walk(function.body) if isinstance(s, Loop)]
    without_stores = rewrite(function.body, lambda s: None if isinstance(s, Store) else s)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from types import UnionType

from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Module,
    Region,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.ops import LANE_OPS
from shpy.ir.types import Base, Type

_LEAVES = (Let, Store)
"""The statements without regions that are most frequent."""


def regions_of(statement: Stmt) -> tuple[Region, ...]:
    """Return the regions directly inside a statement: (then, orelse), (body, continuing) or ()."""
    match statement:
        case If(_, then, orelse):
            return then, orelse
        case Loop(body, continuing):
            return body, continuing
    return ()


def walk(region: Region) -> Iterator[Stmt]:
    """Yield every statement in the region and in those nested in it, in program order."""
    pending: list[Iterator[Stmt]] = [iter(region)]
    while pending:
        for statement in pending[-1]:
            yield statement
            if not isinstance(statement, _LEAVES) and (inner := regions_of(statement)):
                pending.append(chain.from_iterable(inner))
                break
        else:
            pending.pop()


def map_regions(statement: Stmt, f: Callable[[Region], Region]) -> Stmt:
    """Return the statement with `f` applied to each region directly inside it; the same object if nothing changed."""
    match statement:
        case If(_, then, orelse):
            new_then, new_orelse = f(then), f(orelse)
            if new_then is not then or new_orelse is not orelse:
                return replace(statement, then=new_then, orelse=new_orelse)
        case Loop(body, continuing):
            new_body, new_continuing = f(body), f(continuing)
            if new_body is not body or new_continuing is not continuing:
                return replace(statement, body=new_body, continuing=new_continuing)
    return statement


def rewrite(region: Region, f: Callable[[Stmt], Stmt | Iterable[Stmt] | None]) -> Region:
    """Replace every statement, innermost first, by the result of `f`: a statement, several, or None to remove it.

    The regions of an If or Loop are rewritten before `f` gets it. Returns the same object if nothing changed.
    """
    statements: list[Stmt] = []
    changed = False
    for statement in region:
        inner = map_regions(statement, lambda r: rewrite(r, f))
        new = f(inner)
        changed = changed or new is not statement
        if new is None:
            continue
        if isinstance(new, Iterable):
            statements.extend(new)
        else:
            statements.append(new)
    return tuple(statements) if changed else region


def results(statement: Stmt) -> tuple[Value, ...]:
    """Return the values that the statement itself assigns."""
    if isinstance(statement, Let):  # nearly always, and faster than a pattern
        return (statement.value,)
    return statement.results if isinstance(statement, Call) else ()


def uses(statement: Stmt, callees: Mapping[str, Function] | None = None) -> tuple[int, ...]:
    """Return the ids of the values that the statement itself reads (a Loop: its `until`).

    The function of a Call determines which arguments are values and which are variables. Without `callees` all count as
    values, as in a module whose functions take values only.
    """
    if isinstance(statement, Let):  # nearly always, and faster than a pattern
        return statement.args
    match statement:
        case Store(_, value, _, index):
            return (value,) if index is None else (value, index)
        case If(condition):
            return (condition,)
        case Loop(_, _, until):
            return () if until is None else (until,)
        case Call(name, args):
            if callees is None:
                return args
            inputs = callees[name].inputs
            return tuple(a for a, port in zip(args, inputs, strict=True) if isinstance(port, Value))
    return ()


def changed_variables(statement: Stmt, callees: Mapping[str, Function]) -> tuple[int, ...]:
    """Return the variables that the statement itself may change: the one that it stores, or those that it hands on."""
    match statement:
        case Store(variable):
            return (variable,)
        case Call(name, args):
            inputs = callees[name].inputs
            return tuple(a for a, port in zip(args, inputs, strict=True) if isinstance(port, Variable))
    return ()


def callee_of(statement: Stmt) -> str | None:
    """Return the function that a statement calls, as an expression or as a statement."""
    if isinstance(statement, Let):
        return str(statement.attr) if statement.op == "call" else None
    return statement.function if isinstance(statement, Call) else None


def calls_of(function: Function) -> Iterator[str]:
    """Yield the names of the functions that a function calls, once for each call in its text."""
    for statement in walk(function.body):
        callee = callee_of(statement)
        if callee is not None:
            yield callee


def defined(function: Function) -> Iterator[Value]:
    """Yield every value of the function: inputs by value first, then the values that statements assign."""
    for port in function.inputs:
        if isinstance(port, Value):
            yield port
    for statement in walk(function.body):
        if isinstance(statement, Let):
            yield statement.value
        elif isinstance(statement, Call):
            yield from statement.results


def variables_of(function: Function) -> Iterator[Variable]:
    """Yield every slot of the function: inputs by reference, outputs, then other variables."""
    for port in function.inputs:
        if isinstance(port, Variable):
            yield port
    yield from function.outputs
    yield from function.variables


def continues(loop: Loop) -> bool:
    """Return whether a Continue in the body goes to this loop (not to one nested in it)."""
    return has_exit(loop.body, Continue)


def has_exit(region: Iterable[Stmt], kinds: type | UnionType) -> bool:
    """Return whether an exit of these kinds stands in a region, outside of the loops in it."""
    pending = list(region)
    while pending:
        s = pending.pop()
        if isinstance(s, kinds):
            return True
        if isinstance(s, If):
            pending += [*s.then, *s.orelse]
    return False


def is_straight(body: Iterable[Stmt]) -> bool:
    """Return whether a body has only Lets and Stores, so that the function can be called as an expression."""
    return all(isinstance(s, Store) or (isinstance(s, Let) and s.op not in LANE_OPS) for s in body)


def test_length(body: Region) -> int:
    """Count the statements at the start of a loop's body that are its test, `while (c)`; 0 without a test.

    An iteration is counted once its test has passed.
    """
    for count, statement in enumerate(body, 1):
        if isinstance(statement, If):
            leaves = len(statement.then) == 1 and isinstance(statement.then[0], Break)
            return count if leaves and not statement.orelse else 0
        if not isinstance(statement, Let | Store):
            return 0
    return 0


def loops(module: Module) -> Iterator[Loop]:
    """Yield every loop: functions in order, statements in program order, an outer loop before those inside it."""
    for function in module.functions:
        for statement in walk(function.body):
            if isinstance(statement, Loop):
                yield statement


def limited_loops(module: Module) -> tuple[Loop, ...]:
    """Return the loops without a known bound, in the order of their statuses (FIRST_LOOP + k is the k-th)."""
    return tuple(loop for loop in loops(module) if loop.turns is None)


def grid_rank(module: Module) -> int | None:
    """Return the number of axes that `grid_index` or `grid_shape` require of a run; None without these operations."""
    lets = (s for f in module.functions for s in walk(f.body) if isinstance(s, Let))
    return next((let.value.type.size for let in lets if let.op in ("grid_index", "grid_shape")), None)


def bases_of(module: Module) -> set[Base]:
    """Return the bases of all values, variables, params and tables of a module."""
    types = [p.type for p in module.params] + [t.type for t in module.tables]
    for function in module.functions:
        types += [v.type for v in defined(function)] + [v.type for v in variables_of(function)]
    return {type.base for type in types}


class Copy:
    """Copies statements; `values` maps ids of values to those of the copies, `slots` does so for variables.

    `fresh` makes values, `functions` are those that the statements call. Names of copies begin with `prefix`.
    """

    def __init__(
        self,
        fresh: Callable[[Type, str | None, Loc | None], Value],
        functions: Mapping[str, Function],
        prefix: str = "",
    ) -> None:
        self.fresh = fresh
        self.functions = functions
        self.prefix = prefix
        self.values: dict[int, int] = {}
        self.slots: dict[int, int] = {}

    def renamed(self, name: str | None) -> str | None:
        """Return the name of a copy; copies of what has no name have none."""
        return name and self.prefix + name

    def region(self, region: Region) -> Region:
        """Return the region's copy."""
        return tuple([self._statement(s) for s in region])

    def _statement(self, s: Stmt) -> Stmt:
        match s:
            case Let(value, op, args, attr):
                copy = self.fresh(value.type, self.renamed(value.name), value.loc)
                new_args = tuple([self.values[a] for a in args])
                self.values[value.id] = copy.id
                return Let(copy, op, new_args, self.slots[attr] if op == "load" and isinstance(attr, int) else attr)
            case Store(variable, value, components, index, loc):
                at = None if index is None else self.values[index]
                return Store(self.slots[variable], self.values[value], components, at, loc)
            case If(condition, then, orelse, loc):
                return If(self.values[condition], self.region(then), self.region(orelse), loc)
            case Loop(body, continuing, until, turns, loc):
                body, continuing = self.region(body), self.region(continuing)
                return Loop(body, continuing, None if until is None else self.values[until], turns, loc)
            case Call():
                return self._call(s)
        return s

    def _call(self, call: Call) -> Call:
        ports = self.functions[call.function].inputs
        args = tuple(
            (self.values if isinstance(port, Value) else self.slots)[a]
            for port, a in zip(ports, call.args, strict=True)
        )
        outputs = tuple(self.fresh(r.type, self.renamed(r.name), r.loc) for r in call.results)
        self.values.update({r.id: new.id for r, new in zip(call.results, outputs, strict=True)})
        return Call(call.function, args, outputs, call.loc)
