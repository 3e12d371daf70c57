"""Draws expressions of a wanted type over the names in scope.

Stage: test. Only operations with one exact answer, so that every target must give the same bits: those of strict mode.
A number that only the driver's compiler can derive (`i - i`), or a denormal, is drawn where `derives` allows it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from hypothesis import strategies as st

from shpy.ir.ops import OPS
from shpy.ir.types import Base, Type, vec
from shpy.testing.generated.inputs import NUMBERS
from shpy.testing.generated.operations import (
    COMPARE,
    FLOAT_BINARY,
    FLOAT_TERNARY,
    FLOAT_UNARY,
    FUNCTIONS,
    GEOMETRY,
    INT_BINARY,
    INT_TERNARY,
    INT_UNARY,
    LOGIC,
    REDUCING,
    SHIFTS,
    TESTS,
)
from shpy.testing.generated.syntax import (
    F2,
    F3,
    FIELDS,
    Apply,
    B,
    Component,
    Const,
    Construct,
    Convert,
    Expr,
    F,
    Function,
    I,
    LaneIndex,
    Name,
    Product,
    Read,
    Splat,
    Swizzle,
    U,
    Variable,
)

CORE = (F, I, vec("f", 3), B)
"""Every program has a variable of each of these types."""

FEW = "few"
"""A variable of ints from 0 to 2 that no statement changes."""

OTHERS = tuple(vec(base, size) for size in (2, 4, 3, 1) for base in "fibu" if vec(base, size) not in CORE)
"""And of some of these."""

FLOAT_OPERATORS = (*FLOAT_BINARY, "floordiv", "floormod")
"""The language has the last two for floats as well."""
SIGNED = ("min", "max", "floormod", "floordiv", "shr", "mul")
"""Operations that tell a negative int from a large unsigned one."""
EDGES = {Base.F: (1e-40, -1e-45, 1.2e-38, 3e38), Base.I: (), Base.U: (), Base.B: ()}
"""Constants beside NUMBERS: denormals and their neighbours."""
PARTS = {1: ((1,),), 2: ((1, 1),), 3: ((1, 1, 1), (1, 2), (2, 1)), 4: ((1, 1, 1, 1), (2, 2), (1, 3), (3, 1), (1, 1, 2))}
"""The sizes of the parts of which a vector can be made."""


@dataclass
class Expressions:
    """The scope of a statement: `names` are visible, `stored` may be stored into."""

    draw: Callable[[Any], Any]
    names: dict[str, Type] = field(default_factory=dict)
    stored: list[str] = field(default_factory=list)
    arrays: list[Variable] = field(default_factory=list)
    functions: list[Function] = field(default_factory=list)
    matrices: dict[str, int] = field(default_factory=dict)
    uniforms: tuple[str, ...] = ()
    indices: tuple[str, ...] = ()
    count: int = 0
    depth: int = 0
    deepest: int = 4
    loops: list[bool] = field(default_factory=list)
    counters: tuple[str, ...] = ()
    budget: int = 30
    endless: bool = False
    derives: bool = False
    functions_chance: int = 4
    """Percent of the expressions of floats that are elementary functions."""

    def pick(self, options: Any) -> Any:
        """Draw one of these."""
        return self.draw(st.sampled_from(options))

    def chance(self, percent: int) -> bool:
        """Fails in the simplest example."""
        return bool(self.draw(st.integers(0, 99)) >= 100 - percent)

    def fresh(self, prefix: str) -> str:
        """Return a name that is not taken."""
        self.count += 1
        return f"{prefix}{self.count}"

    # Expressions

    def const(self, type: Type) -> Const:
        """Return a constant of a type."""
        numbers = NUMBERS[type.base] + (EDGES[type.base] if self.derives and self.chance(30) else ())
        if self.chance(30):
            return Const(type, (self.pick(numbers),) * type.size)
        return Const(type, tuple(self.pick(numbers) for _ in range(type.size)))

    def leaf(self, type: Type) -> Expr:
        """Return a name in sight, or a constant."""
        there = [name for name, t in self.names.items() if t is type]
        if there and not self.chance(15):
            return Name(type, self.pick(there))
        return self.const(type)

    def expr(self, type: Type, depth: int = 2) -> Expr:
        """Return an expression of a type, at most `depth` operations deep."""
        if depth == 0 or self.chance(35):
            return self.leaf(type)
        if self.uniforms and self.chance(4):
            return self.uniform(type, depth)
        kinds = {Base.F: self.arithmetic, Base.B: self.truth}
        kind = kinds.get(type.base, self.whole)
        return self.pick((kind, kind, self.moved))(type, depth - 1)  # type: ignore[no-any-return]

    def uniform(self, type: Type, depth: int) -> Expr:
        """Draw an expression of uniforms and tables, with one value for all elements: often a choice among them."""
        kept = self.names, self.arrays, self.matrices, self.indices, self.uniforms
        self.names, self.arrays, self.matrices = {n: self.names[n] for n in self.uniforms}, [], {}
        self.indices, self.uniforms = (), ()
        expression = self.choice(type, depth - 1) if depth and self.chance(50) else self.expr(type, depth)
        self.names, self.arrays, self.matrices, self.indices, self.uniforms = kept
        return expression

    def edged(self, type: Type) -> Expr:
        """Return an int at the ends of its range for some elements, where C has another type than the language."""
        op = self.pick(("abs", "abs", *INT_UNARY))
        return Apply(type, op, (self.leaf(type),))

    def row(self, type: Type, op: str, of: tuple[Type, ...], depth: int, first: Expr | None = None) -> Apply:
        """Return an op on operands of these types; beside one vector the others may be scalars, on either side."""
        whole = self.draw(st.integers(0, len(of) - 1))
        args = [
            Splat(t, self.expr(t.scalar, depth))
            if t.size > 1 and k != whole and self.chance(30)
            else self.expr(t, depth)
            for k, t in enumerate(of)
        ]
        if first is not None:
            args[0] = first
        return Apply(type, op, tuple(args))

    def assembled(self, type: Type, depth: int) -> Expr:
        """Draw an argument of a function that takes vectors: half of the time one made of parts from outside."""
        if type.size == 1 or not self.chance(50):
            return self.expr(type, depth)
        parts = self.pick(PARTS[type.size])
        return Construct(type, tuple(self.outside(n) if n > 1 else self.expr(F, depth) for n in parts))

    def outside(self, size: int) -> Expr:
        """Floats from an input, a uniform or a table: targets that take vectors apart leave those whole."""
        read = Read(F2, "grid", (self.place(1, 30), self.place(1, 30)))
        vector = self.pick([read, *(Name(self.names[n], n) for n in ("v", "pv") if n in self.names)])
        return Swizzle(
            vec("f", size), vector, tuple(self.draw(st.integers(0, vector.type.size - 1)) for _ in range(size))
        )

    def same(self, type: Type, op: str, count: int, depth: int, first: Expr | None = None) -> Apply:
        """Return an op whose operands are all of the result's type."""
        return self.row(type, op, (type,) * count, depth, first)

    def arithmetic(self, type: Type, depth: int) -> Expr:
        """Return an expression of floats."""
        if self.chance(self.functions_chance):
            op = self.pick(FUNCTIONS)
            return Apply(type, op, tuple(self.assembled(type, depth) for _ in OPS[op].takes))
        if self.derives and self.chance(25):
            return self.derived(type, depth)
        kind = self.draw(st.integers(0, 10))
        if kind < 5:
            return self.same(type, self.pick(FLOAT_OPERATORS), 2, depth)
        if kind < 7:
            return self.same(type, self.pick(FLOAT_UNARY), 1, depth)
        if kind == 7:
            return self.scaled(type, depth) if self.chance(15) else self.same(type, self.pick(FLOAT_TERNARY), 3, depth)
        if kind == 8:
            return self.geometry(type, depth)
        if kind == 9 and self.there_matrix(type):
            return Product(type, self.there_matrix(type), self.expr(type, depth), self.chance(50))
        return self.choice(type, depth)

    def scaled(self, type: Type, depth: int) -> Expr:
        """Return an `ldexp`, whose result is now and then a denormal."""
        ints = type.based(Base.I)
        exponent = self.expr(ints, depth)
        if self.chance(50):
            exponent = Apply(ints, "add", (exponent, Const(ints, (self.pick((0, -130, -145, 100)),) * type.size)))
        return Apply(type, "ldexp", (self.expr(type, depth), exponent))

    def geometry(self, type: Type, depth: int) -> Expr:
        """Draw an operation on whole vectors."""
        fitting = [op for op in GEOMETRY if (OPS[op].gives == "S") == (type.size == 1)]
        op = self.pick([op for op in fitting if OPS[op].gives != "V3" or type.size == 3])
        vector = type if type.size > 1 else vec("f", self.draw(st.integers(2, 4)))
        return Apply(
            type, op, tuple(self.expr(F, depth) if t == "S" else self.assembled(vector, depth) for t in OPS[op].takes)
        )

    def derived(self, type: Type, depth: int) -> Expr:
        """Draw an operation with a number that a driver's compiler can derive, and this package does not."""
        ints = [n for n, t in self.names.items() if t is I]
        i = Name(I, self.pick(self.indices or ints))
        number = self.pick(
            (
                Convert(F, i),
                Convert(F, Apply(I, "sub", (i, i))),
                Apply(F, "sub", (Const(F, (1.0,)), Convert(F, i))),
                Apply(F, "cond", (Apply(B, "lt", (i, Const(I, (1,)))), Const(F, (0.0,)), Const(F, (2.0,)))),
            )
        )
        operand: Expr = number if type.size == 1 else Splat(type, number)
        other = self.expr(type, depth)
        op = self.pick(("mul", "add", "sub", "div", "mix"))
        if op == "mix":
            return Apply(type, op, (other, self.expr(type, depth), operand))
        return Apply(type, op, (operand, other) if type.size == 1 and self.chance(50) else (other, operand))

    def choice(self, type: Type, depth: int) -> Expr:
        """Return a `cond`, by one bool or by one for each component; now and then by a choice among bools."""
        bools = type.based(Base.B)
        condition: Expr | None = None
        if depth and self.chance(40):
            shared = self.uniforms and self.chance(60)
            condition = self.uniform(bools, depth) if shared else self.choice(bools, depth - 1)
        return self.row(type, "cond", (bools, type, type), depth, condition)

    def whole(self, type: Type, depth: int) -> Expr:
        """Return an expression of ints."""
        if type.base is Base.I and self.chance(10):
            return self.same(type, self.pick(SIGNED), 2, 0, self.edged(type))
        kind = self.draw(st.integers(0, 9))
        if kind < 6:
            op = self.pick(INT_BINARY)
            shifts = op in SHIFTS
            of = (type, type.based(self.pick((Base.I, Base.U))) if shifts else type)
            return (
                Apply(type, op, (self.expr(type, depth), self.expr(of[1], depth)))
                if shifts
                else self.row(type, op, of, depth)
            )
        if kind < 8:
            return self.same(type, self.pick(INT_UNARY), 1, depth)
        return self.same(type, self.pick(INT_TERNARY), 3, depth) if self.chance(20) else self.choice(type, depth)

    def moved(self, type: Type, depth: int) -> Expr:
        """Conversions, parts of vectors, vectors of parts, and what is read from arrays and tables."""
        ways = (self.converted, self.part if type.size == 1 else self.built, self.built, self.read)
        return self.pick(ways)(type, depth)  # type: ignore[no-any-return]

    def converted(self, type: Type, depth: int) -> Expr:
        """Return a conversion from another base."""
        if type.base is Base.U and self.chance(30):
            return Apply(type, "bits_from_float", (self.expr(type.based(Base.F), depth),))
        if type.base is Base.F and self.chance(20):
            name = self.pick(("float_from_bits", "unit_float"))
            return Apply(type, name, (self.expr(type.based(Base.U), depth),))
        others = {"f": "iub", "i": "fub", "u": "fib", "b": "ifu"}[type.base.value]
        return Convert(type, self.expr(type.based(Base(self.pick(others))), depth))

    def part(self, type: Type, depth: int) -> Expr:
        """Return a component of a vector."""
        vector = self.vector(type.base)
        if self.chance(30):
            return Component(type, self.expr(vector, depth), self.index(depth))
        return Swizzle(type, self.expr(vector, depth), (self.draw(st.integers(0, vector.size - 1)),))

    def vector(self, base: Base) -> Type:
        """Draw a vector type of a base, in most cases the type of an existing variable."""
        there = [t for t in self.names.values() if t.base is base and t.size > 1]
        if there and not self.chance(20):
            return self.pick(there)  # type: ignore[no-any-return]
        return vec(base, self.draw(st.integers(2, 4)))

    def built(self, type: Type, depth: int) -> Expr:
        """Return a vector out of parts."""
        if type.size == 1:
            return self.part(type, depth)
        if self.chance(30):
            vector = self.vector(type.base)
            picked = tuple(self.draw(st.integers(0, vector.size - 1)) for _ in range(type.size))
            return Swizzle(type, self.expr(vector, depth), picked)
        if self.chance(10):
            return Construct(type, (self.expr(type.scalar, depth),))
        return Construct(type, tuple(self.expr(type.sized(n), depth) for n in self.pick(PARTS[type.size])))

    def read(self, type: Type, depth: int) -> Expr:
        """Return an element of an array or a table."""
        for array in self.arrays:
            if array.struct:
                field = next((f for f, t in FIELDS.items() if t is type), None)
                if field and self.chance(60):
                    return Read(type, array.name, (self.index(depth),), field)
            elif array.type is type and self.chance(60):
                return Read(type, array.name, (self.index(depth),))
        if type is F2:
            return Read(F2, "grid", (self.place(depth), self.place(depth)))
        if type is F:
            return Read(F, "line", (self.place(depth),))
        if type is I:
            return Read(I, "counts", (self.place(depth),))
        if type is F3:
            return Read(F3, "points", (self.place(depth),))
        return self.leaf(type)

    def place(self, depth: int, lanes: int = 10) -> Expr:
        """Return the index of a table; in `lanes` of a hundred draws it depends on other lanes."""
        if self.chance(lanes):
            return LaneIndex(I, self.pick(("any_lane", "all_lanes")), self.expr(B, depth))
        return self.index(depth)

    def index(self, depth: int) -> Expr:
        """Return an index that a variable gives: constants out of range are errors."""
        uints = [n for n, t in self.names.items() if t is U]
        if uints and self.chance(20):
            return Name(U, self.pick(uints))
        names = [n for n, t in self.names.items() if t is I]
        if FEW in self.names and self.chance(30):  # an index that is in range and that loops change
            return Apply(I, "add", (Name(I, FEW), Apply(I, "and", (Name(I, self.pick(names)), Const(I, (1,))))))
        if self.chance(40):
            return Apply(I, "add", (Name(I, self.pick(names)), self.expr(I, depth)))
        return Name(I, self.pick(names))

    def there_matrix(self, type: Type) -> str:
        """Return a matrix that takes vectors of this type, "" if there is none."""
        fitting = [name for name, size in self.matrices.items() if size == type.size]
        return str(self.pick(fitting)) if fitting else ""

    def truth(self, type: Type, depth: int) -> Expr:
        """Return an expression of bools."""
        kind = self.draw(st.integers(0, 10))
        if kind < 5:
            of = type.based(self.pick((Base.F, Base.I, Base.U)))
            first = self.edged(of) if of.base is Base.I and self.chance(30) else None
            return self.row(type, self.pick(COMPARE), (of, of), depth, first)
        if kind < 7:
            return self.same(type, self.pick(LOGIC), 2, depth)
        if kind == 7:
            return self.choice(type, depth)
        if kind == 8 and type.size == 1:
            return Apply(B, self.pick(REDUCING), (self.expr(self.vector(Base.B), depth),))
        if kind == 9:
            return Apply(type, self.pick(TESTS), (self.expr(type.based(Base.F), depth),))
        return Apply(type, "not", (self.expr(type, depth),))
