"""The operations of the IR as C-like expressions: what all such targets share, with hooks for where they differ.

Stage: emit. `Operations.operation` makes the `Expr` of one `Let`. A target gives names of types, literals,
constructors and the functions that it does things with (its own, or ours in the prologue of the text); an operation
that it spells in its own way is a method `op_<name>`.

    %t = add %a, (splat %s)      ->   a + s
    %c = cond (splat %p), %a, %b ->   p ? a : b
    %m = min %a, %b              ->   sh_min(a, b)         and sh_min in the prologue
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import ClassVar, Final

from shpy.backends import expressions as ex
from shpy.backends.expressions import Expr, Level
from shpy.ir.constants import decode
from shpy.ir.nodes import Function, Let, Variable
from shpy.ir.types import Type

INFIX: Final[Mapping[str, tuple[str, Level]]] = {
    "add": ("+", Level.ADD),
    "sub": ("-", Level.ADD),
    "mul": ("*", Level.MUL),
    "div": ("/", Level.MUL),
    "and": ("&", Level.BIT_AND),
    "or": ("|", Level.BIT_OR),
    "xor": ("^", Level.BIT_XOR),
    "shl": ("<<", Level.SHIFT),
    "shr": (">>", Level.SHIFT),
}
COMPARISONS: Final[Mapping[str, str]] = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
_LOGIC: Final[Mapping[str, tuple[str, Level]]] = {
    "and": ("&&", Level.AND),
    "or": ("||", Level.OR),
    "xor": ("!=", Level.EQUAL),
}
COMPONENTS: Final = "xyzw"


class Operations:
    """Makes expressions of operations. The printer of statements, `CLike`, is above it; the targets above that."""

    scalar_comparisons: ClassVar[bool] = False
    """Whether a vector may be compared with a scalar."""

    def __init__(self, callees: Mapping[str, Function]) -> None:
        self.callees = callees
        self.function_names: dict[str, str] = {}
        self.params: dict[str, Expr] = {}
        self.slots: dict[int, Expr] = {}
        self.variables: dict[int, Variable] = {}
        self.types: dict[int, Type] = {}

    # What the printer of statements gives

    def take(self, value: int) -> Expr:
        """The expression of a value, for one of its uses."""
        raise KeyError(value)

    def simple(self, value: int) -> Expr:
        """The expression of a value, for an operation that writes it more than once."""
        raise KeyError(value)

    # What a target gives

    def type_name(self, type: Type) -> str:
        """The type's name: `float3`."""
        raise KeyError(type)

    def literal(self, type: Type, component: float | int | bool) -> Expr:
        """One number of a scalar type, exactly."""
        raise KeyError(type)

    def construct(self, type: Type, parts: list[Expr], types: list[Type]) -> Expr:
        """A vector from scalars and vectors; one scalar alone is repeated."""
        raise KeyError(type)

    def convert(self, type: Type, e: Expr, source: Type) -> Expr:
        """Conversion from another base."""
        raise KeyError(type)

    def table(self, name: str, type: Type, index: Expr) -> Expr:
        """The element of a table at an index, clamped on each axis."""
        raise KeyError(name)

    def table_size(self, name: str) -> Expr:
        """The shape of a table."""
        raise KeyError(name)

    def grid(self, op: str, type: Type) -> Expr:
        """`grid_index` or `grid_shape`."""
        raise KeyError(op)

    def in_range(self, index: Expr, length: int) -> Expr:
        """The index, clamped to [0, length)."""
        raise KeyError(length)

    def function(self, op: str, types: tuple[Type, ...]) -> str:
        """The function that does `op` for arguments of these types: the target's, or one of our own."""
        raise KeyError(op)

    def signed(self, e: Expr) -> Expr:
        """An int where it matters that it is one; see `Expr.unsigned`."""
        return e

    def context(self, function: Function) -> list[str]:
        """What a call hands on besides its arguments: tables, where they are no globals."""
        return []

    # Shared by all

    def operation(self, let: Let) -> Expr:
        """The expression of one Let; takes its arguments."""
        own: Callable[[Let], Expr] | None = getattr(self, f"op_{let.op}", None)
        if own is not None:
            return own(let)
        if let.op in INFIX:
            return self.infix(let)
        if let.op in COMPARISONS:
            return self.comparison(let)
        return self.plain_call(let)

    def args(self, let: Let) -> list[Expr]:
        """The arguments, each taken once."""
        return [self.signed(self.take(a)) for a in let.args]

    def plain_call(self, let: Let) -> Expr:
        """The operation as a call of a function."""
        name = self.function(let.op, tuple(self.types[a] for a in let.args))
        return ex.call(name, *self.args(let))

    def infix(self, let: Let) -> Expr:
        """`a + b`; a splat is left out where the other operand is a vector."""
        if let.value.type.is_bool and let.value.type.size == 1:
            return replace(ex.infix(*_LOGIC[let.op], *self.args(let)), update=None)
        left, right = self.args(let)
        left, right = self.without_splats(left, right, self.types[let.args[0]], right_only=let.op in ("shl", "shr"))
        return ex.infix(*INFIX[let.op], left, right)

    def repeated(self, scalar: Expr, type: Type) -> Expr:
        """A scalar where it stands beside a vector of `type`."""
        return scalar

    def without_splats(self, left: Expr, right: Expr, type: Type, *, right_only: bool = False) -> tuple[Expr, Expr]:
        """The operands of `type`, one of them a scalar where it was repeated; shifts allow that on the right only."""
        if right.scalar is not None:
            return left, self.repeated(right.scalar, type)
        if left.scalar is not None and not right_only:
            return self.repeated(left.scalar, type), right
        return left, right

    def comparison(self, let: Let) -> Expr:
        """`a < b`, of scalars or, where the target can, of vectors."""
        left, right = self.args(let)
        type = self.types[let.args[0]]
        if self.scalar_comparisons:
            left, right = self.without_splats(left, right, type)
        made = ex.comparison(COMPARISONS[let.op], left, right, ordered=not type.is_float)
        return made if type.size == 1 else replace(made, inverse=None)

    def op_neg(self, let: Let) -> Expr:
        """`-a`."""
        return ex.prefix("-", *self.args(let))

    def op_not(self, let: Let) -> Expr:
        """`!a` of a bool, `~a` of an int."""
        (e,) = self.args(let)
        if not let.value.type.is_bool:
            return ex.prefix("~", e)
        return ex.negation(e) if let.value.type.size == 1 else self.not_vector(e)

    def not_vector(self, e: Expr) -> Expr:
        """The opposite of a vector of bools."""
        return ex.prefix("!", e)

    def op_cond(self, let: Let) -> Expr:
        """`c ? a : b` for one c; `choose` for one a component."""
        c, a, b = self.args(let)
        if let.value.type.size == 1:
            return ex.ternary(c, a, b)
        return ex.ternary(c.scalar, a, b) if c.scalar is not None else self.choose(let.value.type, c, a, b)

    def choose(self, type: Type, c: Expr, a: Expr, b: Expr) -> Expr:
        """`cond` of vectors, component by component."""
        return ex.ternary(c, a, b)

    def op_const(self, let: Let) -> Expr:
        """A literal, or a vector of them."""
        type = let.value.type
        assert isinstance(let.attr, tuple)
        literals = [self.literal(type.scalar, c) for c in decode(type, let.attr)]
        if type.size == 1:
            return literals[0]
        if len(set(let.attr)) == 1:
            return self._splat(type, literals[0])
        return self.construct(type, literals, [type.scalar] * type.size)

    def _splat(self, type: Type, e: Expr) -> Expr:
        return replace(self.construct(type, [e], [type.scalar]), scalar=e)

    def op_splat(self, let: Let) -> Expr:
        """One scalar repeated."""
        (e,) = self.args(let)
        return e if let.value.type.size == 1 else self._splat(let.value.type, e)

    def op_construct(self, let: Let) -> Expr:
        """A vector from parts."""
        parts = self.args(let)
        types = [self.types[a] for a in let.args]
        return parts[0] if types[0] is let.value.type else self.construct(let.value.type, parts, types)

    def op_swizzle(self, let: Let) -> Expr:
        """`v.xy`; a scalar's only component is itself."""
        (e,) = self.args(let)
        assert isinstance(let.attr, tuple)
        source = self.types[let.args[0]]
        if source.size == 1:
            return e if let.value.type.size == 1 else self._splat(let.value.type, e)
        if let.attr == tuple(range(source.size)):
            return e
        if e.scalar is not None:
            return e.scalar if let.value.type.size == 1 else self._splat(let.value.type, e.scalar)
        return self.picked(e, let.attr, let.value.type)

    def picked(self, e: Expr, components: tuple[int, ...], type: Type) -> Expr:
        """Components of a vector as a value of `type`."""
        return ex.member(e, "".join(COMPONENTS[c] for c in components))

    def op_load(self, let: Let) -> Expr:
        """The variable's name, or an element of an array."""
        assert isinstance(let.attr, int)
        slot = self.slots[let.attr]
        if not let.args:
            return slot
        (index,) = self.args(let)
        length = self.variables[let.attr].length
        assert length is not None
        return ex.element(slot, self._within(index, length))

    def _within(self, index: Expr, length: int) -> Expr:
        fixed = index.text.isdigit() and int(index.text) < length
        return index if fixed else self.in_range(index, length)

    def op_param(self, let: Let) -> Expr:
        """A uniform."""
        return self.params[str(let.attr)]

    def op_convert(self, let: Let) -> Expr:
        """Conversion; the same base needs none."""
        (e,) = self.args(let)
        source = self.types[let.args[0]]
        return e if source is let.value.type else self.convert(let.value.type, e, source)

    def op_table(self, let: Let) -> Expr:
        """A read of a table."""
        return self.table(str(let.attr), let.value.type, *self.args(let))

    def op_table_size(self, let: Let) -> Expr:
        """A table's shape."""
        return self.table_size(str(let.attr))

    def op_grid_index(self, let: Let) -> Expr:
        """This element's index."""
        return self.grid(let.op, let.value.type)

    op_grid_shape = op_grid_index

    def op_any_lane(self, let: Let) -> Expr:
        """One element runs alone: what holds for it holds for all that run with it."""
        return self.take(let.args[0])

    op_all_lanes = op_any_lane

    def op_any(self, let: Let) -> Expr:
        """Whether one component holds; a scalar is its own answer."""
        return self.take(let.args[0]) if self.types[let.args[0]].size == 1 else self.plain_call(let)

    op_all = op_any

    def op_call(self, let: Let) -> Expr:
        """A call of a pure function."""
        function = self.callees[str(let.attr)]
        handed = [Expr(text) for text in self.context(function)]
        return ex.call(self.function_names[function.name], *self.args(let), *handed)
