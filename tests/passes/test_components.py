"""`take_apart`: the same numbers from scalars alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from passes.random_ir import LOOP_LIMIT, random_module

from shpy.backend.base import Options
from shpy.ir.builder import Builder
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Let, Module, Port
from shpy.ir.parser import parse
from shpy.ir.traverse import defined, walk
from shpy.ir.types import vec
from shpy.ir.verifier import verify
from shpy.passes.components import take_apart
from shpy.passes.pipeline import Target, optimise, prepare

TARGET = Target("scalars", vector=True)
ELEMENTS = 6


def run(module: Module, seed: int) -> list[list[Any]]:
    """Return the components of all outputs for each element."""
    rng = np.random.default_rng(seed)
    inputs = [
        rng.normal(0, 2, ELEMENTS).astype(np.float32),
        rng.normal(0, 2, (ELEMENTS, 3)).astype(np.float32),
        rng.integers(-3, 4, ELEMENTS).astype(np.int32),
        rng.integers(0, 2**32, ELEMENTS).astype(np.uint32),
    ]
    params = {"scale": np.float32(1.5)}
    tables = {"data": np.arange(5, dtype=np.float32), "grid": np.arange(12, dtype=np.float32).reshape(2, 3, 2)}
    interpreter = Interpreter(module, "f32", None)
    ran = (
        interpreter.run_element([array[n] for array in inputs], params, tables, (n,), (ELEMENTS,))
        for n in range(ELEMENTS)
    )
    return [[c for output in outputs for c in np.ravel(output)] for outputs, _ in ran]


@pytest.mark.sampled(6)
@pytest.mark.parametrize("seed", range(60))
def test_random_modules_give_the_same_bits(seed: int) -> None:
    prepared = prepare(random_module(seed), Options(loop_limit=LOOP_LIMIT), TARGET)
    apart = take_apart(prepared.module)
    verify(apart)
    assert all(s.op in ("construct", "swizzle", "call", "table_size", "table") or s.value.type.size == 1
               for s in walk(apart.entry.body) if isinstance(s, Let))  # fmt: skip
    expected = run(prepared.module, seed)
    for module in (apart, optimise(apart)):
        np.testing.assert_array_equal(run(module, seed), expected)


def test_slots_and_values_are_named_by_component() -> None:
    f2 = vec("f", 2)
    b = Builder("twice")
    x = b.input(f2, "x")
    r = b.output(f2, "r")
    b.store(r, b.let("add", x, x, name="sum"))
    module = Module("twice", (Port("x", "Attrib2f"),), (Port("r", "Attrib2f"),), (), (), (b.finish(),))
    apart = take_apart(module)
    assert [o.name for o in apart.entry.outputs] == ["r_x", "r_y"]
    assert [p.name for p in apart.outputs] == ["r_x", "r_y"]
    assert [v.name for v in defined(apart.entry) if v.name] == ["x", "sum_x", "sum_y"]
    assert parse(str(apart)) == apart


def test_what_was_not_lowered_is_refused() -> None:
    b = Builder("far")
    x = b.input(vec("f", 2), "x")
    b.store(b.output(vec("f"), "r"), b.let("length", x))
    module = Module("far", (Port("x", "Attrib2f"),), (Port("r", "Attrib1f"),), (), (), (b.finish(),))
    with pytest.raises(TypeError, match="length does not work on components: it comes after lower"):
        take_apart(module)
