"""Random modules that are valid and end, to run before and after a pass.

They have what passes can get wrong: vectors of every base and of mixed parts, ints at the ends of their range,
variables stored in parts, in branches and in loops, arrays, exits from any depth, `continuing` parts, subroutines with
arguments by reference that return early, loops without a known bound. The IR has no structs: the language takes them
apart.
"""

from __future__ import annotations

import random
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from shpy.ir.builder import Builder
from shpy.ir.constants import encode
from shpy.ir.nodes import (
    EXITS,
    Break,
    Continue,
    Discard,
    Function,
    Loc,
    Module,
    Param,
    Port,
    Return,
    Table,
    Value,
    Variable,
)
from shpy.ir.ops import OPS
from shpy.ir.types import Base, Type, vec
from shpy.testing.generated.operations import (
    COMPARE,
    FLOAT_BINARY,
    FLOAT_TERNARY,
    FLOAT_UNARY,
    GEOMETRY,
    INT_BINARY,
    INT_TERNARY,
    INT_UNARY,
    LOGIC,
    REDUCING,
    TESTS,
)

F, F2, F3, I, U, B, B3 = vec("f"), vec("f", 2), vec("f", 3), vec("i"), vec("u"), vec("b"), vec("b", 3)  # noqa: E741
F4, I2, I3, U2, B2 = vec("f", 4), vec("i", 2), vec("i", 3), vec("u", 2), vec("b", 2)
TYPES = (F, F, F, F3, F2, F4, I, I, I2, I3, U, U2, B, B2, B3)
PARTS = {2: ((1, 1),), 3: ((1, 1, 1), (1, 2), (2, 1)), 4: ((1, 1, 1, 1), (2, 2), (1, 3), (3, 1), (2, 1, 1))}
"""The sizes of what a vector can be made of."""
INTS = {Base.I: (0, 1, 2, 3, 31, 33, -1, -7, 2**31 - 1, -(2**31)), Base.U: (0, 1, 2, 3, 31, 33, 2**31, 2**32 - 1)}
FLOATS = (0.0, -0.0, 1.0, 2.0, -1.5, 0.1, 3.0, 1e-3, 1e30, float("inf"), float("nan"))
LOOP_LIMIT = 6

BINARY = (*FLOAT_BINARY, "add", "mul", "sub")
OF_VECTORS = {
    size: [op for op in GEOMETRY if OPS[op].gives == "T" or (OPS[op].gives == "V3" and size == 3)] for size in (2, 3, 4)
}
"""Operations that give a vector of a size."""
MEASURES = [op for op in GEOMETRY if OPS[op].gives == "S"]


@dataclass(frozen=True)
class Sizes:
    """The limits of a generated module: statements in a region, and the depth of nested regions."""

    statements: int = 7
    depth: int = 4


