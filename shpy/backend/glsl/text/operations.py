"""Operations as GLSL has them.

Stage: emit. What GLSL does in its own way:

- `precise` keeps the order of operations and stops contraction; it belongs to variables;
- a literal zero would be folded all the same (`0.0 * x` is 0 to Mesa, NaN or not), so zeros that take part in
  arithmetic are a global that the driver does not know; `passes/hide.py` adds it to what the driver could derive;
- a shift by 32 or more is undefined: what is not known to be less is masked.

    mul %x, 0  ->  x * zero            lt %v, %w  ->  lessThan(v, w)            shr %u, %n  ->  u >> (n & 31u)
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np

from shpy.backend.emit import tree
from shpy.backend.emit.entry import Unit
from shpy.backend.emit.operations import COMPARISONS, Operations
from shpy.backend.emit.tree import BOOL, INT, Cast, Construct, Expr, Index, Literal, Name, number
from shpy.backend.glsl.text.exactness import choices_and_arguments, precise_conditions, precise_operands
from shpy.backend.glsl.text.interface import GRID_SHAPE, NOTHING, RUNNING, Limits, TableTexture
from shpy.backend.glsl.text.prologue import KEEP, ROOT, SPLIT, grid_function, grid_name, reader
from shpy.ir.constants import DTYPES
from shpy.ir.nodes import Function, Let, Loop, Module
from shpy.ir.ops import TRANSCENDENTALS
from shpy.ir.types import Base, Type, vec
from shpy.passes.formulas.edges import componentwise, edge, remark
from shpy.passes.nesting import is_shelter, sheltered_functions

NATIVE: Final = frozenset({"clamp"})
"""Composite operations that are one call here, with exactly the table's meaning."""

GEOMETRIC: Final = frozenset({"dot", "length", "distance", "normalize", "cross", "reflect", "refract", "faceforward"})
_LACKING: Final = frozenset("hypot log10 expm1 log1p cbrt erf erfc exp10 sinpi cospi".split())
FAST: Final = (TRANSCENDENTALS - _LACKING) | GEOMETRIC
"""Operations that are one call here, but GLSL says too little of how exact they are and of their edges."""

_ORDERED: Final = frozenset({"lt", "le", "gt", "ge"})
"""Comparisons that NVIDIA's compiler negates: it takes `!(a < b)` for `a >= b`, also where one is NaN.

Mesa 26.1 takes `(a >= b ? a : b) * c` for a product with the maximum, also where a and b are zeros of two signs.
"""

# The functions of GLSL that do what the table says; those of FAST come here in fast mode alone.
_OWN: Final[Mapping[str, str]] = {
    "abs": "abs",
    "floor": "floor",
    "ceil": "ceil",
    "round": "roundEven",
    "trunc": "trunc",
    "sqrt": "sqrt",
    "any": "any",
    "all": "all",
    "float_from_bits": "uintBitsToFloat",
    **{name: name for name in FAST},
    "atan2": "atan",
    "rsqrt": "inversesqrt",
}
_OWN_OF_INTS: Final = frozenset({"min", "max", "clamp", "sign"})
_SHORT: Final[Mapping[str, str]] = {"bits_from_float": "sh_bits", "cond": "sh_select"}
"""Functions that are not called `sh_` and the operation's name."""
_TEXTS: Final[Mapping[str, str]] = {"keep": KEEP, "sqrt": ROOT, "split": SPLIT}
_GIVES: Final[Mapping[str, Base]] = {
    "bits_from_float": Base.U, "isnan": Base.B, "isinf": Base.B, "to_int": Base.I, "to_uint": Base.U,
}  # fmt: skip
_OF_VECTORS: Final[Mapping[str, str]] = {
    "eq": "equal",
    "ne": "notEqual",
    "lt": "lessThan",
    "le": "lessThanEqual",
    "gt": "greaterThan",
    "ge": "greaterThanEqual",
}
_LEAST: Final = -(1 << 31)
_FLOAT: Final = vec(Base.F)
_UINT: Final = vec(Base.U)
_ONE_ITERATION: Final = "one iteration: so that exits do not nest what follows them"


