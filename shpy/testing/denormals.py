"""Which elements of a run meet a denormal on their way: where a device that flushes them may give something else.

Stage: test. Takes a program and its inputs, runs it on numpy with one more output, and gives a bool for each element.

    y = x * 1e-20              y = x * 1e-20
                       ->      $denormal = $denormal | (y != 0 & abs(y) <= least normal)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shpy.errors import LoopLimitExceeded
from shpy.ir.builder import Builder
from shpy.ir.nodes import Function, If, Let, Loop, Module, Port, Region, Value
from shpy.ir.ops import TRANSCENDENTALS
from shpy.ir.traverse import map_regions
from shpy.ir.types import Base, vec
from shpy.lang.structure import Group, Leaf
from shpy.lang.values import CLASSES
from shpy.passes.exits import make_exits_explicit
from shpy.passes.inline import inline_calls
from shpy.passes.lower import lower
from shpy.program import Program
from shpy.testing.arrays import Array
from shpy.testing.observers import Setting

__all__ = ["meets_denormals"]

_LEAST = {"f16": 2.0**-14, "f32": 2.0**-126, "f64": 2.0**-1022}
_BOOL = vec(Base.B)


def meets_denormals(setting: Setting) -> Array:
    """The elements, (n,) bool, of which an input, a result or anything between is a denormal or the least normal."""
    module = _flagged(
        lower(setting.program.ir, TRANSCENDENTALS), setting.precision, setting.options.get("loop_limit", 1_048_576)
    )
    layout = Group("tuple", ("denormal",), (Leaf(CLASSES["Attrib", 1, Base.B]),))
    program = Program(replace(setting.program._recorded, module=module, output=layout))
    options = {**setting.options, "loop_limit": None}
    try:
        found = program.compile("numpy", **options)(*setting.inputs, shape=setting.shape, **setting.named)
    except LoopLimitExceeded as error:
        found = error.result.outputs
    return np.asarray(found[0]).reshape(-1)


def _flagged(module: Module, precision: str, loop_limit: int | None) -> Module:
    """The module with the flag as its only output."""
    whole, _, _ = make_exits_explicit(inline_calls(module), loop_limit)
    entry = whole.entry
    entry = replace(entry, outputs=(), variables=(*entry.variables, *entry.outputs))
    flagged = _Flag(entry, _LEAST[precision]).run()
    return replace(whole, outputs=(Port("denormal", "Attrib1b"),), functions=(*whole.functions[:-1], flagged))


class _Flag:
    """Copies the entry, with a test behind every value that is a float."""

    def __init__(self, function: Function, least: float) -> None:
        self.function = function
        self.least = least
        self.b = Builder(function=function)

    def run(self) -> Function:
        self.flag = self.b.output(_BOOL, "denormal")
        for port in self.function.inputs:
            if isinstance(port, Value):
                self.test(port)
        self.region(self.function.body)
        return self.b.finish()

    def region(self, region: Region) -> None:
        for s in region:
            if isinstance(s, If | Loop):
                self.b.append(map_regions(s, self.nested))
                continue
            self.b.append(s)
            if isinstance(s, Let) and s.op != "const":
                self.test(s.value)

    def nested(self, region: Region) -> Region:
        self.b.push()
        self.region(region)
        return self.b.pop()

    def test(self, value: Value) -> None:
        b, type = self.b, value.type
        if not type.is_float:
            return
        least = {Base.D: _LEAST["f64"], Base.H: _LEAST["f16"]}.get(type.base, self.least)
        zero, bound = (b.const(type, [n] * type.size) for n in (0.0, least))
        low = b.let("and", b.let("ne", value, zero), b.let("le", b.let("abs", value), bound))
        b.store(self.flag, b.let("or", b.load(self.flag), b.let("any", low)))
