"""A hypothesis strategy of well-typed programs that end: nested loops and branches with every exit, reads and calls.

Only operations with one exact answer are used, so that every target must give the same bits. Programs shrink to few
statements, few turns and plain numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from hypothesis import strategies as st
from property.syntax import (
    F2,
    F3,
    I2,
    Apply,
    Assign,
    B,
    Block,
    Call,
    Component,
    Const,
    Construct,
    Convert,
    Declare,
    Do,
    Exit,
    Expr,
    F,
    For,
    Function,
    I,
    If,
    Lanes,
    Name,
    Program,
    Read,
    Splat,
    Stmt,
    Swizzle,
    Type,
    U,
    Variable,
    While,
    Write,
)

from shpy.ir.constants import DTYPES
from shpy.ir.types import Base, vec

NUMBERS: dict[Base, tuple[float, ...]] = {
    Base.F: (0, 1, 2, -1, 0.5, -0.0, -2.5, 0.1, 3, 1e-3, 1e10, -1e30, float("inf"), float("nan")),
    Base.I: (0, 1, 2, -1, 3, -7, 31, 33, 1000, -(2**31), 2**31 - 1),
    Base.U: (0, 1, 2, 3, 31, 32, 65535, 2**31, 2**32 - 1),
    Base.B: (0, 1),
}
TYPES = (F, I, F3, U, B, F2, I2)
FLOAT_UNARY = ("neg", "abs", "floor", "sqrt", "sign", "ceil", "round", "trunc", "fract")
FLOAT_BINARY = ("add", "sub", "mul", "div", "min", "max", "floormod", "step", "floordiv")
FLOAT_TERNARY = ("clamp", "mix", "mad", "smoothstep", "fma")
INT_UNARY = ("neg", "not", "abs", "popcount", "sign")
INT_BINARY = ("add", "sub", "mul", "and", "or", "xor", "floordiv", "floormod", "min", "max", "shl", "shr")
VECTOR = ("dot", "distance")
COMPARE = ("lt", "eq", "ge", "ne", "gt", "le")
MAX_TURNS = 4


@dataclass
class Writer:
    """What is known where a statement stands: `names` are in sight, `stored` may be stored into."""

    draw: Callable[[Any], Any]
    names: dict[str, Type] = field(default_factory=dict)
    stored: list[str] = field(default_factory=list)
    arrays: list[Variable] = field(default_factory=list)
    functions: list[Function] = field(default_factory=list)
    count: int = 0
    depth: int = 0
    loops: list[bool] = field(default_factory=list)
    budget: int = 30
    endless: bool = False

    def pick(self, options: Any) -> Any:
        return self.draw(st.sampled_from(options))

    def chance(self, percent: int) -> bool:
        """Fails in the simplest example."""
        return bool(self.draw(st.integers(0, 99)) >= 100 - percent)

    def fresh(self, prefix: str) -> str:
        self.count += 1
        return f"{prefix}{self.count}"

    # Expressions

    def const(self, type: Type) -> Const:
        return Const(type, tuple(self.pick(NUMBERS[type.base]) for _ in range(type.size)))

    def leaf(self, type: Type) -> Expr:
        there = [name for name, t in self.names.items() if t is type]
        if there and not self.chance(15):
            return Name(type, self.pick(there))
        return self.const(type)

    def expr(self, type: Type, depth: int = 2) -> Expr:
        if depth == 0 or self.chance(35):
            return self.leaf(type)
        if type.is_float:
            return self.pick((self.arithmetic, self.arithmetic, self.moved))(type, depth - 1)  # type: ignore[no-any-return]
        if type.is_int:
            return self.pick((self.whole, self.whole, self.moved))(type, depth - 1)  # type: ignore[no-any-return]
        return self.truth(type, depth - 1)

    def operand(self, type: Type, depth: int, beside_vector: bool) -> Expr:
        if beside_vector and type.size > 1 and self.chance(30):
            return Splat(type, self.expr(type.scalar, depth))
        return self.expr(type, depth)

    def row(self, type: Type, op: str, count: int, depth: int) -> Apply:
        """An op whose operands are all of the result's type."""
        spread = count == 2 and op != "step"
        return Apply(type, op, tuple(self.operand(type, depth, spread and n > 0) for n in range(count)))

    def arithmetic(self, type: Type, depth: int) -> Expr:
        kind = self.draw(st.integers(0, 9))
        if kind < 5:
            return self.row(type, self.pick(FLOAT_BINARY), 2, depth)
        if kind < 7:
            return self.row(type, self.pick(FLOAT_UNARY), 1, depth)
        if kind == 7:
            return self.row(type, self.pick(FLOAT_TERNARY), 3, depth)
        if kind == 8 and type.size == 1:
            vector = self.pick((F3, F2))
            return Apply(type, self.pick(VECTOR), (self.expr(vector, depth), self.expr(vector, depth)))
        return self.choice(type, depth)

    def choice(self, type: Type, depth: int) -> Expr:
        mask = self.expr(B, depth)
        condition = mask if type.size == 1 else Splat(vec("b", type.size), mask)
        return Apply(type, "cond", (condition, self.expr(type, depth), self.expr(type, depth)))

    def whole(self, type: Type, depth: int) -> Expr:
        kind = self.draw(st.integers(0, 9))
        if kind < 6:
            return self.row(type, self.pick(INT_BINARY), 2, depth)
        if kind < 8:
            return self.row(type, self.pick(INT_UNARY), 1, depth)
        return self.choice(type, depth)

    def moved(self, type: Type, depth: int) -> Expr:
        """Conversions, parts of vectors, vectors of parts, and what is read from arrays and tables."""
        ways: list[Callable[[Type, int], Expr]] = [
            self.converted,
            self.part if type.size == 1 else self.made,
            self.read,
        ]
        return self.pick(ways)(type, depth)  # type: ignore[no-any-return]

    def converted(self, type: Type, depth: int) -> Expr:
        others = {"f": "iub", "i": "fub", "u": "fi"}[type.base.value]
        return Convert(type, self.expr(type.based(Base(self.pick(others))), depth))

    def part(self, type: Type, depth: int) -> Expr:
        if type is U:
            return Apply(U, "bits_from_float", (self.expr(F, depth),))
        vector = self.pick((F3, F2)) if type is F else I2
        if self.chance(30):
            return (
                Component(type, Name(vector, self.there(vector)), self.expr(I, depth))
                if self.there(vector)
                else self.leaf(type)
            )
        return Swizzle(type, self.leaf(vector), (self.draw(st.integers(0, vector.size - 1)),))

    def there(self, type: Type) -> str:
        return next((name for name, t in reversed(self.names.items()) if t is type), "")

    def made(self, type: Type, depth: int) -> Expr:
        if type is F3 and self.chance(50):
            return Construct(type, (self.expr(F2, depth), self.expr(F, depth)))
        if type is not I2 and self.chance(50):
            vector = self.pick((F3, F2))
            picked = tuple(self.draw(st.integers(0, vector.size - 1)) for _ in range(type.size))
            return Swizzle(type, self.leaf(vector), picked)
        return Construct(type, tuple(self.expr(type.scalar, depth) for _ in range(type.size)))

    def read(self, type: Type, depth: int) -> Expr:
        if type is F2:
            return Read(F2, "grid", (self.index(depth), self.index(depth)))
        array = next((a for a in self.arrays if a.type is type), None)
        if array is not None and self.chance(60):
            return Read(type, array.name, (self.index(depth),))
        if type is F:
            return Read(F, "line", (self.index(depth),))
        if type is I:
            return Read(I, "counts", (self.index(depth),))
        return self.leaf(type)

    def index(self, depth: int) -> Expr:
        """An index that a variable gives: constants out of range are errors."""
        if self.there(I) and self.chance(60):
            return Name(I, self.there(I))
        names = [n for n, t in self.names.items() if t is I]
        return Apply(I, "add", (Name(I, self.pick(names)), self.expr(I, depth)))

    def truth(self, type: Type, depth: int) -> Expr:
        kind = self.draw(st.integers(0, 9))
        if kind < 6 or type.size > 1:
            of = self.pick((F, I, U)).sized(type.size)
            return Apply(type, self.pick(COMPARE), (self.expr(of, depth), self.expr(of, depth)))
        if kind < 8:
            return Apply(B, self.pick(("and", "or", "xor")), (self.expr(B, depth), self.expr(B, depth)))
        if kind == 8:
            vector = Apply(vec("b", 3), self.pick(COMPARE), (self.expr(F3, depth), self.expr(F3, depth)))
            return Apply(B, self.pick(("any", "all")), (vector,))
        return self.pick((Apply(B, "not", (self.expr(B, depth),)), Apply(B, "isnan", (self.expr(F, depth),))))  # type: ignore[no-any-return]

    # Statements

    def block(self, least: int = 1, goes_on: bool = False) -> Block:
        """Statements; what they declare is gone behind them. `goes_on`: something follows, so no exit ends them."""
        names, stored = dict(self.names), list(self.stored)
        made: list[Stmt] = []
        for _ in range(self.draw(st.integers(least, 5))):
            if self.budget > 0:
                self.budget -= 1
                made.append(self.statement())
        if self.depth and not goes_on and self.chance(25):
            made.append(Exit(self.exit_kind()))
        self.names, self.stored = names, stored
        return tuple(made)

    def statement(self) -> Stmt:
        ways: list[Callable[[], Stmt]] = [self.assign, self.assign, self.declare, self.lanes]
        if self.arrays:
            ways.append(self.write)
        if self.depth < 4:
            ways += [self.branch, self.branch, self.count_loop, self.count_loop, self.while_loop, self.do_loop]
        if self.functions:
            ways.append(self.call)
        if self.depth:
            ways += [self.leave, self.leave, self.leave]
        return self.pick(ways)()  # type: ignore[no-any-return]

    def target(self) -> tuple[str, Type]:
        name = self.pick(self.stored)
        return name, self.names[name]

    def assign(self) -> Stmt:
        name, type = self.target()
        if type.size > 1 and self.chance(40):
            picked = tuple(self.draw(st.permutations(range(type.size)))[: self.draw(st.integers(1, type.size))])
            part = type.sized(len(picked))
            return Assign(name, self.expr(part), picked, "add" if self.chance(30) else None)
        op = self.pick(("add", "mul", "sub")) if not type.is_bool and self.chance(40) else None
        return Assign(name, self.expr(type), None, op)

    def declare(self) -> Stmt:
        value = self.expr(self.pick(TYPES))
        name = self.fresh("t")
        self.names[name] = value.type
        self.stored.append(name)
        return Declare(name, value)

    def write(self) -> Stmt:
        array = self.pick(self.arrays)
        return Write(array.name, self.index(1), self.expr(array.type))

    def lanes(self) -> Stmt:
        name, type = self.pick([(n, self.names[n]) for n in self.stored if self.names[n].size == 1])
        return Lanes(self.pick(("any_lane", "all_lanes")), self.expr(B), name, self.expr(type))

    def exit_kind(self) -> str:
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
        return Exit(self.exit_kind(), self.expr(B))

    @contextmanager
    def inside(self) -> Any:
        self.depth += 1
        yield
        self.depth -= 1

    def branch(self) -> Stmt:
        branches = []
        for _ in range(1 + (self.chance(30))):
            condition = self.expr(B)
            with self.inside():
                branches.append((condition, self.block()))
        with self.inside():
            orelse = self.block() if self.chance(50) else None
        return If(tuple(branches), orelse)

    def looped(self, first: Block = (), goes_on: bool = False) -> tuple[Block, bool]:
        """A loop's body, and whether a continue may skip some of it."""
        self.loops.append(False)
        with self.inside():
            body = first + self.block(goes_on=goes_on)
        return body, self.loops.pop()

    def counter(self) -> tuple[Stmt, Stmt, Expr]:
        """What keeps a loop from running on: a counter, its step, whether it has room."""
        name = self.fresh("k")
        self.names[name] = I
        counter = Name(I, name)
        turns = Const(I, (self.draw(st.integers(1, MAX_TURNS)),))
        return (
            Declare(name, Const(I, (0,))),
            Assign(name, Const(I, (1,)), None, "add"),
            Apply(B, "lt", (counter, turns)),
        )

    def while_loop(self) -> Stmt:
        start, step, room = self.counter()
        condition = Apply(B, "and", (room, self.expr(B))) if not (self.endless and self.chance(50)) else self.expr(B)
        body, _ = self.looped((step,))
        return self.together(start, While(condition, body))

    def do_loop(self) -> Stmt:
        start, step, room = self.counter()
        if self.endless:
            # A break among the first statements would be the loop's test, behind which its turns are counted.
            step = If(((room, (step,)),))
        body, continues = self.looped((step,), goes_on=True)
        full = Apply(B, "not", (room,))
        until = Apply(B, "or", (full, self.expr(B))) if not (self.endless and self.chance(50)) else self.expr(B)
        return self.together(start, Do(body, until, late=continues or self.chance(30)))

    def count_loop(self) -> Stmt:
        index = self.fresh("i")
        stop: Expr = Const(I, (self.draw(st.integers(0, MAX_TURNS)),))
        if self.chance(40):
            stop = Apply(I, "and", (self.expr(I), Const(I, (3,))))
        bounds: tuple[Expr, ...] = (stop,)
        if self.chance(40):
            first = Const(I, (self.draw(st.integers(-2, 5)),))
            bounds = (first, stop)
            if self.chance(60):
                bounds = (first, stop, Const(I, (self.pick((1, 2, -1, -2, 3)),)))
        names = dict(self.names)
        self.names[index] = I
        body, _ = self.looped()
        self.names = names
        return For(index, bounds, body)

    @staticmethod
    def together(start: Stmt, loop: Stmt) -> Stmt:
        """A statement of two: a branch that is always taken would hide names, so the counter stands before it."""
        return Sequence((start, loop))  # type: ignore[return-value]

    def call(self) -> Stmt:
        function = self.pick(self.functions)
        args: list[Expr] = []
        taken: set[str] = set()
        for param in function.params:
            if param.length is not None:
                args.append(Name(param.type, self.arrays[0].name))
            elif param.name in function.stored:
                fitting = [n for n in self.stored if self.names[n] is param.type and n not in taken]
                if not fitting:
                    return self.assign()
                args.append(Name(param.type, self.pick(fitting)))
                taken.add(args[-1].name)
            else:
                args.append(self.const(param.type) if self.chance(20) else self.value_argument(param.type, taken))
        fitting = [n for n in self.stored if function.results and self.names[n] is function.results[0].type]
        result = self.pick(fitting) if fitting and not self.chance(20) else None
        return Call(function.name, tuple(args), result)

    def value_argument(self, type: Type, taken: set[str]) -> Expr:
        """An argument that is read only: an expression of its own, for a variable would be passed by reference."""
        del taken
        value = self.expr(type, 1)
        return value if isinstance(value, Apply) else Apply(type, "add", (value, self.const(type)))


