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

from dataclasses import replace
from functools import cache

from shpy.ir.names import fresh
from shpy.ir.nodes import Call, Function, Let, Module, Store, Value
from shpy.ir.traverse import walk
from shpy.ir.types import Base, Type
from shpy.passes.calls import LaneFacts
from shpy.passes.dead import remove_unused_functions
from shpy.passes.rewriter import Functions, Rewriter
from shpy.passes.uniformity import varies
from shpy.passes.vectorize import VectorModule

WIDTHS = (4, 8, 16)
"""Possible numbers of lanes of a packet: OpenCL C has vectors of these lengths, and rows of four fill them."""
WIDER = (32, 64)
"""Possible numbers of lanes where the driver's compiler has clang's vectors (see `prologue_wide`)."""


_OF_LANES = frozenset({"lane_any", "lane_min", "lane_max"})
"""Operations that give one answer for a number of each lane."""


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
    rows = Rows(base, size)
    rows.lanes = lanes
    return rows


def widen(vector: VectorModule, lanes: int) -> Module:
    """Return the module with packet types for varying values; pure functions get the forms that are used."""
    functions = vector.module.functions
    by_name = {f.name: f for f in functions}
    names = set(by_name)
    uniform = {f.name: fresh(f"{f.name}_uniform", names) for f in functions if f.pure}
    alone = {f.name for f in functions if f.alone}
    wide_functions: list[Function] = []
    for f in functions:
        if f.pure:
            wide_functions.append(_Uniform(f, {}, uniform).run())
        facts = _everything_varies(f) if f.pure else vector.facts[f.name]
        wide_functions.append(_Widener(f, by_name, facts, lanes, uniform, alone).run())
    return remove_unused_functions(replace(vector.module, functions=tuple(wide_functions)))


def widened(function: Function, lanes: int) -> Function:
    """Return the form for packets of a pure function that calls no other."""
    return _Widener(function, {}, _everything_varies(function), lanes, {}, set()).run()


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


class _Widener(Rewriter):
    """Gives values their types and broadcasts uniform operands."""

    def __init__(
        self,
        function: Function,
        functions: Functions,
        facts: LaneFacts,
        lanes: int,
        uniform: dict[str, str],
        alone: set[str],
    ) -> None:
        super().__init__(function, functions)
        self.facts, self.lanes, self.uniform, self.alone = facts, lanes, uniform, alone

    def run(self) -> Function:
        """Return the function with the types of packets."""
        function, varying = super().run(), self.facts.slots
        inputs = tuple(self.typed(i) for i in function.inputs if isinstance(i, Value))
        outputs, variables = (
            tuple(replace(v, type=self.wide(v.type)) if v.id in varying else v for v in slots)
            for slots in (function.outputs, function.variables)
        )
        return replace(function, inputs=inputs, outputs=outputs, variables=variables)

    def typed(self, value: Value) -> Value:
        varies = value.id in self.facts.varying
        return Value(value.id, self.wide(value.type), value.name, value.loc) if varies else value

    def wide(self, type: Type) -> Type:
        return rows_of(type.base, type.size, self.lanes)

    def spread(self, value: int) -> int:
        """Broadcast a uniform value to all lanes; return the id of the result, or of a value that varies already."""
        if value in self.facts.varying:
            return value
        result = self.value(self.wide(self.types[value]))
        self.emit(Let(result, "splat", (value,)))
        return result.id

    def let(self, let: Let) -> None:
        varies = let.value.id in self.facts.varying
        attr = self.uniform[str(let.attr)] if let.op == "call" and not varies else let.attr
        spreads = let.op not in ("load", "swizzle", "neighbour") if varies else let.op in _OF_LANES
        self.emit(Let(self.typed(let.value), let.op, tuple(map(self.spread, let.args)) if spreads else let.args, attr))

    def store(self, store: Store) -> None:
        varies = store.variable in self.facts.slots
        value = self.spread(store.value) if varies else store.value
        self.emit(store if value == store.value else replace(store, value=value))

    def call(self, call: Call) -> None:
        args = tuple(map(self.spread, call.args)) if call.function in self.alone else call.args
        self.emit(replace(call, args=args, results=tuple(map(self.typed, call.results))))
