"""Draws statements and blocks: nested loops and branches that end, with every exit.

Stage: test. Loops have counters, or few iterations; programs shrink to few statements, few iterations and plain
numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st

from shpy.ir.types import Base, Type, vec
from shpy.testing.generated.expressions import CORE, OTHERS, Expressions
from shpy.testing.generated.syntax import (
    FIELDS,
    Apply,
    Assign,
    B,
    Block,
    Call,
    Const,
    Declare,
    DeclareMatrix,
    DeclareStruct,
    Do,
    Exit,
    Expr,
    For,
    I,
    If,
    Lanes,
    Multiply,
    Name,
    Splat,
    Stmt,
    StoreAt,
    While,
    Write,
    WriteStruct,
)

MAX_ITERATIONS = 4


class Statements(Expressions):
    """Statements, drawn where they stand."""

    def block(self, least: int = 1, goes_on: bool = False, most: int = 5) -> Block:
        """Statements; their declarations end with them. `goes_on`: something follows, so no exit ends them."""
        names, stored, matrices = dict(self.names), list(self.stored), dict(self.matrices)
        statements: list[Stmt] = []
        for _ in range(self.draw(st.integers(least, most))):
            if self.budget > 0:
                self.budget -= 1
                statements.append(self.statement())
        if self.depth and not goes_on and self.chance(25):
            statements.append(Exit(self.exit_kind()))
        self.names, self.stored, self.matrices = names, stored, matrices
        return tuple(statements)

    def statement(self) -> Stmt:
        """Draw one statement."""
        ways: list[Callable[[], Stmt]] = [self.assign, self.assign, self.declare, self.lanes, self.group, self.store_at]
        ways += [self.write] * len(self.arrays)
        if self.derives:
            ways.append(self.known_number)
        if self.depth < self.deepest:
            ways += [self.branch, self.branch, self.count_loop, self.count_loop, self.while_loop, self.do_loop]
        if self.functions:
            ways.append(self.call)
        if self.depth:
            ways += [self.leave, self.leave, self.leave]
        return self.pick(ways)()  # type: ignore[no-any-return]

    def target(self) -> tuple[str, Type]:
        """Return a variable that may be stored into, and its type."""
        name = self.pick(self.stored)
        return name, self.names[name]

    def assign(self) -> Stmt:
        """Return a store into a variable, or some of its components."""
        name, type = self.target()
        if type.size > 1 and self.chance(40):
            most = 1 if name.endswith("]") else type.size
            picked = tuple(self.draw(st.permutations(range(type.size)))[: self.draw(st.integers(1, most))])
            part = type.sized(len(picked))
            return Assign(
                name, self.assigned_value(part), picked, "add" if not type.is_bool and self.chance(30) else None
            )
        op = self.pick(("add", "mul", "sub")) if not type.is_bool and self.chance(40) else None
        return Assign(name, self.assigned_value(type), None, op)

    def assigned_value(self, type: Type) -> Expr:
        """Draw the value of a store: an expression of this type, or a scalar that is repeated."""
        return Splat(type, self.expr(type.scalar)) if type.size > 1 and self.chance(20) else self.expr(type)

    def declare(self) -> Stmt:
        """Return a new variable of the block."""
        value = self.expr(self.pick(CORE + OTHERS))
        name = self.fresh("t")
        self.names[name] = value.type
        self.stored.append(name)
        return Declare(name, value)

    def group(self) -> Stmt:
        """Return a new matrix or struct of the block, or a product of matrices."""
        if self.chance(30):
            name = self.fresh("s")
            values = tuple(self.expr(type) for type in FIELDS.values())
            self.names |= {f"{name}.{field}": type for field, type in FIELDS.items()}
            self.stored += [f"{name}.{field}" for field in FIELDS]
            return DeclareStruct(name, values)
        if self.matrices and self.chance(50):
            name, size = self.pick(list(self.matrices.items()))
            return Multiply(name, self.there_matrix(vec("f", size)))
        name, size = self.fresh("m"), self.draw(st.integers(2, 4))
        rows = tuple(self.expr(vec("f", size)) for _ in range(size))
        self.matrices[name] = size
        self.names |= {f"{name}[{r}]": vec("f", size) for r in range(size)}
        self.stored += [f"{name}[{r}]" for r in range(size)]
        return DeclareMatrix(name, rows)

    def known_number(self) -> Stmt:
        """Return a number that a compiler knows after two statements: `x[:] = 1`, `x -= 1`."""
        name, type = self.pick([(n, self.names[n]) for n in self.stored if self.names[n].base is Base.F])
        one = Const(type, (1.0,) * type.size)
        return self.together(Assign(name, one), Assign(name, one, None, "sub"))

    def store_at(self) -> Stmt:
        """Return a store into the component of a vector that an index picks at run time."""
        vectors = [(n, self.names[n]) for n in self.stored if self.names[n].size > 1 and not n.endswith("]")]
        if not vectors:
            return self.assign()
        name, type = self.pick(vectors)
        return StoreAt(name, self.index(1), self.expr(type.scalar))

    def write(self) -> Stmt:
        """Return a store into an array."""
        array = self.pick(self.arrays)
        if array.struct:
            return WriteStruct(array.name, self.index(1), tuple(self.expr(type) for type in FIELDS.values()))
        op = "add" if not array.type.is_bool and self.chance(30) else None
        return Write(array.name, self.index(1), self.assigned_value(array.type), op)

    def lanes(self) -> Stmt:
        """Return a store whose condition depends on other lanes."""
        name, type = self.pick([(n, self.names[n]) for n in self.stored if self.names[n].size == 1])
        return Lanes(self.pick(("any_lane", "all_lanes")), self.expr(B), name, self.expr(type))

    def exit_kind(self) -> str:
        """Draw a kind of exit that is allowed here."""
        kinds = [
            "return",
            *["break", "continue"] * bool(self.loops),
            "return",
            *["break", "continue"] * bool(self.loops),
            "discard",
        ]
        kind = str(self.pick(kinds))
        if kind == "continue":
            self.loops[-1] = True
        return kind

    def leave(self) -> Stmt:
        """Return an exit under a condition, now and then one that a driver could derive: `k == 0` after `k += 1`."""
        kind = self.exit_kind()
        if self.counters and self.chance(30):
            compared = Name(I, self.pick(self.counters)), Const(I, (self.draw(st.integers(-1, MAX_ITERATIONS)),))
            return Exit(kind, Apply(B, self.pick(("lt", "le", "gt", "ge", "eq", "ne")), compared))
        return Exit(kind, self.expr(B))

    @contextmanager
    def inside(self) -> Any:
        """Count statements that are drawn meanwhile as one block deeper."""
        self.depth += 1
        yield
        self.depth -= 1

    def branch(self) -> Stmt:
        """Return an If with one or two conditions."""
        branches = []
        for _ in range(1 + (self.chance(30))):
            condition = self.expr(B)
            with self.inside():
                branches.append((condition, self.block()))
        with self.inside():
            orelse = self.block() if self.chance(50) else None
        return If(tuple(branches), orelse)

    def looped(self, first: Block = (), goes_on: bool = False) -> tuple[Block, bool]:
        """Return a loop's body, and whether a continue may skip some of it."""
        self.loops.append(False)
        with self.inside():
            body = first + self.block(goes_on=goes_on)
        return body, self.loops.pop()

    def counted(self, start: Declare, step: Stmt, goes_on: bool = False) -> tuple[Block, bool]:
        """Return the body of a loop with a counter, and whether a continue may skip some of it."""
        outer, self.counters = self.counters, (*self.counters, start.name)
        body = self.looped((step,), goes_on)
        self.counters = outer
        return body

    def counter(self) -> tuple[Declare, Stmt, Expr]:
        """Make the statements that keep a loop finite: a counter, its step, and the test whether it has room."""
        name = self.fresh("k")
        self.names[name] = I
        counter = Name(I, name)
        most = Const(I, (self.draw(st.integers(1, MAX_ITERATIONS)),))
        return (
            Declare(name, Const(I, (0,))),
            Assign(name, Const(I, (1,)), None, "add"),
            Apply(B, "lt", (counter, most)),
        )

    def while_loop(self) -> Stmt:
        """Return a loop that tests first."""
        start, step, room = self.counter()
        condition = Apply(B, "and", (room, self.expr(B))) if not (self.endless and self.chance(50)) else self.expr(B)
        body, _ = self.counted(start, step)
        return self.together(start, While(condition, body))

    def do_loop(self) -> Stmt:
        """Return a loop that tests last."""
        start, step, room = self.counter()
        if self.endless:
            # A break among the first statements would be the loop's test, behind which its iterations are counted.
            step = If(((room, (step,)),))
        body, continues = self.counted(start, step, goes_on=True)
        full = Apply(B, "not", (room,))
        until = Apply(B, "or", (full, self.expr(B))) if not (self.endless and self.chance(50)) else self.expr(B)
        return self.together(start, Do(body, until, late=continues or self.chance(30)))

    def count_loop(self) -> Stmt:
        """Return a counted loop, upwards or downwards."""
        index = self.fresh("i")
        stop: Expr = Const(I, (self.draw(st.integers(0, MAX_ITERATIONS)),))
        if self.chance(40):
            stop = Apply(I, "and", (self.expr(I), Const(I, (3,))))
        bounds: tuple[Expr, ...] = (stop,)
        if self.chance(40):
            first = Const(I, (self.draw(st.integers(-2, 5)),))
            bounds = (first, stop)
            if self.chance(60):
                bounds = (first, stop, Const(I, (self.pick((1, 2, -1, -2, 3)),)))
        names, indices = dict(self.names), self.indices
        self.names[index] = I
        if all(isinstance(b, Const) for b in bounds):
            self.indices = (*indices, index)
        body, _ = self.looped()
        self.names, self.indices = names, indices
        return For(index, bounds, body)

    @staticmethod
    def together(first: Stmt, second: Stmt) -> Stmt:
        """Return a statement of two: in a branch that is always taken names would be hidden."""
        return Sequence((first, second))  # type: ignore[return-value]

    def call(self) -> Stmt:
        """Draw a call of a subroutine, with arguments that fit."""
        function = self.pick(self.functions)
        args: list[Expr] = []
        stores: set[str] = set()
        for param in function.params:
            if param.length is not None:
                array = next(a for a in self.arrays if (a.type, a.length) == (param.type, param.length))
                args.append(Name(param.type, array.name))
            elif param.name in function.stored:
                fitting = [n for n in self.stored if self.names[n] is param.type and n not in stores and n[-1] != "]"]
                if not fitting:
                    return self.assign()
                name = str(self.pick(fitting))
                args.append(Name(param.type, name))
                stores.add(name)
            else:
                args.append(self.const(param.type) if self.chance(20) else self.value_argument(param.type, stores))
        fitting = [n for n in self.stored if function.results and self.names[n] is function.results[0].type]
        result = self.pick(fitting) if fitting and not self.chance(20) else None
        return Call(function.name, tuple(args), result)

    def value_argument(self, type: Type, stores: set[str]) -> Expr:
        """Draw an argument that is only read: an expression, since a variable would be passed by reference."""
        del stores
        value = self.expr(type, 1)
        return (
            value
            if isinstance(value, Apply)
            else Apply(type, "xor" if type.is_bool else "add", (value, self.const(type)))
        )


@dataclass(frozen=True)
class Sequence:
    """Statements that were made as one."""

    statements: Block


def flat(block: Block) -> Block:
    """Return the block with its sequences spliced in."""
    result: list[Stmt] = []
    for s in block:
        match s:
            case Sequence(statements):
                result += flat(statements)
            case If(branches, orelse):
                result.append(If(tuple((c, flat(b)) for c, b in branches), None if orelse is None else flat(orelse)))
            case While(condition, body):
                result.append(While(condition, flat(body)))
            case Do(body, until, late):
                result.append(Do(flat(body), until, late))
            case For(index, bounds, body):
                result.append(For(index, bounds, flat(body)))
            case _:
                result.append(s)
    return tuple(result)