@dataclass(frozen=True)
class Sequence:
    """Statements that were made as one."""

    statements: Block


def flat(block: Block) -> Block:
    """The block with its sequences spliced in."""
    made: list[Stmt] = []
    for s in block:
        match s:
            case Sequence(statements):
                made += flat(statements)
            case If(branches, orelse):
                made.append(If(tuple((c, flat(b)) for c, b in branches), None if orelse is None else flat(orelse)))
            case While(condition, body):
                made.append(While(condition, flat(body)))
            case Do(body, until, late):
                made.append(Do(flat(body), until, late))
            case For(index, bounds, body):
                made.append(For(index, bounds, flat(body)))
            case _:
                made.append(s)
    return tuple(made)


PARAMS = (Variable("p", F), Variable("q", F3), Variable("m", I), Variable("own", F, 3))
INPUTS = (Variable("a", F), Variable("v", F3), Variable("n", I), Variable("h", U))


_A, _V, _N, _H = Name(F, "a"), Name(F3, "v"), Name(I, "n"), Name(U, "h")
STARTS: dict[Type, Expr] = {
    F: Apply(F, "mul", (_A, Const(F, (0.5,)))),
    I: Apply(I, "sub", (_N, Const(I, (1,)))),
    F3: Apply(F3, "add", (_V, Splat(F3, _A))),
    U: Apply(U, "xor", (_H, Const(U, (5,)))),
    B: Apply(B, "lt", (_A, Swizzle(F, _V, (1,)))),
    F2: Swizzle(F2, _V, (2, 0)),
    I2: Construct(I2, (_N, Convert(I, _H))),
}


