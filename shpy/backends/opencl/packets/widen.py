"""Types of packets, and the last pass before packets are printed: it gives a vectorised module these types.

Stage: improve, after `take_apart` and `vectorize`. A varying value gets the type of a packet. A uniform value keeps its
type, and is broadcast where a varying operation takes it:

    %3: f = load $z_x                  %3: f16 = load $z_x           (float16: one number a lane)
    %4: f = const 0x1p+2         ->    %4: f = const 0x1p+2
    %5: b = gt %3, %4                  %6: f16 = splat %4
                                       %5: b16 = gt %3, %6           (int16: -1 where it holds)

A vector that `take_apart` leaves, such as an input, is `Rows`, a struct with a packet for each component: `p.x`, `p.y`.
Each function gets a form for packets; a pure one keeps its own form too, for uniform arguments.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

from shpy.ir.builder import Builder
from shpy.ir.nodes import Call, Function, If, Let, Loop, Module, Region, Stmt, Store, Value, Variable
from shpy.ir.traverse import walk
from shpy.ir.types import Base, Type
from shpy.passes.calls import LaneFacts
from shpy.passes.dead import remove_unused_functions
from shpy.passes.names import fresh
from shpy.passes.rewriter import Functions, Rewriter
from shpy.passes.uniformity import varies
from shpy.passes.vectorize import VectorModule

WIDTHS = (4, 8, 16)
"""Possible numbers of lanes of a packet: OpenCL C has vectors of these lengths, and rows of four fill them."""
WIDER = (32, 64)
"""Possible numbers of lanes where the driver's compiler has clang's vectors (see `prologue_wide`)."""


class Lanes(Type):
    """The type of a number of `base` per lane, as OpenCL's `float16`; `size` counts the lanes. See `lanes_of`."""

    __slots__ = ()

    def __reduce__(self) -> tuple[object, ...]:
        return lanes_of, (self.base, self.size)

    def based(self, base: Base) -> Type:
        """Return the same lanes with numbers of another base."""
        return lanes_of(base, self.size)


class Rows(Type):
    """The type of a vector of `size` components for each of `lanes` lanes, one packet per component. See `rows_of`."""

    __slots__ = ("lanes",)
    lanes: int

    def __repr__(self) -> str:
        return f"{self.base.value}{self.lanes}x{self.size}"

    def __reduce__(self) -> tuple[object, ...]:
        return rows_of, (self.base, self.size, self.lanes)


@cache
def lanes_of(base: Base, lanes: int) -> Lanes:
    """Return the type of a number for each of `lanes` lanes; equal types are one object."""
    return Lanes(base, lanes)


@cache
def rows_of(base: Base, size: int, lanes: int) -> Type:
    """Return the type of a vector of `size` (1 to 4) for each of `lanes` lanes; equal types are one object."""
    if size == 1:
        return lanes_of(base, lanes)
    made = Rows(base, size)
    made.lanes = lanes
    return made


def widen(vector: VectorModule, lanes: int) -> Module:
    """Return the module with packet types for varying values; pure functions get the forms that are used."""
    functions = vector.module.functions
    names = {f.name for f in functions}
    uniform = {f.name: fresh(f"{f.name}_uniform", names) for f in functions if f.pure}
    alone = {f.name for f in functions if f.alone}
    made: list[Function] = []
    for f in functions:
        if f.pure:
            made.append(_Uniform(f, {}, uniform).run())
        facts = _everything_varies(f) if f.pure else vector.facts[f.name]
        made.append(_Widener(f, facts, lanes, uniform, alone).run())
    return remove_unused_functions(replace(vector.module, functions=tuple(made)))


class _Uniform(Rewriter):
    """The form of a pure function for uniform arguments: it calls other such forms, and `lane_any` is its operand."""

    def __init__(self, function: Function, functions: Functions, names: dict[str, str]) -> None:
        super().__init__(replace(function, name=names[function.name]), functions)
        self.names = names

    def let(self, let: Let) -> None:
        if let.op == "lane_any":
            self.replace(let.value, let.args[0])
        else:
            self.emit(replace(let, attr=self.names[str(let.attr)]) if let.op == "call" else let)


def _everything_varies(function: Function) -> LaneFacts:
    """Return the facts of a pure function with varying arguments: all slots vary, and all that depends on them."""
    slots = frozenset(v.id for v in (*function.outputs, *function.variables))
    varying = {v.id for v in function.inputs}
    for s in walk(function.body):
        if isinstance(s, Let) and (s.op == "load" or varies(s.op, (a in varying for a in s.args))):
            varying.add(s.value.id)
    return LaneFacts(frozenset(varying), slots)


class _Widener:
    """The rewriter of one function: it gives values their types and broadcasts uniform operands."""

    def __init__(
        self, function: Function, facts: LaneFacts, lanes: int, uniform: dict[str, str], alone: set[str]
    ) -> None:
        self.function = function
        self.varying = facts.varying
        self.varying_slots = facts.slots
        self.lanes = lanes
        self.uniform = uniform
        self.alone = alone
        self.b = Builder(function=function)
        self.parts: dict[int, tuple[int, ...]] = {}

    def run(self) -> Function:
        """Return the function with the types of packets."""
        self.b.inputs = [replace(i, type=self.type_of(i)) for i in self.function.inputs if isinstance(i, Value)]
        self.statements(self.function.body)
        made = self.b.finish()
        return replace(
            made, outputs=tuple(map(self.slot, made.outputs)), variables=tuple(map(self.slot, made.variables))
        )

    def type_of(self, value: Value) -> Type:
        return self.wide(value.type) if value.id in self.varying else value.type

    def wide(self, type: Type) -> Type:
        return rows_of(type.base, type.size, self.lanes)

    def slot(self, variable: Variable) -> Variable:
        return replace(variable, type=self.wide(variable.type)) if variable.id in self.varying_slots else variable

    def spread(self, value: int) -> int:
        """Broadcast a uniform value to all lanes; return the id of the result, or of a value that varies already."""
        if value in self.varying:
            return value
        return self.b.let("splat", value, type=self.wide(self.b.type_of(value))).id

    def let(self, s: Let) -> None:
        if s.value.id not in self.varying:
            attr = self.uniform[str(s.attr)] if s.op == "call" else s.attr
            args = tuple(map(self.spread, s.args)) if s.op == "lane_any" else s.args
            self.b.append(replace(s, args=args, attr=attr))
            return
        args = s.args if s.op in ("load", "swizzle", "neighbour") else tuple(map(self.spread, s.args))
        self.b.append(Let(replace(s.value, type=self.wide(s.value.type)), s.op, args, s.attr))

    def statements(self, region: Iterable[Stmt]) -> None:
        for s in region:
            match s:
                case Let():
                    self.let(s)
                case Store(variable, value):
                    spread = self.spread(value) if variable in self.varying_slots else value
                    self.b.append(replace(s, value=spread))
                case If(condition, then, orelse, loc):
                    self.b.append(If(condition, self.region(then), self.region(orelse), loc))
                case Loop(body, continuing, until, turns, loc):
                    self.b.append(Loop(self.region(body), self.region(continuing), until, turns, loc))
                case Call(name, args, results):
                    args = tuple(map(self.spread, args)) if name in self.alone else args
                    self.b.append(
                        replace(s, args=args, results=tuple(replace(r, type=self.type_of(r)) for r in results))
                    )
                case _:
                    self.b.append(s)

    def region(self, region: Region) -> Region:
        self.b.push()
        self.statements(region)
        return self.b.pop()
