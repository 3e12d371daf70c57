"""GLSL's types, literals and operations: how the hooks of the C-like printer are filled in.

Stage: emit. What GLSL does in its own way:

- `precise` keeps the order of operations and stops contraction; it belongs to variables;
- a literal zero would be folded all the same (`0.0 * x` is 0 to Mesa, NaN or not), so zeros that take part in
  arithmetic are a global that the driver does not know; `passes/hide.py` adds it to what the driver could derive;
- a shift by 32 or more is undefined: what is not known to be less is masked.

    mul %x, 0  ->  x * zero            lt %v, %w  ->  lessThan(v, w)            shr %u, %n  ->  u >> (n & 31u)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from shpy.backends import expressions as ex
from shpy.backends.clike import CLike
from shpy.backends.emit.names import Target
from shpy.backends.expressions import Expr, Level
from shpy.backends.glsl.prologue import Prologue, spelled
from shpy.backends.operations import COMPARISONS
from shpy.backends.statements import assignment, constant_index
from shpy.ir.nodes import Function, Let, Module, Store, Variable
from shpy.ir.ops import TRANSCENDENTALS
from shpy.ir.types import Base, Type
from shpy.passes.known import Known

NATIVE: Final = frozenset({"clamp"})
"""Composite operations that are one call here, with exactly the table's meaning."""

GEOMETRIC: Final = frozenset({"dot", "length", "distance", "normalize", "cross", "reflect", "refract", "faceforward"})
FAST: Final = (TRANSCENDENTALS - {"log10"}) | GEOMETRIC | {"rsqrt"}
"""Operations that are one call here, but GLSL says too little of how exact they are and of their edges."""

_WRITTEN_OUT: Final = 16
_KEPT: Final = frozenset({"add", "sub", "mul", "div", "sqrt", "neg"})
"""Operations that drivers combine with others: Mesa takes `sqrt(x) * sqrt(x)` for x, and `x + -x` for 0."""

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
_HELPERS: Final[Mapping[str, str]] = {"bits_from_float": "sh_bits"}
_OF_VECTORS: Final[Mapping[str, str]] = {
    "eq": "equal",
    "ne": "notEqual",
    "lt": "lessThan",
    "le": "lessThanEqual",
    "gt": "greaterThan",
    "ge": "greaterThanEqual",
}