def function(draw: Any, name: str, earlier: list[Function]) -> Function:
    """A subroutine, which may call those before it."""
    params = PARAMS[: draw(st.integers(1, 4))]
    stored = frozenset(p.name for p in params if p.length is not None or draw(st.booleans()))
    w = Writer(draw, {p.name: p.type for p in params if p.length is None}, budget=8, functions=earlier)
    w.arrays = [p for p in params if p.length is not None]
    if not w.arrays:
        w.functions = [f for f in earlier if not any(p.length for p in f.params)]
    w.names["r"], w.names["c"] = F, I
    w.stored = ["r", "c", *(p.name for p in params if p.length is None and p.name in stored)]
    w.depth = 1
    start: Block = (Declare("r", w.const(F)), Declare("c", w.const(I)))
    body = start + flat(w.block(goes_on=True))
    # What is said to be stored into must be, or the language passes it by value.
    body += tuple(Assign(n, Const(t, (1.0,) * t.size), None, "add") for n, t in w.names.items() if n in stored)
    return Function(name, params, stored, body, (Name(F, "r"),))


@st.composite
def programs(draw: Any, endless: bool = False) -> Program:
    """A program over INPUTS; with `endless` its loops may go beyond its `loop_limit`."""
    functions: list[Function] = []
    for k in range(draw(st.integers(0, 2))):
        functions.append(function(draw, f"sub{k}", functions))
    w = Writer(draw, {i.name: i.type for i in INPUTS}, [i.name for i in INPUTS], functions=functions, endless=endless)
    w.arrays = [Variable("own", F, 3)]
    start: list[Stmt] = []
    for n, type in enumerate(TYPES):
        # Seldom a constant: where all elements agree, they all take one way.
        start.append(Declare(f"x{n}", w.const(type) if w.chance(15) else STARTS[type]))
        w.names[f"x{n}"] = type
        w.stored.append(f"x{n}")
    body = flat(w.block(3))
    results = tuple(Name(type, f"x{n}") for n, type in enumerate(TYPES))
    tables: tuple[tuple[str, Type, int], ...] = (("line", F, 1), ("grid", F2, 2), ("counts", I, 1))
    limit = 6 if endless else None
    return Program(INPUTS, tuple(w.arrays), tables, tuple(functions), (*start, *body), results, limit)


def elements(count: int) -> list[Any]:
    """Arrays for INPUTS: what is likely to go wrong, and what is likely to part the elements' ways."""
    rng = np.random.default_rng(count)
    arrays = []
    for variable in INPUTS:
        base, size = variable.type.base, variable.type.size
        shape = (count, size) if size > 1 else (count,)
        special = np.array(NUMBERS[base]).astype(DTYPES[base])
        ordinary = rng.integers(-3 if base is not Base.U else 0, 6, shape).astype(DTYPES[base])
        if base is Base.F:
            ordinary = rng.uniform(-4, 4, shape).astype(np.float32)
        arrays.append(np.where(rng.random(shape) < 0.3, rng.choice(special, shape), ordinary))
    return arrays