class GlslUnit(Unit):
    """One shader: names, prologue and limits of the device.

    `exact`: operations keep their order. `flagged`: loops tell whether they finished, for the device may stop them of
    its own accord; `limited`: loops without a known bound have a limit of ours. Functions that are `sheltered` stand in
    a loop of one iteration.
    """

    target = "glsl"

    def __init__(self, module: Module, limits: Limits, *, exact: bool, flagged: bool, limited: bool) -> None:
        super().__init__(module)
        self.limits, self.exact = limits, exact
        self.flagged, self.limited, self.sheltered = flagged, limited, sheltered_functions(module)
        self.leaves_loops = limits.leaves_loops
        self.hidden = _ORDERED if exact and not (limits.negates and limits.signs) else frozenset()
        self.prologue: dict[tuple[str, tuple[Type, ...]], str] = {}
        """The functions that GLSL lacks, in the order of their first use."""
        self.globals.reserve("main")
        self.zero = Name(_FLOAT, self.globals.take("zero"))
        take = self.globals.take
        self.params = {p.name: Name(p.type, take(p.name)) for p in module.params}
        self.tables: dict[str, TableTexture] = {}
        self.readers: dict[str, str] = {}
        for t in module.tables:
            self.tables[t.name] = TableTexture(t.name, t.type, t.rank, take(t.name), take(f"{t.name}_shape"))
            self.readers[t.name] = take(f"{t.name}_at")
        self.functions = {f.name: take(f.name) for f in module.functions}
        self.read: dict[str, str] = {}
        """The functions that read tables, and those that find a place in the grid."""
        self.placed: dict[int, str] = {}
        self.used: set[str] = set()
        """Names of the runtime, and that of the unknown zero, as far as the text has them."""

    def runtime_name(self, name: str, type: Type) -> Name:
        """Use a name that the runtime gives a value."""
        self.used.add(name)
        self.globals.reserve(name)
        return Name(type, name)

    def zero_name(self) -> Name:
        """Use the zero that the driver does not know."""
        self.used.add(self.zero.text)
        return self.zero

    def edge(self, op: str, *types: Type) -> str:
        """Use a function that computes `op` for arguments of these types, vectors by component; return its name."""
        name = _SHORT.get(op, f"sh_{op}")
        if (op, types) not in self.prologue:
            self.prologue[op, types] = self._edge_text(op, types, name)
        return name

    def _edge_text(self, op: str, types: tuple[Type, ...], name: str) -> str:
        if max(t.size for t in types) > 1:
            model = types[-1] if op == "cond" else types[0]
            return self.printed(componentwise(op, types, _GIVES.get(op, model.base)), name)
        if op == "keep":
            self.used.add(NOTHING)
        text = _TEXTS.get(op)
        return remark(op) + self.printed(edge(op, types), name) if text is None else text

    @abstractmethod
    def printed(self, function: Function, name: str) -> str:
        """Return the text of a function that the shader is to have."""

    def read_table(self, name: str) -> str:
        """Name the function that reads a table, which the text is to have."""
        if name not in self.read:
            self.read[name] = reader(self.tables[name], self.readers[name])
        return self.readers[name]

    def place(self, size: int) -> str:
        """Name the function that gives the place in the grid on `size` axes, which the text is to have."""
        if size not in self.placed:
            if size > 1:
                self.edge("split", INT)
            self.placed[size], names = grid_function(size)
            self.used |= names
        return grid_name(size)


