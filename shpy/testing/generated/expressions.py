"""Draws expressions of a wanted type from what is in sight.

Stage: test. Only operations with one exact answer, so that every target must give the same bits: those of strict mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from hypothesis import strategies as st

from shpy.ir.ops import OPS, TRANSCENDENTALS
from shpy.ir.types import Base, Type, vec
from shpy.testing.generated.inputs import NUMBERS
from shpy.testing.generated.syntax import (
    F2,
    F3,
    I2,
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
    Name,
    Read,
    Splat,
    Swizzle,
    U,
    Variable,
)

__all__ = ["TYPES", "Expressions"]

TYPES = (F, I, F3, U, B, F2, I2)
FLOAT_UNARY = ("neg", "abs", "floor", "sqrt", "sign", "ceil", "round", "trunc", "fract")
FLOAT_BINARY = ("add", "sub", "mul", "div", "min", "max", "floormod", "step", "floordiv")
FLOAT_TERNARY = ("clamp", "mix", "mad", "smoothstep", "fma")
INT_UNARY = ("neg", "not", "abs", "popcount", "sign")
INT_BINARY = ("add", "sub", "mul", "and", "or", "xor", "floordiv", "floormod", "min", "max", "shl", "shr")
VECTOR = ("dot", "distance")
FUNCTIONS = tuple(sorted(TRANSCENDENTALS))
COMPARE = ("lt", "eq", "ge", "ne", "gt", "le")


@dataclass
class Expressions:
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
        """One of these."""
        return self.draw(st.sampled_from(options))

    def chance(self, percent: int) -> bool:
        """Fails in the simplest example."""
        return bool(self.draw(st.integers(0, 99)) >= 100 - percent)

    def fresh(self, prefix: str) -> str:
        """A name that is not taken."""
        self.count += 1
        return f"{prefix}{self.count}"

    # Expressions

    def const(self, type: Type) -> Const:
        """A constant of a type."""
        return Const(type, tuple(self.pick(NUMBERS[type.base]) for _ in range(type.size)))

    def leaf(self, type: Type) -> Expr:
        """A name in sight, or a constant."""
        there = [name for name, t in self.names.items() if t is type]
        if there and not self.chance(15):
            return Name(type, self.pick(there))
        return self.const(type)

    def expr(self, type: Type, depth: int = 2) -> Expr:
        """An expression of a type, at most `depth` operations deep."""
        if depth == 0 or self.chance(35):
            return self.leaf(type)
        if type.is_float:
            return self.pick((self.arithmetic, self.arithmetic, self.moved))(type, depth - 1)  # type: ignore[no-any-return]
        if type.is_int:
            return self.pick((self.whole, self.whole, self.moved))(type, depth - 1)  # type: ignore[no-any-return]
        return self.truth(type, depth - 1)

    def operand(self, type: Type, depth: int, beside_vector: bool) -> Expr:
        """An operand; beside a vector it may be a scalar."""
        if beside_vector and type.size > 1 and self.chance(30):
            return Splat(type, self.expr(type.scalar, depth))
        return self.expr(type, depth)

    def row(self, type: Type, op: str, count: int, depth: int) -> Apply:
        """An op whose operands are all of the result's type."""
        spread = count == 2 and op != "step"
        return Apply(type, op, tuple(self.operand(type, depth, spread and n > 0) for n in range(count)))

    def arithmetic(self, type: Type, depth: int) -> Expr:
        """An expression of floats."""
        if self.chance(4):
            op = self.pick(FUNCTIONS)
            return self.row(type, op, OPS[op].signature.count("T") - 1, depth)
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
        """A `cond`."""
        mask = self.expr(B, depth)
        condition = mask if type.size == 1 else Splat(vec("b", type.size), mask)
        return Apply(type, "cond", (condition, self.expr(type, depth), self.expr(type, depth)))

    def whole(self, type: Type, depth: int) -> Expr:
        """An expression of ints."""
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
        """A conversion from another base."""
        others = {"f": "iub", "i": "fub", "u": "fi"}[type.base.value]
        return Convert(type, self.expr(type.based(Base(self.pick(others))), depth))

    def part(self, type: Type, depth: int) -> Expr:
        """A component of a vector, or the bits of a float."""
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
        """The variable of a type that was declared last, "" if there is none."""
        return next((name for name, t in reversed(self.names.items()) if t is type), "")

    def made(self, type: Type, depth: int) -> Expr:
        """A vector out of parts."""
        if type is F3 and self.chance(50):
            return Construct(type, (self.expr(F2, depth), self.expr(F, depth)))
        if type is not I2 and self.chance(50):
            vector = self.pick((F3, F2))
            picked = tuple(self.draw(st.integers(0, vector.size - 1)) for _ in range(type.size))
            return Swizzle(type, self.leaf(vector), picked)
        return Construct(type, tuple(self.expr(type.scalar, depth) for _ in range(type.size)))

    def read(self, type: Type, depth: int) -> Expr:
        """An element of an array or a table."""
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
        """An expression of bools."""
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