class Spelling(CLike):
    """The operations. Where tables and the grid are found is told by `Printer`."""

    target: Target = "glsl"
    inputs_are_variables = True

    def __init__(
        self,
        module: Module,
        *,
        exact: bool = True,
        precise: bool = True,
        fuses: bool = False,
        stores_apart: bool = True,
    ) -> None:
        """`exact` says that operations keep their order; without `precise`, by hiding each result from the driver.

        `fuses`: the device's own `fma` rounds once; `stores_apart`: it stores where each element's own index says.
        """
        super().__init__(module)
        self.fuses = fuses
        self.stores_apart = stores_apart
        self.exact = exact
        self.kept_apart = exact and not precise
        self.prologue = Prologue(exact=exact, precise=precise)
        self.globals.reserve("main")
        self.zero_name = self.globals.take("zero")

    def begin(self, function: Function) -> None:
        """What is known of its values spares masks."""
        super().begin(function)
        self.known = Known(function)

    # Declarations

    def declaration(self, type: Type, name: str, passed: str = "") -> str:
        """`precise float x`; how a parameter is passed comes after `precise`, as it must before GLSL 4.20."""
        precise = "precise " if self.exact and (type.is_float or type.is_bool) else ""
        return f"{precise}{passed}{spelled(type)} {name}"

    def declare_array(self, variable: Variable, name: str) -> str:
        """An array of zeros: written out where it is short."""
        assert variable.length is not None
        declared = f"{self.declaration(variable.type, name)}[{variable.length}]"
        zero = self.zero(variable.type).text
        if variable.length <= _WRITTEN_OUT:
            zeros = ", ".join([zero] * variable.length)
            return f"{declared} = {spelled(variable.type)}[{variable.length}]({zeros});"
        return f"{declared}; for (int sh_i = 0; sh_i < {variable.length}; sh_i++) {{ {name}[sh_i] = {zero}; }}"

    # Types, literals, constructors

    def type_name(self, type: Type) -> str:
        """`vec3`."""
        return spelled(type)

    def literal(self, type: Type, component: float | int | bool) -> Expr:
        """One number; a float zero is the global that the driver does not know."""
        if type.is_bool:
            return Expr("true" if component else "false")
        if type.base is Base.U:
            return Expr(f"{component}u")
        if type.is_int:
            return _signed(str(component)) if component != -(2**31) else Expr("(-2147483647 - 1)")
        rounded = np.float32(component)
        if rounded == 0 and self.exact:
            return Expr(f"-{self.zero_name}", Level.UNARY) if np.signbit(rounded) else Expr(self.zero_name)
        if not np.isfinite(rounded) or 0 < abs(rounded) < np.finfo(np.float32).tiny:
            return Expr(f"uintBitsToFloat(0x{rounded.view(np.uint32):08x}u)")
        return _signed(str(rounded))

    def known_zero(self, e: Expr) -> Expr:
        """The expression with a literal zero where it was the unknown one: in comparisons that is the same."""
        if e.text == self.zero_name:
            return replace(e, text="0.0")
        if e.scalar is not None and e.scalar.text == self.zero_name:
            return replace(e, text=e.text.replace(self.zero_name, "0.0"), scalar=self.known_zero(e.scalar))
        return e

    def construct(self, type: Type, parts: list[Expr], types: list[Type]) -> Expr:
        """`vec3(a, b)`."""
        return ex.call(spelled(type), *parts)

    def convert(self, type: Type, e: Expr, source: Type) -> Expr:
        """`float(i)`; floats to ints by a helper, for it saturates."""
        if type.is_bool:
            return self._nonzero(e, source)
        if source.is_float and type.is_int:
            name = "sh_int" if type.base is Base.I else "sh_uint"
            return ex.call(self.prologue.use(name, (source,)), e)
        if source.is_bool and type.is_float and self.exact:
            return self._one_or_zero(type, e)
        return ex.call(spelled(type), e)

    def _one_or_zero(self, type: Type, e: Expr) -> Expr:
        """`b ? 1.0 : zero`: Mesa makes products with what it knows to be 0 or 1 choices, although 0 * inf is NaN."""
        if type.size == 1:
            return ex.ternary(e, Expr("1.0"), Expr(self.zero_name))
        name = spelled(type)
        return ex.call("mix", Expr(f"{name}({self.zero_name})"), Expr(f"{name}(1.0)"), e)

    def _nonzero(self, e: Expr, source: Type) -> Expr:
        zero = {Base.F: "0.0", Base.I: "0", Base.U: "0u"}[source.base]
        if source.size == 1:
            return ex.comparison("!=", e, Expr(zero), ordered=source.is_int)
        return ex.call("notEqual", e, Expr(f"{spelled(source)}({zero})"))

    # Operations

    def operation(self, let: Let) -> Expr:
        """The expression of one Let; where nothing is `precise`, `sh_keep(a + b)` keeps it apart from others."""
        made = super().operation(let)
        if not self.kept_apart or not let.args or not self.types[let.args[0]].is_float:
            return made
        type = let.value.type
        if let.op in _KEPT or let.op in COMPARISONS:
            return ex.call(self.prologue.use("sh_keep", (type,)), made)
        return made

    def args(self, let: Let) -> list[Expr]:
        """The arguments; where nothing is `precise`, what a difference takes away is hidden, and what divides itself.

        The driver finds equal numbers that the IR does not show, as components of vectors and where it inlines calls,
        and takes `x - x` for 0, although NaN and infinity give NaN.
        """
        found = super().args(let)
        if not self.kept_apart or let.op not in ("sub", "div") or not self.types[let.args[0]].is_float:
            return found
        if let.args[0] == let.args[1] or (let.op == "sub" and found[1].reads):
            found[1] = ex.call(self.prologue.use("sh_apart", (self.types[let.args[1]],)), found[1])
        return found

    def function(self, op: str, types: tuple[Type, ...]) -> str:
        """GLSL's function, or one of the prologue."""
        of_ints = not types[0].is_float and op in _OWN_OF_INTS
        if op in _OWN:
            return _OWN[op]
        if op == "fma" and self.fuses:
            return op
        return op if of_ints else self.prologue.use(_HELPERS.get(op, f"sh_{op}"), types)

    def infix(self, let: Let) -> Expr:
        """Operators; those that GLSL has not for vectors of bools by a helper."""
        type = let.value.type
        if type.is_bool and type.size > 1:
            return self.plain_call(let)
        if let.op not in ("shl", "shr"):
            return super().infix(let)
        left, right = self.args(let)
        left, right = self.without_splats(left, right, let.value.type, right_only=True)
        if not self.known.within(let.args[1], 0, 31):
            mask = "31u" if self.types[let.args[1]].base is Base.U else "31"
            right = ex.infix("&", Level.BIT_AND, right, Expr(mask))
        return ex.infix("<<" if let.op == "shl" else ">>", Level.SHIFT, left, right)

    def comparison(self, let: Let) -> Expr:
        """`a < b`, `lessThan(a, b)` of vectors."""
        if self.types[let.args[0]].size > 1:
            return ex.call(_OF_VECTORS[let.op], *map(self.known_zero, self.args(let)))
        left, right = map(self.known_zero, self.args(let))
        ordered = not self.types[let.args[0]].is_float
        return ex.comparison(COMPARISONS[let.op], left, right, ordered=ordered)

    def op_abs(self, let: Let) -> Expr:
        """GLSL has no abs of uints, which are their own."""
        return self.args(let)[0] if let.value.type.base is Base.U else self.plain_call(let)

    def op_sign(self, let: Let) -> Expr:
        """Nor a sign of uints: it is 0 or 1."""
        if let.value.type.base is not Base.U:
            return self.plain_call(let)
        return ex.call("min", *self.args(let), Expr("1u"))

    def op_cond(self, let: Let) -> Expr:
        """`c ? a : b` for one c, `mix` for one a component."""
        c, a, b = self.args(let)
        type = let.value.type
        if type.size == 1:
            return ex.ternary(c, a, b)
        if c.scalar is not None:
            return ex.ternary(c.scalar, a, b)
        if type.is_float:
            return ex.call("mix", b, a, c)
        return ex.call(self.prologue.use("sh_select", (type.based(Base.B), type, type)), c, a, b)

    def _store_element(self, s: Store, index: int, e: Expr) -> None:
        """A store into an array; at an index that is the same for all fragments, where a device knows no other."""
        if self.stores_apart or constant_index(self.simple(index)) is not None:
            super()._store_element(s, index, e)
            return
        self.settle([s.variable])
        at = self.simple(index)
        chosen = at.text if self.types[index].base is Base.I else f"int({at.text})"
        text = assignment(*self._part(s, ex.element(self.slots[s.variable], Expr("sh_i")), e))
        self.emit(f"for (int sh_i = 0; sh_i < {self.variables[s.variable].length}; sh_i++) {{", s.loc)
        with self.block():
            self.emit(f"if (sh_i == {chosen}) {{")
            with self.block():
                self.emit(text, s.loc)
            self.emit("}")
        self.emit("}")

    def not_vector(self, e: Expr) -> Expr:
        """`not(e)`."""
        return ex.call("not", e)

    def op_component(self, let: Let) -> Expr:
        """`v[clamp(i, 0, 2)]`."""
        vector, index = self.args(let)
        size = self.types[let.args[0]].size
        return vector if size == 1 else ex.element(vector, self.in_range(index, size))

    def in_range(self, index: Expr, length: int) -> Expr:
        """`clamp(i, 0, 7)`."""
        return ex.call("clamp", index, Expr("0"), Expr(str(length - 1)))


def _signed(text: str) -> Expr:
    return Expr(text, Level.UNARY if text.startswith("-") else Level.ATOM)