class GlslOperations(Operations):
    """The operations of one function."""

    unit: GlslUnit
    returns_expressions: ClassVar[bool] = False
    """A result is returned in a variable, for `precise` belongs to variables."""

    # Literals and conversions

    def literal(self, type: Type, component: float | int | bool) -> Expr:
        """Return a number; a float zero is the global that the driver does not know."""
        if type.is_float and self.unit.exact and DTYPES[type.base](component) == 0:
            zero: Expr = self.unit.zero_name()
            zero = zero if type.base is Base.F else Cast(type, zero)
            return tree.prefix("-", zero) if np.signbit(component) else zero
        return Literal(type, component)

    def _known_zero(self, e: Expr) -> Expr:
        """Return a literal zero for the unknown one: in comparisons that is the same."""
        if e.splat == self.unit.zero:
            return Construct(e.type, (Literal(_FLOAT, 0.0),))
        return Literal(_FLOAT, 0.0) if e == self.unit.zero else e

    def convert(self, type: Type, e: Expr, source: Type) -> Expr:
        """Return `float(i)`; floats become ints by a function that saturates."""
        unit = self.unit
        if type.is_bool:
            zero = Literal(source.scalar, 0)
            if source.size == 1:
                return tree.infix("!=", e, zero, type)
            return tree.call("notEqual", type, e, Construct(source, (zero,)))
        if source.is_float and type.is_int:
            return tree.call(unit.edge("to_int" if type.base is Base.I else "to_uint", source), type, e)
        if source.is_bool and type.is_float and unit.exact:
            # Mesa replaces a product by a choice where it knows a factor to be 0 or 1, although 0 * inf is NaN.
            one, unknown = Literal(_FLOAT, 1.0), unit.zero_name()
            if type.size == 1:
                return tree.choice(e, one, unknown)
            return tree.call("mix", type, Construct(type, (unknown,)), Construct(type, (one,)), e)
        return Cast(type, e)

    # Operations

    def need_names(self, inlined: set[int]) -> Collection[int]:
        """Return the conditions on floats, and other values whose order the compiler would change."""
        if not self.unit.exact:
            return ()
        unit, least = self.unit, 2
        conditions = precise_conditions(self.function, unit.callees)
        if not unit.limits.chooses:
            conditions |= inlined & choices_and_arguments(self.function)
            least = 1
        return conditions | precise_operands(self.function, inlined - conditions, unit.callees, least, unit.hidden)

    def operation(self, let: Let) -> Expr:
        """Return the expression of one Let; `sh_keep(a < b)` where the driver derives other conditions from it."""
        expression, type = super().operation(let), let.value.type
        if let.op in self.unit.hidden and self.types[let.args[0]].is_float:
            return tree.call(self.unit.edge("keep", type), type, expression)
        return expression

    def function_of(self, op: str, types: tuple[Type, ...]) -> str:
        """Name GLSL's function, or one of the prologue."""
        if op in _OWN and (op != "sqrt" or self.unit.limits.roots or types[0].base is not Base.D):
            return _OWN[op]
        if op == "fma" or (op in _OWN_OF_INTS and not types[0].is_float):
            return op
        return self.unit.edge(op, *types)

    def infix(self, let: Let) -> Expr:
        """Return `a + b`; GLSL has no operators of vectors of bools, and shifts by less than 32 alone."""
        type = let.value.type
        if type.is_bool and type.size > 1:
            return self.plain_call(let)
        expression = super().infix(let)
        if (
            let.op in ("shl", "shr")
            and isinstance(expression, tree.Operator)
            and not self.ranges.within(let.args[1], 0, 31)
        ):
            a, b = expression.args
            return replace(expression, args=(a, tree.infix("&", b, number(31, b.type.scalar))))
        return expression

    def comparison(self, let: Let) -> Expr:
        """Return `a < b`, `lessThan(a, b)` of vectors."""
        a, b = map(self._known_zero, self.args(let))
        if self.types[let.args[0]].size > 1:
            return tree.call(_OF_VECTORS[let.op], let.value.type, a, b)
        return tree.infix(COMPARISONS[let.op], a, b, let.value.type)

    def op_abs(self, let: Let) -> Expr:
        """Return `abs(a)`; `sh_abs(a)` of an int that may be the least, and a uint is its own."""
        type, arg = let.value.type, let.args[0]
        if type.base is Base.I and self.ranges.span(arg)[0] == _LEAST:
            return tree.call(self.unit.edge("abs", type), type, self.arg(arg))
        return self.arg(arg) if type.base is Base.U else self.plain_call(let)

    def op_fma(self, let: Let) -> Expr:
        """Return `fma(a, b, c)`; `a * b + c` where GLSL has none, which is a device that compiles fast mode alone."""
        if self.unit.limits.keeps_order:
            return self.plain_call(let)
        a, b, c = self.args(let)
        return tree.infix("+", tree.infix("*", a, b), c)

    def op_clamp(self, let: Let) -> Expr:
        """Return `clamp(i, 0, 7)`; `min(max(i, low), high)` of ints whose bounds may cross, where it is undefined."""
        type, (_, low, high) = let.value.type, let.args
        if type.is_float or self.ranges.span(low)[1] <= self.ranges.span(high)[0]:
            return self.plain_call(let)
        n, low_of, high_of = self.args(let)
        return tree.call("min", type, tree.call("max", type, n, low_of), high_of)

    def op_sign(self, let: Let) -> Expr:
        """Return the sign; of a uint it is 0 or 1."""
        if let.value.type.base is not Base.U:
            return self.plain_call(let)
        return tree.call("min", let.value.type, *self.args(let), Literal(vec(Base.U), 1))

    def choose(self, type: Type, c: Expr, a: Expr, b: Expr) -> Expr:
        """Return `mix(b, a, c)`, which GLSL has for floats alone."""
        if type.is_float:
            return tree.call("mix", type, b, a, c)
        return tree.call(self.unit.edge("cond", type.based(Base.B), type, type), type, c, a, b)

    def not_vector(self, e: Expr) -> Expr:
        """Return `not(e)`."""
        return tree.call("not", e.type, e)

    def op_component(self, let: Let) -> Expr:
        """Return `v[clamp(i, 0, 2)]`."""
        vector, index = self.args(let)
        size = self.types[let.args[0]].size
        return vector if size == 1 else Index(let.value.type, vector, self.in_range(index, size))

    def in_range(self, index: Expr, length: int) -> Expr:
        """Return `clamp(i, 0, 7)`."""
        return tree.call("clamp", index.type, index, number(0), number(length - 1))

    # What definitions are made of

    def op_rem(self, let: Let) -> Expr:
        """Return `a - a / b * b` of ints, because drivers' own % is unsigned."""
        a, b = self.args(let)
        return tree.infix("-", a, tree.infix("*", tree.infix("/", a, b), b))

    def op_bitcast(self, let: Let) -> Expr:
        """Return `floatBitsToUint(x)`."""
        name = "uintBitsToFloat" if let.value.type.is_float else "floatBitsToUint"
        return tree.call(name, let.value.type, *self.args(let))

    def op_whole(self, let: Let) -> Expr:
        """Return `int(x)`."""
        return Cast(let.value.type, self.arg(let.args[0]))

    # What the runtime gives

    def op_param(self, let: Let) -> Expr:
        """Return a uniform."""
        return self.unit.params[str(let.attr)]

    def op_table(self, let: Let) -> Expr:
        """Return `heights_at(i)`."""
        return tree.call(self.unit.read_table(str(let.attr)), let.value.type, *self.args(let))

    def op_table_size(self, let: Let) -> Expr:
        """Return the uniform of a table's shape."""
        return Name(let.value.type, self.unit.tables[str(let.attr)].shape)

    def op_grid_index(self, let: Let) -> Expr:
        """Return `sh_grid_index2()`."""
        return tree.call(self.unit.place(let.value.type.size), let.value.type)

    def op_grid_shape(self, let: Let) -> Expr:
        """Return `sh_grid_shape.xy`."""
        whole = self.unit.runtime_name(GRID_SHAPE, vec(Base.I, 4))
        return tree.picked(whole, range(let.value.type.size), let.value.type)

    # Statements

    def shelter(self, loop: tree.Loop) -> tree.Loop:
        """Return a loop of one iteration with an end that the compiler cannot derive.

        Mesa 22 takes a loop apart that ends in an exit, and Mesa 26 also where its test tells that it does.
        """
        running, (*body, last) = self.unit.runtime_name(RUNNING, BOOL), loop.body
        nothing = tree.infix("==", self.unit.runtime_name(NOTHING, _UINT), Literal(_UINT, 0), BOOL)
        test = running if loop.test is None else tree.infix("&&", loop.test, running)
        return replace(loop, body=(*body, tree.If(nothing, (last,))), test=test, note=_ONE_ITERATION)

    def unknown_zero(self, type: Type) -> Expr | None:
        """Return the global; None for floats that are hidden already, as all are but in fast mode (passes/hide.py)."""
        if type.is_int:
            return Cast(type.scalar, self.unit.zero_name())
        return self.unit.zero_name() if type.is_float and not self.unit.exact else None

    def looped(self, s: Loop, loop: tree.Loop) -> tree.Loop:
        """Return a loop with an end that the compiler cannot rule out, if the device may stop it.

        Without one the compiler concludes that what follows the loop is reached through `ended = true` alone. A limit
        is such an end. It stands at the start of an iteration: llvmpipe of Mesa 22 goes on computing the values of
        elements that have left a loop, unless a second way leads out of it that passes by these values.
        """
        unit = self.unit
        if is_shelter(s):
            return self.shelter(loop)
        if not unit.flagged or s.turns == 1 or (unit.limited and s.turns is None):
            return loop
        running = unit.runtime_name(RUNNING, BOOL)
        if loop.again is not None:
            return replace(loop, body=(tree.If(tree.negation(running), (tree.Exit("break"),)), *loop.body))
        return replace(loop, test=running if loop.test is None else tree.infix("&&", loop.test, running))
