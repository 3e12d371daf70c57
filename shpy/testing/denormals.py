"""Find the elements of a run that compute a denormal: a device that flushes denormals may give other results there.

Stage: test. Takes a program and its inputs, runs it on numpy with two more outputs, and returns for each element the
statement and the value of its first denormal.

    y = x * 1e-20              y = x * 1e-20
                       ->      hit = y != 0 & abs(y) <= least normal & $place == 0
                               $place = hit ? 7 : $place;  $value = hit ? y : $value
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from shpy.errors import LoopLimitExceeded
from shpy.ir.builder import Builder
from shpy.ir.nodes import Call, Function, If, Let, Loc, Loop, Module, Port, Region, Stmt, Value, Variable
from shpy.ir.ops import TRANSCENDENTALS
from shpy.ir.traverse import map_regions, rewrite, walk
from shpy.ir.types import Base, vec
from shpy.lang.recording.text import written
from shpy.lang.values.structure import Group, Leaf
from shpy.lang.values.value import CLASSES
from shpy.passes.exits import make_exits_explicit
from shpy.passes.fuse import fuse
from shpy.passes.inline import inline_calls
from shpy.passes.lower import lower
from shpy.passes.modes import Precision
from shpy.programs import Program
from shpy.testing.arrays import Array
from shpy.testing.observers import Setting

_LEAST = {"f16": 2.0**-14, "f32": 2.0**-126, "f64": 2.0**-1022}
_PLACE, _VALUE = vec(Base.U), vec(Base.D)


@dataclass(frozen=True)
class Denormal:
    """A denormal, or the least normal, among what a program computes or is given: `value`, line and `name` or op."""

    value: float
    loc: Loc | None
    name: str

    def __str__(self) -> str:
        source = written(self.loc)
        place = f" at {self.loc}" if self.loc else ""
        return f"{self.name} = {self.value:g}{place}{f': {source}' if source else ''}"


@dataclass(frozen=True)
class Denormals:
    """The first denormal of each element: `numbers` (n,) of `places`, 0 for an element without one; `values` (n,)."""

    numbers: Array
    values: Array
    places: tuple[tuple[Loc | None, str], ...]

    @property
    def met(self) -> Array:
        """The elements, (n,) bool, that meet a denormal."""
        return np.asarray(self.numbers != 0)

    def first(self, element: int) -> Denormal | None:
        """Return the first denormal of an element in C order; None if there is none."""
        number = int(self.numbers[element])
        return Denormal(float(self.values[element]), *self.places[number - 1]) if number else None


def meets_denormals(setting: Setting) -> Array:
    """Return the elements, (n,) bool, that meet a denormal or the least normal, in an input or any result.

    Operations such as `length` are taken apart, and so is the body of each function: what they compute counts.
    """
    (met,) = _run(setting, _Flag)[0]
    return met


def find_denormals(setting: Setting, lines: Collection[Loc] | None = None) -> Denormals:
    """Return the first denormal of each element; with `lines`, the first one that is computed at one of these lines.

    It takes some times as long as `meets_denormals`, and counts the same numbers.
    """
    (numbers, values), places = _run(setting, _Note, lines)
    return Denormals(numbers, values, tuple(places))


def _run(
    setting: Setting, watcher: type[_DenormalWatcher], lines: Collection[Loc] | None = None
) -> tuple[list[Array], list[tuple[Loc | None, str]]]:
    """Return the watcher's outputs, (n,) each, from a run on numpy, and the places that it tested."""
    whole = TRANSCENDENTALS | _of_halves(setting.program.ir, setting.precision)
    recorded = fuse(setting.program.ir) if setting.fuse else setting.program.ir
    module = _without_pure_functions(lower(recorded, whole, fuse=setting.fuse))
    module = make_exits_explicit(inline_calls(module), setting.options.get("loop_limit", 1_048_576)).module
    entry = replace(module.entry, outputs=(), variables=(*module.entry.variables, *module.entry.outputs))
    instance = watcher(entry, _LEAST[setting.precision], lines)
    watched = instance.run()
    names = [slot.name or "" for slot in watched.outputs]
    leaves = [Leaf(CLASSES["Attrib", 1, slot.type.base]) for slot in watched.outputs]
    ports = tuple(Port(name, leaf.cls.__name__) for name, leaf in zip(names, leaves, strict=True))
    module = replace(module, outputs=ports, functions=(*module.functions[:-1], watched))
    layout = Group("tuple", tuple(names), tuple(leaves))
    program = Program(replace(setting.program.recorded, module=module, output=layout))
    options = {**setting.options, "loop_limit": None, "fuse": False}  # it is contracted already
    try:
        outputs = program.compile("numpy", **options)(*setting.inputs, shape=setting.shape, **setting.named)
    except LoopLimitExceeded as error:
        outputs = error.result.outputs
    return [np.asarray(part).reshape(-1) for part in outputs], instance.places


