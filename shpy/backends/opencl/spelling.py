"""OpenCL C's types, literals and operations: how the hooks of the C-like printer are filled in.

Stage: emit. What OpenCL C does in its own way:

- a vector of bools is a vector of ints, -1 for true; one bool is a bool;
- signed ints wrap, which C does not promise: scalar `a + b` is computed as `a + 1u` or `a + (uint)b`, vectors through
  `as_uint3`;
- vectors of three are packed in memory (`vload3`, `vstore3`), those of two and four are OpenCL's own.

    add %i, 1  ->  i + 1u            lt %v, %w  ->  v < w            swizzle.x %mask  ->  mask.x != 0
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Final

import numpy as np

from shpy.backends import expressions as ex
from shpy.backends.clike import CLike
from shpy.backends.emit.names import Target
from shpy.backends.expressions import Expr, Level
from shpy.backends.opencl.text.operations import ELEMENTWISE, FAST, FUNCTIONS, NATIVE
from shpy.backends.opencl.text.prologue import NAN_LOST, Prologue, spelled
from shpy.backends.operations import INFIX
from shpy.errors import CompileError
from shpy.ir.nodes import Function, Let, Module, Table, Variable
from shpy.ir.types import Base, Type
from shpy.passes.known import Known
from shpy.passes.modes import Math

_WRAPPING: Final = frozenset({"add", "sub", "mul"})


class Spelling(CLike):
    """The operations. What the kernel calls its tables and the grid is told by `OpenCLPrinter`."""

    target: Target = "opencl"
    scalar_comparisons: ClassVar[bool] = True
    hides_zeros = False
    """True if the compiler must not know of a float that it is zero."""
    elementwise = False
    """True if the compiler has the functions of ELEMENTWISE."""
    inputs_are_variables: ClassVar[bool] = True

    def __init__(self, module: Module, math: Math = "strict") -> None:
        super().__init__(module)
        self.math = math
        self.prologue = Prologue()
        self.doubles = False
        self.element = self.globals.take("element")
        self.tables: dict[str, Table] = {t.name: t for t in module.tables}
        self.table_names: dict[str, str] = {}
        self.size_names: dict[str, str] = {}
        self.grid_names: dict[str, str] = {}
        self.grid_rank = 0

    def begin(self, function: Function) -> None:
        """What is known of its values spares checks."""
        super().begin(function)
        self.known = Known(function)

    # Types, literals, vectors

    def type_name(self, type: Type) -> str:
        """`float3`."""
        if type.base is Base.H:
            raise CompileError("OpenCL kernels hold no binary16")
        self.doubles = self.doubles or type.base is Base.D
        return spelled(type)

    def literal(self, type: Type, component: float | int | bool) -> Expr:
        """`0.1f`, `3`, `4u`, `true`; a double without a suffix."""
        if type.base is Base.B:
            return Expr("true" if component else "false")
        if type.base is Base.I and component == -(2**31):
            return Expr("(-2147483647 - 1)")
        text = f"{component}u" if type.base is Base.U else str(component)
        if type.is_float:
            self.doubles = self.doubles or type.base is Base.D
            if self.hides_zeros and component == 0:
                zero = Expr(f"{self.prologue.use('zero', type.scalar)}()", Level.POSTFIX)
                return ex.prefix("-", zero) if np.signbit(component) else zero
            if self.math == "strict" and component == 0 and np.signbit(component):
                return Expr(f"{self.prologue.use('minus_zero', type.scalar)}()", Level.POSTFIX)
            text = _float_text(float(component), type.base)
        return Expr(text, Level.UNARY if text[0] in "-(" else Level.ATOM)

    def construct(self, type: Type, parts: list[Expr], types: list[Type]) -> Expr:
        """`(float3)(a, b)`."""
        if type.is_bool:
            parts = [self.component(e, t) if t.size == 1 else e for e, t in zip(parts, types, strict=True)]
        made = ex.call(f"({self.type_name(type)})", *parts)
        return replace(made, level=Level.UNARY)

    def op_construct(self, let: Let) -> Expr:
        """Components convert by themselves, from uint to int too."""
        types = [self.types[a] for a in let.args]
        parts = [self.take(a) for a in let.args]
        return parts[0] if types[0] is let.value.type else self.construct(let.value.type, parts, types)

    def component(self, e: Expr, type: Type) -> Expr:
        """A bool as a component is -1 or 0."""
        if not type.is_bool:
            return e
        fixed = {"true": Expr("-1", Level.UNARY), "false": Expr("0")}
        return fixed.get(e.text) or ex.prefix("-", e)

    def picked(self, e: Expr, components: tuple[int, ...], type: Type) -> Expr:
        """`v.xy`; one component of a vector of bools is made a bool."""
        made = super().picked(e, components, type)
        return as_bool(made) if type.is_bool and type.size == 1 else made

    def op_component(self, let: Let) -> Expr:
        """The component at a run-time index."""
        made = ex.call(self.prologue.use("component", self.types[let.args[0]]), *self.args(let))
        return as_bool(made) if let.value.type.is_bool else made

    def declare_array(self, variable: Variable, name: str) -> str:
        """`float a[8] = {0.0f};`."""
        return f"{self.declaration(variable.type, f'{name}[{variable.length}]')} = {{{self.zero(variable.type).text}}};"

    def in_range(self, index: Expr, length: int) -> Expr:
        """`sh_at(i, 8)`."""
        return ex.call(self.prologue.flat_index(1), index, Expr(str(length)))

    # Operations

    def function(self, op: str, types: tuple[Type, ...]) -> str:
        """OpenCL's function, or one of the prologue."""
        if self.math == "fast" and op in FAST | NATIVE.keys():
            return NATIVE[op] if types[0].base is Base.F else op
        if self.math == "fast" and (op == "ldexp" or op in NAN_LOST):
            return op
        if op in ELEMENTWISE and self.elementwise:
            return f"__builtin_elementwise_{ELEMENTWISE[op]}"
        if op in FUNCTIONS and not self.prologue.wants(op, types[0]):
            return FUNCTIONS[op]
        if op in ("min", "max") and types[0].is_int:
            return op
        return self.prologue.use(op, types[0])

    def infix(self, let: Let) -> Expr:
        """Ints wrap: one operand at least is made a uint."""
        type = let.value.type
        if type.base is Base.I and let.op in _WRAPPING:
            a, b = (self.take(v) for v in let.args)
            return self._wrapping(let.op, a, b) if type.size == 1 else self._wrapping_vector(let.op, type, a, b)
        return super().infix(let)

    def _wrapping(self, op: str, a: Expr, b: Expr) -> Expr:
        if op == "add" and b.text.startswith("-") and b.text[1:].isdigit():
            op, b = "sub", Expr(b.text[1:])
        if b.text.isdigit():
            b = Expr(b.text + "u")
        elif a.text.isdigit():
            a = Expr(a.text + "u")
        elif not a.unsigned and not b.unsigned:
            b = ex.cast("uint", b)
        return replace(ex.infix(*INFIX[op], a, b), unsigned=True)

    def _wrapping_vector(self, op: str, type: Type, a: Expr, b: Expr) -> Expr:
        def unsigned(e: Expr) -> Expr:
            return ex.cast("uint", e.scalar) if e.scalar is not None else ex.call(f"as_uint{type.size}", e)

        if a.scalar is not None and b.scalar is not None:
            a = replace(a, scalar=None)
        return ex.call(f"as_int{type.size}", ex.infix(*INFIX[op], unsigned(a), unsigned(b)))

    def signed(self, e: Expr) -> Expr:
        """`(int)(a + 1u)`."""
        return ex.cast("int", e) if e.unsigned else e

    def op_neg(self, let: Let) -> Expr:
        """`-a`; of an int `0u - a`, which wraps."""
        type = let.value.type
        if type.base is not Base.I:
            return super().op_neg(let)
        if type.size == 1:
            return replace(ex.infix("-", Level.ADD, Expr("0u"), self.take(let.args[0])), unsigned=True)
        (e,) = self.args(let)
        return ex.call(f"as_int{type.size}", ex.prefix("-", ex.call(f"as_uint{type.size}", e)))

    def op_abs(self, let: Let) -> Expr:
        """`fabs(a)`; of an int `sh_abs_i(a)`: OpenCL's is a uint, which compilers take for a positive int."""
        (e,) = self.args(let)
        type = let.value.type
        if type.base is Base.U:
            return e
        return ex.call("fabs" if type.is_float else self.prologue.use("abs", type), e)

    def op_sign(self, let: Let) -> Expr:
        """OpenCL's `sign` gives 0 for a NaN, but -0 for -0."""
        (e,) = self.args(let)
        type = let.value.type
        if type.is_float:
            return ex.infix("+", Level.ADD, ex.call("sign", e), self.literal(type.scalar, 0.0))
        if type.base is Base.U:
            return ex.call("min", e, self._each(type, "1u"))
        return ex.call("clamp", e, self._each(type, "-1"), self._each(type, "1"))

    def _each(self, type: Type, number: str) -> Expr:
        """The number, for each component: Oclgrind takes a scalar bound for the first component alone."""
        one = Expr(number)
        return one if type.size == 1 else self.construct(type, [one], [type.scalar])

    def repeated(self, scalar: Expr, type: Type) -> Expr:
        """A bool is -1 or 0 beside a vector of bools."""
        return self.component(scalar, type)

    def comparison(self, let: Let) -> Expr:
        """Vectors of doubles compare to longs."""
        made = super().comparison(let)
        return self._narrow_mask(made, self.types[let.args[0]])

    def _narrow_mask(self, e: Expr, type: Type) -> Expr:
        return ex.call(f"convert_int{type.size}", e) if type.base is Base.D and type.size > 1 else e

    def op_isnan(self, let: Let) -> Expr:
        """`isnan(a)`."""
        return self._narrow_mask(self.plain_call(let), self.types[let.args[0]])

    op_isinf = op_isnan

    def choose(self, type: Type, c: Expr, a: Expr, b: Expr) -> Expr:
        """`c ? a : b` by the sign bits of c, which is as wide as a."""
        wide = ex.call(f"convert_long{type.size}", c) if type.base is Base.D else c
        return ex.ternary(wide, a, b)

    def op_bits_from_float(self, let: Let) -> Expr:
        """The bits; of a double those of the nearest float."""
        (e,) = self.args(let)
        type = self.types[let.args[0]]
        narrow = type.based(Base.F)
        if type is not narrow:
            e = self.convert(narrow, e, type)
        return ex.call(self.prologue.use("bits_from_float", narrow), e)

    def op_float_from_bits(self, let: Let) -> Expr:
        """`as_float(u)`."""
        return ex.call(f"as_{self.type_name(let.value.type)}", *self.args(let))

    def convert(self, type: Type, e: Expr, source: Type) -> Expr:
        """`(float)i`, `convert_int_sat(x)`; vectors by OpenCL's functions."""
        name = self.type_name(type)
        if source.is_bool and source.size > 1:
            e = ex.prefix("-", e)
            source = source.based(Base.I)
            if type.base is Base.I:
                return e
        if type.is_bool:
            made = ex.comparison("!=", e, self.literal(source.scalar, 0), ordered=not source.is_float)
            return self._narrow_mask(replace(made, inverse=None), source) if type.size > 1 else made
        if type.is_int and source.is_float:
            return ex.call(f"convert_{name}_sat", e)
        if type.is_int and source.is_int and type.size > 1:
            return ex.call(f"as_{name}", e)
        return ex.cast(name, e) if type.size == 1 else ex.call(f"convert_{name}", e)

    # Tables and the grid

    def op_table(self, let: Let) -> Expr:
        """An index that is in range anyway is taken as it is."""
        table = self.tables[str(let.attr)]
        (index,) = let.args
        if table.rank == 1 and table.size is not None:
            low, high = self.known.span(index)
            if low >= 0 and high < table.size[0]:
                return self.read(ex.name(self.table_names[table.name]), self.take(index), let.value.type)
        return super().op_table(let)

    def table(self, name: str, type: Type, index: Expr) -> Expr:
        """`noise[sh_at(i, noise_size)]`."""
        size = Expr(self.size_names[name])
        index = ex.call(self.prologue.flat_index(self.tables[name].rank), index, size)
        return self.read(ex.name(self.table_names[name]), index, type)

    def table_size(self, name: str) -> Expr:
        """Its argument."""
        return ex.name(self.size_names[name])

    def grid(self, op: str, type: Type) -> Expr:
        """A variable of the kernel."""
        if type.size != self.grid_rank:
            raise CompileError(f"grid_index and grid_shape are used with {self.grid_rank} and {type.size} axes at once")
        return ex.name(self.grid_names[op])

    def pointer(self, type: Type, qualifier: str = "") -> str:
        """The type of a pointer to an array of `type`."""
        if type.is_bool:
            name = "uchar" if type.size in (1, 3) else f"uchar{type.size}"
        else:
            name = self.type_name(type.scalar if type.size == 3 else type)
        return f"__global {qualifier}{name} *"

    def read(self, array: Expr, index: Expr, type: Type) -> Expr:
        """An element of an array in memory."""
        made = ex.call("vload3", index, array) if type.size == 3 else ex.element(array, index)
        if type.is_bool:
            made = as_bool(made if type.size == 1 else ex.call(f"convert_int{type.size}", made))
        return made

    def write(self, array: str, e: Expr, type: Type) -> str:
        """The statement that stores this work item's element of an array."""
        if type.is_bool and type.size > 1:
            e = ex.call(f"convert_uchar{type.size}", ex.prefix("-", e))
        if type.size == 3:
            return f"vstore3({e.text}, {self.element}, {array});"
        return f"{array}[{self.element}] = {e.text};"


def as_bool(e: Expr) -> Expr:
    """`e != 0`."""
    return ex.comparison("!=", e, Expr("0"), ordered=True)


def _float_text(x: float, base: Base) -> str:
    """The shortest text that reads back as the same number."""
    if x != x:
        return "NAN" if base is Base.F else "(double)NAN"
    if x in (float("inf"), float("-inf")):
        sign = "-" if x < 0 else ""
        return f"{sign}INFINITY" if base is Base.F else f"({sign}(double)INFINITY)"
    return f"{np.float32(x)!s}f" if base is Base.F else repr(x)
