"""The operations of OpenCL C.

Stage: emit. OpenCL C differs from the IR in these points:

- a vector of bools is a vector of ints, -1 for true; a single bool is a bool;
- signed ints wrap in the IR, but their overflow is undefined in C: scalar `a + b` is computed as a uint, whose type the
  tree records, and vectors are viewed as uints (`as_uint3`);
- vectors of three are packed in memory (`vload3`, `vstore3`); vectors of two and four are OpenCL's own.

    add %i, 1  ->  i + 1u            lt %v, %w  ->  v < w            swizzle.x %mask  ->  mask.x != 0
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np

from shpy.backend.emit import tree
from shpy.backend.emit.entry import Needs, Unit, needed_by, needs_of
from shpy.backend.emit.operations import INFIX, Operations
from shpy.backend.emit.tree import (
    BOOL,
    INT,
    UINT,
    Assign,
    Cast,
    Construct,
    Do,
    Expr,
    Index,
    Literal,
    Name,
    Operator,
    number,
)
from shpy.backend.opencl.text.addresses import steady_parts
from shpy.backend.opencl.text.prologue import BY_COMPONENT, NAN_LOST, Prologue, name_of, spelled
from shpy.errors import CompileError
from shpy.ir.nodes import Function, Let, Loc, Module, Variable
from shpy.ir.traverse import walk
from shpy.ir.types import WIDEST_PORT, Base, Type, vec
from shpy.passes.formulas.edges import componentwise, edge, remark
from shpy.passes.modes import REPRODUCIBLE, Math

FUNCTIONS: Final[Mapping[str, str]] = {
    **{
        op: op
        for op in (
            "floor ceil trunc sqrt fma isnan isinf popcount any all exp exp2 log log2 log10 sin cos tan asin acos atan "
            "sinh cosh tanh asinh acosh atanh expm1 log1p cbrt erf erfc exp10 sinpi cospi pow atan2 hypot rsqrt"
        ).split()
    },
    "count_leading_zeros": "clz",
    "round": "rint",
}
"""OpenCL C's functions by operation: they have the op table's meaning, transcendentals within relaxed mode's bounds."""

ELEMENTWISE: Final = {"floor": "floor", "ceil": "ceil", "trunc": "trunc", "round": "roundeven"}
"""Operations that Clang has as `__builtin_elementwise_floor` and so on.

PoCL compiles them to fewer instructions than OpenCL's own functions, whose result is garbage for a NaN that its
compiler derives, as in `floor(NAN - x)`.
"""

UNARY: Final = [
    *"floor ceil trunc".split(),
    "rint",
    *"sqrt rsqrt".split(),
    "fabs",
    *"sign exp exp2 log log2 log10 sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh".split(),
    *"expm1 log1p cbrt erf erfc exp10 sinpi cospi".split(),
]
"""OpenCL C's functions of one float that give a float."""

NATIVE: Final[Mapping[str, str]] = {
    op: f"native_{op}" for op in "sqrt rsqrt exp exp2 exp10 log log2 log10 sin cos tan".split()
}
"""Functions of binary32 that fast mode calls instead: OpenCL leaves their accuracy to the device."""

INDEX: Final = "grid_index"
LINE: Final = "grid_line"
SHAPE: Final = "grid_shape"
_WRAPPING: Final = frozenset({"add", "sub", "mul"})


def hides_zeros(math: Math, faults: Collection[str]) -> bool:
    """Return whether zeros of floats have to be hidden from a compiler with these faults."""
    return math != "fast" and "zeros" in faults