def _of_halves(module: Module, precision: Precision) -> frozenset[str]:
    """Return the operations with results of binary16: these are computed in binary32, where they meet no denormal."""
    bases = {Base.H, Base.F} if precision == "f16" else {Base.H}
    lets = (s for f in module.functions for s in walk(f.body) if isinstance(s, Let))
    return frozenset(let.op for let in lets if let.value.type.base in bases)


def _without_pure_functions(module: Module) -> Module:
    """Return the module with a statement for each call of a pure function, so that these are inlined as well."""

    def called(s: Stmt) -> Stmt:
        if isinstance(s, Let) and s.op == "call":
            return Call(str(s.attr), s.args, (s.value,), s.value.loc)
        return s

    return replace(
        module, functions=tuple(replace(f, pure=False, body=rewrite(f.body, called)) for f in module.functions)
    )


class _DenormalWatcher(ABC):
    """Copies the entry, with a test behind every value that is a float."""

    def __init__(self, function: Function, least: float, lines: Collection[Loc] | None) -> None:
        self.function = function
        self.least = least
        self.lines = lines
        self.places: list[tuple[Loc | None, str]] = []
        self.b = Builder(function=function)

    def run(self) -> Function:
        """Return the copy, with the watcher's own outputs."""
        self.declare()
        for port in self.function.inputs:
            if isinstance(port, Value):
                self.test(port, port.name or "an input")
        self.region(self.function.body)
        return self.b.finish()

    @abstractmethod
    def declare(self) -> None:
        """Make the outputs."""

    @abstractmethod
    def note(self, value: Value, low: Value) -> None:
        """Note a value; `low` tells which of its components are denormals. It is from the last of `places`."""

    def region(self, region: Region) -> None:
        for s in region:
            if isinstance(s, If | Loop):
                self.b.append(map_regions(s, self.nested))
                continue
            self.b.append(s)
            if isinstance(s, Let) and s.op != "const":
                self.test(s.value, s.value.name or s.op)

    def nested(self, region: Region) -> Region:
        self.b.push()
        self.region(region)
        return self.b.pop()

    def test(self, value: Value, name: str) -> None:
        b, type = self.b, value.type
        if not type.is_float or (self.lines is not None and value.loc not in self.lines):
            return
        self.places.append((value.loc, name))
        least = {Base.D: _LEAST["f64"], Base.H: _LEAST["f16"]}.get(type.base, self.least)
        zero, bound = (b.const(type, [n] * type.size) for n in (0.0, least))
        self.note(value, b.let("and", b.let("ne", value, zero), b.let("le", b.let("abs", value), bound)))


class _Flag(_DenormalWatcher):
    """Notes whether there is a denormal."""

    def declare(self) -> None:
        self.flag = self.b.output(vec(Base.B), "met")

    def note(self, value: Value, low: Value) -> None:
        b = self.b
        b.store(self.flag, b.let("or", b.load(self.flag), b.let("any", low)))


class _Note(_DenormalWatcher):
    """Notes the place and the value of the first denormal."""

    def declare(self) -> None:
        self.place, self.value = self.b.output(_PLACE, "place"), self.b.output(_VALUE, "value")

    def note(self, value: Value, low: Value) -> None:
        b = self.b
        hit = b.let("and", b.let("any", low), b.let("eq", b.load(self.place), b.const(_PLACE, [0])))
        self.store_where(hit, self.place, b.const(_PLACE, [len(self.places)]))
        shown = b.swizzle(value, [0])
        for k in range(1, value.type.size):
            shown = b.let("cond", b.swizzle(low, [k]), b.swizzle(value, [k]), shown)
        exact = shown if shown.type == _VALUE else b.let("convert", shown, type=_VALUE)
        self.store_where(hit, self.value, exact)

    def store_where(self, hit: Value, slot: Variable, value: Value) -> None:
        self.b.store(slot, self.b.let("cond", hit, value, self.b.load(slot)))