class Generator:
    """Generates one function after the other of a module."""

    def __init__(self, seed: int, sizes: Sizes = Sizes(), *, lanes: bool = False, axes: int = 0) -> None:
        self.random = random.Random(seed)
        self.sizes = sizes
        self.lanes = lanes
        self.axes = axes
        self.callees: list[Function] = []
        self.line = 0

    def module(self) -> Module:
        if self.random.random() < 0.5:
            self.callees.append(self.pure())
        for k in range(self.random.randrange(3)):
            self.callees.append(self.subroutine(f"sub{k}"))
        entry = self.entry()
        inputs = tuple(Port(v.name or "", "Attrib") for v in entry.inputs)
        outputs = tuple(Port(v.name or "", "Attrib") for v in entry.outputs)
        params = (Param("scale", "Attrib1f", F, encode(F, [1.5])),)
        tables = (Table("data", F, 1), Table("grid", F2, 2, (2, 3)))
        return Module("random", inputs, outputs, params, tables, (*self.callees, entry))

    # Functions

    def start(self, name: str) -> None:
        self.b = Builder(name)
        self.values: list[Value] = []
        self.slots: list[Variable] = []
        self.arrays: list[Variable] = []
        self.depth = 0
        self.loops: list[bool] = []
        self.calls = 3
        self.in_pure = False

    def pure(self) -> Function:
        self.start("helper")
        self.in_pure = True
        self.b.pure = True
        self.values += [self.b.input(F, "p"), self.b.input(F3, "q")]
        result = self.b.output(F3, "result")
        self.slots.append(result)
        for _ in range(4):
            self.statement()
        self.b.store(result, self.of(F3))
        return self.b.finish()

    def subroutine(self, name: str) -> Function:
        self.start(name)
        self.values += [self.b.input(F, "x"), self.b.input(I, "n")]
        self.slots += [self.b.reference(F3, "r"), self.b.reference(F, "s")]
        self.arrays.append(self.b.reference(F, "ref", length=3))
        outputs = [self.b.output(self.random.choice((F, F3)), f"out{k}") for k in range(self.random.randrange(3))]
        self.body(outputs)
        return self.b.finish()

    def entry(self) -> Function:
        self.start("main")
        self.values += [self.b.input(F, "a"), self.b.input(F3, "v"), self.b.input(I, "k"), self.b.input(U, "h")]
        self.body([self.b.output(F, "o"), self.b.output(F3, "p"), self.b.output(I, "q")])
        return self.b.finish()

    def body(self, outputs: list[Variable]) -> None:
        others = self.random.sample((F4, I2, I3, U2, B2, B3), 2)
        for n, type in enumerate((F, F, F3, F3, F2, I, U, B, *others)):
            self.slots.append(self.b.variable(type, name=f"v{n}" if self.random.random() < 0.7 else None))
        self.arrays += [self.b.variable(F, 3, "array"), self.b.variable(F2, 2, "pairs")]
        self.arrays.append(self.b.variable(self.random.choice((I, B, F3, *others)), 2, "more"))
        self.slots += outputs
        self.statements()
        if not isinstance(self.b.region[-1] if self.b.region else None, EXITS):
            for output in outputs:
                if self.random.random() < 0.9:
                    self.b.store(output, self.of(output.type))

    # Statements

    def statements(self) -> None:
        for _ in range(self.random.randint(1, self.sizes.statements)):
            self.line += 1
            self.b.loc = Loc("random.py", self.line)
            self.statement()
        self.maybe_exit()

    def maybe_exit(self) -> None:
        if self.depth == 0 or self.random.random() > 0.35:
            return
        kinds: list[Any] = [Return, Return] if self.depth > 0 else []
        if self.random.random() < 0.15:
            kinds.append(Discard)
        if self.loops:
            kinds += [Break] * 3 + [Continue] * 3 * self.loops[-1]
        if self.no_exit:
            kinds = [k for k in kinds if k in (Break, Continue) and self.loops and self.inner_loops > 0]
        if kinds:
            self.b.exit(self.random.choice(kinds))

    no_exit = False
    inner_loops = 0

    def statement(self) -> None:
        choices = [self.store, self.store, self.store_part, self.value, self.value, self.array_store]
        if not self.in_pure and self.depth < self.sizes.depth:
            choices += [self.branch, self.branch, self.loop, self.call]
        self.random.choice(choices)()

    def value(self) -> None:
        self.values.append(self.make(self.random.choice(TYPES)))

    def store(self) -> None:
        slot = self.random.choice(self.slots)
        self.b.store(slot, self.of(slot.type))

    def store_part(self) -> None:
        vectors = [s for s in self.slots if s.type.size > 1]
        if not vectors:
            return
        slot = self.random.choice(vectors)
        picked = self.random.sample(range(slot.type.size), self.random.randint(1, slot.type.size))
        self.b.store(slot, self.of(slot.type.sized(len(picked))), picked)

    def array_store(self) -> None:
        if self.arrays:
            array = self.random.choice(self.arrays)
            self.b.store(array, self.of(array.type), index=self.of(I))

    @contextmanager
    def nested(self) -> Any:
        self.depth += 1
        known = len(self.values)
        yield
        del self.values[known:]
        self.depth -= 1

    def branch(self) -> None:
        with self.b.when(self.of(B)), self.nested():
            self.statements()
        if self.random.random() < 0.6:
            with self.b.otherwise(), self.nested():
                self.statements()

    def loop(self) -> None:
        most = self.random.choice((None, 1, 2, 3, 3))
        counter = self.b.variable(I, name="i")
        self.b.store(counter, self.b.const(I, [0]))
        known = len(self.values)
        may_continue = self.random.random() < 0.5
        with self.b.loop(most) as loop:
            self.depth += 1
            self.loops.append(may_continue)
            self.inner_loops += self.no_exit
            self.statements()
            self.inner_loops -= self.no_exit
            if may_continue:
                del self.values[known:]
            loops, self.loops = self.loops, []
            outer, self.no_exit = (self.no_exit, self.inner_loops), True
            self.inner_loops = 0
            loop.continuing()
            if isinstance(loop.body[-1] if loop.body else None, EXITS):
                del self.values[known:]
            if self.random.random() < 0.3:
                self.statement()
            count = self.b.let("add", self.b.load(counter), self.b.const(I, [1]))
            self.b.store(counter, count)
            self.no_exit, self.inner_loops = outer
            self.loops = loops
            if most is not None:
                ends = self.b.let("ge", count, self.b.const(I, [most]))
                loop.until(ends if self.random.random() < 0.6 else self.b.let("or", ends, self.of(B)))
            elif self.random.random() < 0.9:
                loop.until(self.of(B))
            self.loops.pop()
            self.depth -= 1
        del self.values[known:]

    def call(self) -> None:
        if not self.callees or self.calls == 0:
            return
        self.calls -= 1
        callee = self.random.choice(self.callees)
        args: list[Any] = []
        for port in callee.inputs:
            if isinstance(port, Value):
                args.append(self.of(port.type))
                continue
            pool = self.slots if port.length is None else self.arrays
            fitting = [s for s in pool if (s.type, s.length) == (port.type, port.length) and s not in args]
            if not fitting:
                return
            args.append(self.random.choice(fitting))
        self.values += self.b.call(callee, *args)

    # Values

    def of(self, type: Type) -> Value:
        """A value of this type: one that is there, a load, or a new one."""
        there = [v for v in self.values if v.type is type]
        slots = [s for s in self.slots if s.type is type]
        dice = self.random.random()
        if there and dice < 0.4:
            return self.random.choice(there)
        if slots and dice < 0.75:
            return self.b.load(self.random.choice(slots))
        return self.make(type) if dice < 0.95 else self.constant(type)

    def constant(self, type: Type) -> Value:
        if type.is_float:
            numbers: list[float] = [self.random.choice(FLOATS) for _ in range(type.size)]
        elif type.is_bool:
            numbers = [self.random.random() < 0.5 for _ in range(type.size)]
        else:
            numbers = [self.random.choice(INTS[type.base]) for _ in range(type.size)]
        return self.b.const(type, numbers)

    def make(self, type: Type) -> Value:
        if self.random.random() < 0.25:
            return self.constant(type)
        arrays = [a for a in self.arrays if a.type is type]
        if arrays and self.random.random() < 0.15:
            return self.b.load(self.random.choice(arrays), self.simple(I))
        if type.size > 1 and self.random.random() < 0.4:
            return self.make_vector(type) if type.is_float else self.assemble(type)
        if self.random.random() < 0.1:
            return self.choose(type)
        if type.is_bool:
            return self.make_bool(type)
        return self.make_int(type) if type.is_int else self.make_float(type)

    def assemble(self, type: Type) -> Value:
        """Return a vector made from other values: a splat, a swizzle or a construct."""
        match self.random.randrange(3):
            case 0:
                return self.b.splat(self.simple(type.scalar), type.size)
            case 1:
                source = self.simple(type.sized(self.random.choice((2, 3, 4))))
                return self.b.swizzle(source, [self.random.randrange(source.type.size) for _ in range(type.size)])
        parts = (self.simple(type.sized(n)) for n in self.random.choice(PARTS[type.size]))
        return self.b.let("construct", *parts, type=type)

    def choose(self, type: Type) -> Value:
        """A `cond`, by one bool or by one for each component."""
        condition = self.simple(type.based(Base.B)) if self.random.random() < 0.5 else None
        if condition is None:
            condition = self.b.splat(self.simple(B), type.size) if type.size > 1 else self.simple(B)
        return self.b.let("cond", condition, self.simple(type), self.simple(type))

    def make_float(self, type: Type) -> Value:
        pick, let = self.random.choice, self.b.let
        dice = self.random.randrange(11)
        if dice < 4:
            return let(pick(BINARY), self.simple(type), self.simple(type))
        if dice < 6:
            return let(pick(FLOAT_UNARY), self.simple(type))
        if dice == 6:
            return let(pick(FLOAT_TERNARY), self.simple(type), self.simple(type), self.simple(type))
        if dice == 7:
            return self.choose(type)
        if type.size > 1:
            return self.make_vector(type)
        if dice == 8:
            return self.whole(pick(MEASURES), pick((F2, F3, F4)))
        if dice == 9:
            return let("convert", self.simple(pick((I, U))), type=F)
        return self.make_scalar()

    def make_scalar(self) -> Value:
        pick, let = self.random.choice, self.b.let
        match self.random.randrange(8):
            case 0:
                return let("param", type=F, attr="scale")
            case 5:
                other = vec(pick((Base.H, Base.D)))
                a, b, c = (let("convert", self.simple(F), type=other) for _ in range(3))
                return let("convert", let(pick(("fma", "mad", "mix")), a, b, c), type=F)
            case 6:
                wide = let("convert", self.simple(F), type=vec(Base.D))
                narrow = let("convert", let("mul", wide, wide), type=vec(Base.H))
                return let("ldexp", let("convert", narrow, type=F), self.simple(I))
            case 1:
                return let("table", self.simple(I), type=F, attr="data")
            case 2 if self.arrays:
                array = pick([a for a in self.arrays if a.type is F])
                return self.b.load(array, self.simple(I))
            case 3:
                return let("component", self.simple(pick((F2, F3, F4))), self.simple(I), type=F)
            case 4:
                return let("float_from_bits", let("and", self.simple(U), self.b.const(U, [0x3FFFFFFF])))
        return self.b.swizzle(self.simple(F3), [self.random.randrange(3)])

    def make_vector(self, type: Type) -> Value:
        size = type.size
        match self.random.randrange(5):
            case 0 | 3 if self.random.random() < 0.6:
                return self.whole(self.random.choice(OF_VECTORS[size]), type)
            case 3 if size == 3 and not self.in_pure:
                helpers = [c for c in self.callees if c.pure]
                if helpers:
                    return self.b.call(helpers[0], self.simple(F), self.simple(F3))[0]
        return self.assemble(type)

    def whole(self, op: str, vector: Type) -> Value:
        """An operation on whole vectors; some take a scalar beside them."""
        return self.b.let(op, *(self.simple(F if letter == "S" else vector) for letter in OPS[op].takes))

    def make_int(self, type: Type) -> Value:
        let = self.b.let
        if self.axes and type.base is Base.I and self.random.random() < 0.4:
            index = let("grid_index", type=vec(Base.I, self.axes))
            return self.b.swizzle(index, [self.random.randrange(self.axes) for _ in range(type.size)])
        if self.random.random() < 0.08:
            return let(self.random.choice(INT_TERNARY), *(self.simple(type) for _ in range(3)))
        match self.random.randrange(6):
            case 0:
                return let(self.random.choice(INT_UNARY), self.simple(type))
            case 1:
                bases = (Base.F, Base.F, Base.B, Base.I if type.base is Base.U else Base.U)
                return let("convert", self.simple(type.based(self.random.choice(bases))), type=type)
            case 2 if type.base is Base.U:
                return let("bits_from_float", self.simple(type.based(Base.F)))
            case 2 if type is I:
                return let("component", self.simple(self.random.choice((I2, I3))), self.simple(I), type=I)
            case 3 if type is I:
                return let("swizzle", let("table_size", type=vec(Base.I, 2), attr="grid"), type=I, attr=(1,))
        return let(self.random.choice(INT_BINARY), self.simple(type), self.simple(type))

    def make_bool(self, type: Type) -> Value:
        let = self.b.let
        match self.random.randrange(6):
            case 0:
                return let(self.random.choice(LOGIC), self.simple(type), self.simple(type))
            case 1:
                return let("not", self.simple(type))
            case 2 if type is B:
                return let(self.random.choice(REDUCING), self.simple(self.random.choice((B2, B3))))
            case 3 if type is B and self.lanes and not self.in_pure:
                return let(self.random.choice(("any_lane", "all_lanes")), self.simple(B), type=B)
            case 4 if self.random.random() < 0.3:
                return let("convert", self.simple(type.based(self.random.choice((Base.F, Base.I)))), type=type)
            case 5 if self.random.random() < 0.3:
                return let(self.random.choice(TESTS), self.simple(type.based(Base.F)))
        of = type.based(self.random.choice((Base.F, Base.F, Base.I, Base.U)))
        return let(self.random.choice(COMPARE), self.simple(of), self.simple(of))

    def simple(self, type: Type) -> Value:
        there = [v for v in self.values if v.type is type]
        slots = [s for s in self.slots if s.type is type]
        if there and self.random.random() < 0.5:
            return self.random.choice(there)
        return self.b.load(self.random.choice(slots)) if slots else self.constant(type)


def random_module(seed: int, sizes: Sizes = Sizes(), *, lanes: bool = False, axes: int = 0) -> Module:
    """Return the module of a seed; with `axes`, it reads the index in a grid of that many axes."""
    return Generator(seed, sizes, lanes=lanes, axes=axes).module()


def random_inputs(seed: int) -> tuple[list[Any], dict[str, Any]]:
    """Inputs of the entry of every random module, and its tables."""
    r = random.Random(seed)

    def number() -> float:
        return r.choice((*FLOATS, r.uniform(-4, 4), r.uniform(-4, 4), r.uniform(-4, 4), r.uniform(-4, 4)))

    inputs = [number(), [number() for _ in range(3)], r.choice((r.randint(-3, 5), *INTS[Base.I])), r.randrange(1 << 32)]
    tables = {"data": np.arange(4, dtype=np.float32) / 3, "grid": np.arange(12, dtype=np.float32).reshape(2, 3, 2)}
    return inputs, tables