class ClUnit(Unit):
    """The state of one kernel: names, the prologue and the abilities of the compiler.

    `elementwise` tells whether the compiler has the functions of ELEMENTWISE; `faults` are its faults, of FAULTS.
    """

    target = "opencl"

    def __init__(self, module: Module, math: Math, *, elementwise: bool = False, faults: Collection[str] = ()) -> None:
        super().__init__(module)
        self.math, self.prologue = math, Prologue()
        self.elementwise, self.hides_zeros = elementwise, hides_zeros(math, faults)
        self.leaves_loops = "exits" not in faults
        self.tables = {t.name: t for t in module.tables}
        take = self.globals.take
        self.element, self.count, self.first = [Name(UINT, take(name)) for name in ("element", "count", "first")]
        self.needs = needs_of(module, self.needed)
        lets = (s for f in module.functions for s in walk(f.body) if isinstance(s, Let))
        self.grid_rank = max(map(self.rank_of, lets), default=0)
        self.grid = {op: Name(vec(Base.I, max(self.grid_rank, 1)), take(op)) for op in (INDEX, SHAPE)}
        self.functions = {f.name: take(f.name, "f") for f in module.functions}
        self.table_names = {t.name: Name(t.type, take(t.name, "table")) for t in module.tables}
        self.size_names = {
            t.name: Name(vec(Base.I, t.rank), take(f"{self.table_names[t.name].text}_size")) for t in module.tables
        }
        self.params = {p.name: Name(p.type, take(p.name, "param")) for p in module.params}
        self.arrays: dict[int, Name] = {}
        """The arrays of the entry's outputs."""

    def edge(self, op: str, types: tuple[Type, ...]) -> str:
        """Add the function that computes `op` for arguments of these types to the prologue; return its name."""
        name = name_of(op, types[0])
        return self.prologue.ask(name, lambda: self.edge_text(op, types, name))

    def edge_text(self, op: str, types: tuple[Type, ...], name: str) -> str:
        """Return the function that computes `op`: a text, or a definition."""
        type = types[0]
        if type.size > 1 and op in BY_COMPONENT:
            return self.printed(componentwise(op, types, type.base), name)
        return self.prologue.written(op, type) or remark(op) + self.printed(edge(op, types), name)

    @abstractmethod
    def printed(self, function: Function, name: str) -> str:
        """Return the text of a function that the prologue is to have."""

    def needed(self, let: Let) -> Needs:
        """Return the tables, params and grid variables that an operation reads."""
        return needed_by(let)

    def rank_of(self, let: Let) -> int:
        """Return the number of axes on which an operation reads the place in the grid; 0 for others."""
        return let.value.type.size if let.op in (INDEX, SHAPE) else 0

    def grid_of(self, function: str) -> list[Name]:
        """Return the grid variables that a function reads."""
        return [name for op, name in self.grid.items() if (op, "") in self.needs.get(function, ())]

    def split(self, flat: Expr, axes: int) -> list[Expr]:
        """Return the index on each of the first axes of the grid, of which the last one runs fastest."""
        rest, inner = flat, list[Expr]()
        for axis in tree.COMPONENTS[1:axes][::-1]:
            side = tree.Member(INT, self.grid[SHAPE], axis)
            inner.insert(0, tree.infix("%", rest, side))
            rest = tree.infix("/", rest, side)
        return [rest, *inner]

    def handed(self, function: str) -> tuple[Name, ...]:
        """Return the extra arguments of a function: the grid variables, tables and params that it reads."""
        needs = self.needs.get(function, frozenset())
        names = self.grid_of(function)
        for table in self.module.tables:
            if ("table", table.name) in needs:
                names += [self.table_names[table.name], self.size_names[table.name]]
        return (*names, *(e for p, e in self.params.items() if ("param", p) in needs))


