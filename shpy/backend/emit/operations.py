"""Operations of the IR as expressions of the output tree: what C-like targets share, with hooks for where they differ.

Stage: emit. `Operations.operation` makes the expression of one `Let` from those of its operands. An operation that a
target has in its own way is a method `op_<name>`; what it does by a function is told by `function_of`.

    %t = add %a, (splat %s)      ->   a + s
    %c = cond (splat %p), %a, %b ->   p ? a : b
    %m = min %a, %b              ->   sh_min(a, b)         and sh_min in the prologue
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import ClassVar, Final

from shpy.backend.emit import tree
from shpy.backend.emit.entry import Unit
from shpy.backend.emit.survey import Survey
from shpy.backend.emit.tree import BOOL, INT, Assign, Block, Construct, Expr, Index, Literal
from shpy.ir.constants import decode, encode
from shpy.ir.nodes import Function, Let, Loc, Loop, Store, Value, Variable
from shpy.ir.traverse import defined, variables_of
from shpy.ir.types import Type
from shpy.passes.known import Ranges

INFIX: Final[Mapping[str, str]] = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "and": "&", "or": "|", "xor": "^", "shl": "<<", "shr": ">>",
    "quot": "/", "rem": "%",
}  # fmt: skip
COMPARISONS: Final[Mapping[str, str]] = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
OPERATORS: Final = {**INFIX, **COMPARISONS}
_LOGIC: Final = {"and": "&&", "or": "||", "xor": "!="}


class Operations:
    """Makes the expressions of one function, and the statements that a target writes in its own way."""

    returns_expressions: ClassVar[bool] = True
    """True if a result may be returned without a variable."""

    def __init__(self, unit: Unit, function: Function) -> None:
        self.unit, self.function = unit, function
        self.exprs: dict[int, Expr] = {}
        """The expression of each value that has been made."""
        self.slots: dict[int, Expr] = {}
        """The expression of each variable that has been declared."""
        self.types = {v.id: v.type for v in defined(function)}
        self.variables = {v.id: v for v in variables_of(function)}
        self.ranges = Ranges(function)
        self.survey = Survey(function, unit.callees)

    # What a target gives

    def convert(self, type: Type, e: Expr, source: Type) -> Expr:
        """Return the conversion from another base."""
        raise KeyError(source)

    def in_range(self, index: Expr, length: int) -> Expr:
        """Return the index, clamped to [0, length)."""
        raise KeyError(length)

    def function_of(self, op: str, types: tuple[Type, ...]) -> str:
        """Name the function that does `op` for arguments of these types: the target's, or one of our own."""
        raise KeyError(op)

    def context(self, function: str) -> tuple[Expr, ...]:
        """Return the arguments that a call adds to its own: tables, where they are no globals."""
        return ()

    def choose(self, type: Type, c: Expr, a: Expr, b: Expr) -> Expr:
        """Return `cond` of vectors, component by component."""
        return tree.choice(c, a, b)

    def not_vector(self, e: Expr) -> Expr:
        """Return the opposite of each bool."""
        return tree.prefix("!", e)

    def as_typed(self, e: Expr, type: Type) -> Expr:
        """Return an expression where its type matters: the target may have computed an int as a uint."""
        return e

    def component(self, e: Expr) -> Expr:
        """Return a scalar as it stands beside a vector, or is stored into a component of one."""
        return e

    def splat_of(self, e: Expr) -> Expr | None:
        """Return the scalar that `e` repeats, which may replace it beside a vector; None if `e` is no splat."""
        return e.splat

    def literal(self, type: Type, component: float | int | bool) -> Expr:
        """Return one number of a scalar type, exactly."""
        return Literal(type, component)

    # The statements of a target

    def need_names(self, inlined: set[int]) -> Collection[int]:
        """Return the values that must have a name, of those that may stand where they are used."""
        return ()

    def repeats(self, s: Let | Store) -> Collection[int]:
        """Return the operands that the target writes more than once: the index of a store, which is tested."""
        return (s.index,) if isinstance(s, Store) and s.index is not None else ()

    def reference(self, e: Expr) -> Expr:
        """Return a variable that is no array as an argument by reference."""
        return e

    def output(self, variable: Variable, e: Expr, loc: Loc | None) -> tree.Stmt:
        """Return the statement that gives a direct output its value."""
        raise KeyError(variable)

    def step(self, test: Expr | None, step: Assign) -> Assign:
        """Return the step of a `for`; `test` held when the iteration began, None if the iteration may change it."""
        return step

    def looped(self, s: Loop, loop: tree.Loop) -> tree.Loop:
        """Return the loop with the statements that the target adds; a hook for targets, which adds none by default."""
        return loop

    def unknown_zero(self, type: Type) -> Expr | None:
        """Return a zero that the target's compiler cannot recognise as a constant; None for targets that need none."""
        return None

    def array_length(self, variable: Variable) -> int | None:
        """Return the number of elements with which an array is declared; None for a variable that is no array."""
        return variable.length

    def assign(self, s: Store, target: Expr, e: Expr) -> Assign:
        """Return the assignment to the components that are stored."""
        type = self.variables[s.variable].type
        if s.components is None or type.size == 1:
            return Assign(target, e, s.loc)
        part = tree.picked(target, s.components, target.type.sized(len(s.components)))
        return Assign(part, self.component(e) if len(s.components) == 1 else e, s.loc)

    def store_element(self, s: Store, index: int, e: Expr) -> Block:
        """Return the store into an array: nothing happens where the index is out of range."""
        variable = self.variables[s.variable]
        length, at = variable.length or 0, self.arg(index)
        assign = self.assign(s, Index(variable.type, self.slots[s.variable], at), e)
        if not isinstance(at, Literal):
            return (tree.If(self.inside(at, length), (assign,), (), s.loc),)
        return (assign,) if 0 <= at.value < length else ()

    # Shared by all

    def operation(self, let: Let) -> Expr:
        """Return the expression of one Let."""
        own: Callable[[Let], Expr] | None = getattr(self, f"op_{let.op}", None)
        if own is not None:
            return own(let)
        if let.op in INFIX:
            return self.infix(let)
        if let.op in COMPARISONS:
            return self.comparison(let)
        return self.plain_call(let)

    def arg(self, value: int) -> Expr:
        """Return the expression of an operand, with the type that the IR gives it."""
        return self.as_typed(self.exprs[value], self.types[value])

    def args(self, let: Let) -> list[Expr]:
        """Return the operands."""
        return [self.as_typed(self.exprs[a], self.types[a]) for a in let.args]

    def plain_call(self, let: Let) -> Expr:
        """Return the operation as a call of a function."""
        name = self.function_of(let.op, tuple([self.types[a] for a in let.args]))
        return tree.call(name, let.value.type, *self.args(let))

    def zero(self, type: Type) -> Expr:
        """Return the zero of a type."""
        return self.op_const(Let(Value(-1, type), "const", (), encode(type, [0] * type.size)))

    def infix(self, let: Let) -> Expr:
        """Return `a + b`; a splat is left out where the other operand is a vector."""
        a, b = self.args(let)
        if let.value.type is BOOL:
            return tree.infix(_LOGIC[let.op], a, b)
        a, b = self.without_splats(a, b, right_only=let.op in ("shl", "shr"))
        return tree.infix(INFIX[let.op], a, b, let.value.type)

    def without_splats(self, a: Expr, b: Expr, *, right_only: bool = False) -> tuple[Expr, Expr]:
        """Return operands, one of them a scalar where it was repeated; shifts allow that on the right only."""
        scalar = self.splat_of(b)
        if scalar is not None:
            return a, self.component(scalar)
        scalar = None if right_only else self.splat_of(a)
        return (a, b) if scalar is None else (self.component(scalar), b)

    def comparison(self, let: Let) -> Expr:
        """Return `a < b`; a splat is left out where the other operand is a vector."""
        a, b = self.without_splats(*self.args(let))
        return tree.infix(COMPARISONS[let.op], a, b, let.value.type)

    def op_neg(self, let: Let) -> Expr:
        """Return `-a`."""
        return tree.prefix("-", self.arg(let.args[0]))

    def op_not(self, let: Let) -> Expr:
        """Return `!a` of a bool, `~a` of an int."""
        e = self.arg(let.args[0])
        if not let.value.type.is_bool:
            return tree.prefix("~", e)
        return tree.negation(e) if let.value.type is BOOL else self.not_vector(e)

    def op_cond(self, let: Let) -> Expr:
        """Return `c ? a : b` for one c; `choose` for one a component."""
        c, a, b = self.args(let)
        one = c if let.value.type.size == 1 else self.splat_of(c)
        return self.choose(let.value.type, c, a, b) if one is None else tree.choice(one, a, b)

    def op_const(self, let: Let) -> Expr:
        """Return a literal, or a vector of them."""
        type = let.value.type
        assert isinstance(let.attr, tuple)
        same = len(set(let.attr)) == 1
        literals = [self.literal(type.scalar, c) for c in decode(type, let.attr[:1] if same else let.attr)]
        return literals[0] if type.size == 1 else Construct(type, tuple(literals))

    def op_splat(self, let: Let) -> Expr:
        """Return one scalar repeated."""
        e = self.arg(let.args[0])
        return e if let.value.type.size == 1 else Construct(let.value.type, (e,))

    def op_construct(self, let: Let) -> Expr:
        """Return a vector from parts; components convert by themselves."""
        if self.types[let.args[0]] is let.value.type:
            return self.exprs[let.args[0]]
        return Construct(let.value.type, tuple([self.exprs[a] for a in let.args]))

    def op_swizzle(self, let: Let) -> Expr:
        """Return `v.xy`; a scalar's only component is itself."""
        e, source, type = self.arg(let.args[0]), self.types[let.args[0]], let.value.type
        assert isinstance(let.attr, tuple)
        scalar = e if source.size == 1 else self.splat_of(e)
        if let.attr == tuple(range(source.size)):
            return e
        if scalar is not None:
            return scalar if type.size == 1 else Construct(type, (scalar,))
        return self.picked(e, let.attr, type)

    def picked(self, e: Expr, components: tuple[int, ...], type: Type) -> Expr:
        """Return components of a vector as a value of `type`."""
        return tree.picked(e, components, type)

    def op_load(self, let: Let) -> Expr:
        """Return the variable, or an element of an array."""
        assert isinstance(let.attr, int)
        slot = self.slots[let.attr]
        if not let.args:
            return slot
        index, length = self.arg(let.args[0]), self.variables[let.attr].length or 0
        fixed = isinstance(index, Literal) and 0 <= index.value < length
        return Index(let.value.type, slot, index if fixed else self.in_range(index, length))

    def op_convert(self, let: Let) -> Expr:
        """Return a conversion; the same base needs none."""
        e, source = self.arg(let.args[0]), self.types[let.args[0]]
        return e if source is let.value.type else self.convert(let.value.type, e, source)

    def op_any_lane(self, let: Let) -> Expr:
        """Return the operand itself: an element runs alone, so it speaks for all that run with it."""
        return self.exprs[let.args[0]]

    op_all_lanes = op_min_lane = op_max_lane = op_any_lane

    def op_any(self, let: Let) -> Expr:
        """Return whether one component holds; a scalar is its own answer."""
        return self.exprs[let.args[0]] if self.types[let.args[0]].size == 1 else self.plain_call(let)

    op_all = op_any

    def op_call(self, let: Let) -> Expr:
        """Return a call of a pure function."""
        return self.called(str(let.attr), let.value.type, self.args(let))

    def called(self, function: str, type: Type, args: Iterable[Expr]) -> Expr:
        """Return a call of a function of the module."""
        return tree.call(self.unit.functions[function], type, *args, *self.context(function))

    def inside(self, index: Expr, length: int) -> Expr:
        """Return whether the index is in [0, length)."""
        above = tree.infix(">=", index, Literal(INT, 0), BOOL)
        return tree.infix("&&", above, tree.infix("<", index, Literal(INT, length), BOOL))