class ClOperations(Operations):
    """The operations of one function."""

    unit: ClUnit

    @cached_property
    def steady(self) -> Mapping[int, tuple[int, int]]:
        """The reads of tables whose index has a loop-invariant part."""
        return steady_parts(self.survey, self.ranges)

    # Literals, vectors and names

    def literal(self, type: Type, component: float | int | bool) -> Expr:
        """Return a literal, or a call for a zero that is hidden from the compiler or that it would take for 0.0."""
        if component == 0 and type.is_float:
            negative = bool(np.signbit(component))
            if self.unit.hides_zeros:
                zero = self.ours("zero", type, type)
                return tree.prefix("-", zero) if negative else zero
            if negative and self.unit.math in REPRODUCIBLE:
                return self.ours("minus_zero", type, type)
        return Literal(type, component)

    def unknown_zero(self, type: Type) -> Expr | None:
        """Return a zero hidden from the compiler; None for bools, and for floats if passes/hide.py hides all zeros."""
        exists = type.is_int or (type.is_float and not self.unit.hides_zeros)
        return self.ours("zero", type.scalar, type.scalar) if exists else None

    def ours(self, op: str, takes: Type, gives: Type, *args: Expr) -> Expr:
        """Return a call of a function of the prologue."""
        return tree.call(self.unit.edge(op, (takes,)), gives, *args)

    def component(self, e: Expr) -> Expr:
        """Return a scalar as an operand beside a vector: a bool becomes -1 or 0."""
        return as_component(e)

    def picked(self, e: Expr, components: tuple[int, ...], type: Type) -> Expr:
        """Return `v.xy`; one component of a vector of bools is converted to a bool."""
        component = super().picked(e, components, type)
        return as_bool(component) if type is BOOL else component

    def in_range(self, index: Expr, length: int) -> Expr:
        """Return `sh_at(i, 8)`."""
        return tree.call(self.unit.prologue.flat_index(1), UINT, index, number(length))

    def op_param(self, let: Let) -> Expr:
        """Return a uniform; a bool was passed as an int."""
        e = self.unit.params[str(let.attr)]
        return as_bool(e) if e.type is BOOL else e

    def context(self, function: str) -> tuple[Expr, ...]:
        """Return the extra arguments of a call."""
        return self.unit.handed(function)

    def op_construct(self, let: Let) -> Expr:
        """Return a vector from parts; of eight numbers in two rows of a table, a load of both."""
        match [self.exprs[a] for a in let.args]:
            case Index(_, rows, at), Index(_, other, then) if let.value.type.size > WIDEST_PORT:
                if rows == other and then == tree.infix("+", at, number(1)) and not let.value.type.is_bool:
                    return tree.call(self.unit.prologue.both_rows(let.value.type.base), let.value.type, rows, at)
        return super().op_construct(let)

    def op_any(self, let: Let) -> Expr:
        """Return `any(c)`."""
        if self.types[let.args[0]].size <= WIDEST_PORT:
            return super().op_any(let)
        return tree.call(self.unit.prologue.any_long(), BOOL, self.arg(let.args[0]))

    # Operations

    def function_of(self, op: str, types: tuple[Type, ...]) -> str:
        """Return the name of OpenCL's function, or of one of the prologue."""
        unit, type = self.unit, types[0]
        if unit.math == "fast" and op in NATIVE:
            return NATIVE[op] if type.base is Base.F else op
        if unit.math == "fast" and (op == "ldexp" or op in NAN_LOST):
            return op
        if op in ELEMENTWISE and unit.elementwise:
            return f"__builtin_elementwise_{ELEMENTWISE[op]}"
        if op in FUNCTIONS and not self.is_wrong(op, type):
            return FUNCTIONS[op]
        return op if op in ("min", "max") and type.is_int else unit.edge(op, types)

    def is_wrong(self, op: str, type: Type) -> bool:
        """Return whether OpenCL's own function differs for this type."""
        return op in NAN_LOST or (type.size > 1 and op in BY_COMPONENT)

    def as_typed(self, e: Expr, type: Type) -> Expr:
        """Return `(int)(a + 1u)` for an int that was computed as a uint."""
        return Cast(INT, e) if type is INT and e.type is UINT else e

    def infix(self, let: Let) -> Expr:
        """Return `a + b`; at least one operand is converted to a uint where ints may wrap."""
        type = let.value.type
        if type.base is not Base.I or let.op not in _WRAPPING:
            return super().infix(let)
        if type.size > 1:
            return self._wrapping_vector(let.op, type, *(self.exprs[a] for a in let.args))
        if not self.ranges.may_wrap(let):
            return super().infix(let)
        return self._wrapping(let.op, *(self.exprs[a] for a in let.args))

    def _wrapping(self, op: str, a: Expr, b: Expr) -> Expr:
        if op == "add" and isinstance(b, Literal) and -(2**31) < b.value < 0:
            op, b = "sub", number(-int(b.value))
        if isinstance(b, Literal) and b.value >= 0:
            b = number(int(b.value), UINT)
        elif isinstance(a, Literal) and a.value >= 0:
            a = number(int(a.value), UINT)
        elif UINT not in (a.type, b.type):
            b = Cast(UINT, b)
        return tree.infix(INFIX[op], a, b, UINT)

    def _wrapping_vector(self, op: str, type: Type, a: Expr, b: Expr) -> Expr:
        wide = type.based(Base.U)
        scalars = [a.splat if b.splat is None else None, b.splat]
        left, right = (
            tree.call(_view(wide), wide, e) if scalar is None else Cast(UINT, scalar)
            for e, scalar in zip((a, b), scalars, strict=True)
        )
        return tree.call(_view(type), type, tree.infix(INFIX[op], left, right, wide))

    def op_neg(self, let: Let) -> Expr:
        """Return `-a`; for an int, return `0u - a`, which wraps."""
        type = let.value.type
        if type.base is not Base.I:
            return super().op_neg(let)
        if type.size == 1:
            return tree.infix("-", number(0, UINT), self.exprs[let.args[0]], UINT)
        wide = type.based(Base.U)
        return tree.call(_view(type), type, tree.prefix("-", tree.call(_view(wide), wide, self.arg(let.args[0]))))

    def as_ints(self, e: Expr) -> Expr:
        """Return uints as ints of the same bits."""
        type = e.type.based(Base.I)
        return tree.call(_view(type), type, e)

    def op_abs(self, let: Let) -> Expr:
        """Return `fabs(a)`; for an int, `sh_abs_i(a)`, because compilers take OpenCL's, a uint, for a positive int."""
        e, type = self.arg(let.args[0]), let.value.type
        if type.base is Base.U:
            return e
        return tree.call("fabs" if type.is_float else self.unit.edge("abs", (type,)), type, e)

    def op_sign(self, let: Let) -> Expr:
        """Return the sign; OpenCL's `sign` gives 0 for a NaN but -0 for -0, so 0.0 is added."""
        e, type = self.arg(let.args[0]), let.value.type
        if type.is_float:
            return tree.infix("+", tree.call("sign", type, e), self.literal(type.scalar, 0.0))
        if type.base is Base.U:
            return tree.call("min", type, e, self._each(type, 1))
        return tree.call("clamp", type, e, self._each(type, -1), self._each(type, 1))

    def _each(self, type: Type, value: int) -> Expr:
        """Return the number for every component: Oclgrind applies a scalar bound to the first component alone."""
        one = number(value, type.scalar)
        return one if type.size == 1 else Construct(type, (one,))

    def comparison(self, let: Let) -> Expr:
        """Return `a < b`."""
        return _narrow(super().comparison(let), self.types[let.args[0]])

    def op_isnan(self, let: Let) -> Expr:
        """Return `isnan(a)`."""
        return _narrow(self.plain_call(let), self.types[let.args[0]])

    op_isinf = op_isnan

    def op_cond(self, let: Let) -> Expr:
        """Return `c ? a : b`; for two constant vectors of three, `(int3)(-c) ? a : b`, which chooses by a mask.

        If the result of such a choice is tested, LLVM 15, and so PoCL 3.1, rewrites the test as one bool that chooses
        between constant masks of three. Its code generator ends the process over that.
        """
        c, a, b = self.args(let)
        type = let.value.type
        one = self.splat_of(c)
        if type.size == 3 and one is not None and _is_constant(a) and _is_constant(b):
            return self.choose(type, Construct(type.based(Base.B), (one,)), a, b)
        return super().op_cond(let)

    def choose(self, type: Type, c: Expr, a: Expr, b: Expr) -> Expr:
        """Return `c ? a : b`, a choice by the sign bits of c, whose components are as wide as those of a."""
        wide = tree.call(_conversion("long", type.size), c.type, c) if type.base is Base.D else c
        return tree.choice(wide, a, b)

    def op_bits_from_float(self, let: Let) -> Expr:
        """Return the bits of a float; for a double, the bits of the nearest float."""
        e, type = self.arg(let.args[0]), self.types[let.args[0]]
        narrow = type.based(Base.F)
        return self.ours(let.op, narrow, let.value.type, e if type is narrow else self.convert(narrow, e, type))

    def op_float_from_bits(self, let: Let) -> Expr:
        """Return `as_float(u)`."""
        return tree.call(_view(let.value.type), let.value.type, self.arg(let.args[0]))

    def convert(self, type: Type, e: Expr, source: Type) -> Expr:
        """Return `(float)i`, `convert_int_sat(x)`; vectors by OpenCL's functions."""
        if source.is_bool and source.size > 1:
            e, source = tree.prefix("-", e, source.based(Base.I)), source.based(Base.I)
            if type.base is Base.I:
                return e
        if type.is_bool:
            return _narrow(tree.infix("!=", e, self.literal(source.scalar, 0), type), source)
        if type.is_int and source.is_float:
            return tree.call(_conversion(spelled(type), rounding="_sat"), type, e)
        if type.is_int and source.is_int and type.size > 1:
            return tree.call(_view(type), type, e)
        return Cast(type, e) if type.size == 1 else tree.call(_conversion(spelled(type)), type, e)

    # What definitions are made of

    def op_bitcast(self, let: Let) -> Expr:
        """Return `as_uint(x)`."""
        return tree.call(_view(let.value.type), let.value.type, self.arg(let.args[0]))

    def op_whole(self, let: Let) -> Expr:
        """Return `(int)x`, `convert_int3(x)`."""
        e, type = self.arg(let.args[0]), let.value.type
        return Cast(type, e) if type.size == 1 else tree.call(_conversion(spelled(type)), type, e)

    # Tables and the grid

    def op_table(self, let: Let) -> Expr:
        """Return `noise[sh_at(i, noise_size)]`; an index that is known to be in range is not clamped."""
        name, unit = str(let.attr), self.unit
        rank, size = unit.tables[name].rank, unit.tables[name].size
        if rank == 1 and size is not None and self.ranges.within(let.args[0], 0, size[0] - 1):
            array: Expr = unit.table_names[name]
            index = self.exprs[let.args[0]]
            if let.value.id in self.steady and self.survey.uses[let.args[0]] == 1:
                index, start = (self.exprs[part] for part in self.steady[let.value.id])
                array = tree.infix("+", array, start)
            return self.read(array, index, let.value.type)
        at = tree.call(unit.prologue.flat_index(rank), UINT, *self.args(let), unit.size_names[name])
        return self.read(unit.table_names[name], at, let.value.type)

    def op_table_size(self, let: Let) -> Expr:
        """Return the argument that holds a table's size."""
        return self.unit.size_names[str(let.attr)]

    def op_grid_index(self, let: Let) -> Expr:
        """Return the kernel's variable for the index or the shape."""
        rank, size = self.unit.grid_rank, let.value.type.size
        if size != rank:
            raise CompileError(f"grid_index and grid_shape are used with {rank} and {size} axes at once")
        return self.unit.grid[let.op]

    op_grid_shape = op_grid_index

    def read(self, array: Expr, index: Expr, type: Type) -> Expr:
        """Return an element of an array in memory."""
        element: Expr = tree.call("vload3", type, index, array) if type.size == 3 else Index(type, array, index)
        if type.is_bool:
            element = as_bool(element if type.size == 1 else tree.call(_conversion("int", type.size), type, element))
        return element

    def write(self, array: Expr, e: Expr, type: Type, loc: Loc | None = None) -> tree.Stmt:
        """Return the statement that stores this work item's element of an array."""
        element = self.unit.element
        if type.is_bool and type.size > 1:
            e = tree.call(_conversion("uchar", type.size), type, tree.prefix("-", e))
        if type.size == 3:
            return Do(tree.call("vstore3", type, e, element, array), loc)
        return Assign(Index(type, array, element), e, loc)

    # Functions and loops

    def step(self, test: Expr | None, step: Assign) -> Assign:
        """Return `i += 1` in place of `i += 1u` where `i < n` holds, because that sum cannot wrap."""
        match test, step.value:
            case Operator(_, "<", (i, _)), Operator(_, "+", (j, Literal(value=1))) if i == j == step.target:
                return replace(step, value=tree.infix("+", i, number(1))) if i.type is INT else step
        return step

    def reference(self, e: Expr) -> Expr:
        """Return `&x`; a parameter by reference is a pointer already."""
        return e.args[0] if isinstance(e, Operator) else tree.prefix("&", e)

    def output(self, variable: Variable, e: Expr, loc: Loc | None) -> tree.Stmt:
        """Return the store into the output's array."""
        return self.write(self.unit.arrays[variable.id], e, variable.type, loc)


def as_component(e: Expr) -> Expr:
    """Return a scalar as a component of a vector: a bool is -1 or 0."""
    if e.type is not BOOL:
        return e
    return number(-int(e.value)) if isinstance(e, Literal) else tree.prefix("-", e, INT)


def as_bool(e: Expr) -> Expr:
    """Return `e != 0`."""
    return tree.infix("!=", e, number(0))


def _is_constant(e: Expr) -> bool:
    """Return whether an expression is a vector of literals."""
    return isinstance(e, Construct) and all(isinstance(part, Literal) for part in e.args)


def _view(type: Type) -> str:
    """Return the name of the function that reinterprets bits as a type."""
    return f"as_{spelled(type)}"


def _conversion(name: str, size: int = 1, rounding: str = "") -> str:
    """Return the name of the function that converts to a type."""
    return f"convert_{name}{size if size > 1 else ''}{rounding}"


def _narrow(e: Expr, type: Type) -> Expr:
    """Return a mask as ints, because comparisons of vectors of doubles give longs."""
    return tree.call(_conversion("int", type.size), e.type, e) if type.base is Base.D and type.size > 1 else e
