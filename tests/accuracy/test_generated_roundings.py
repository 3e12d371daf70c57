"""Roundings of generated programs: the bound holds in every element.

`pytest -m slow` and the name of this file runs 2,000 programs. Of an element beyond its bound, the interpreter's steps
at f32 and f64 are compared. It counts unless there

- a bool or an int differs, or the two take other steps: a branch or an index flips, so the result jumps, which no
  derivative shows; or
- a float has lost half its bits, so that terms of the second order count.

Results and bounds that are not finite do not count either, since there is nothing to compare, nor do programs that
reverse mode refuses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, seed

import shpy as sh
from shpy.ir.interpreter import Interpreter
from shpy.testing.generated.source import record, source
from shpy.testing.generated.strategy import trees
from shpy.testing.generated.syntax import Tree
from shpy.testing.observers import Setting
from tests.gradients.test_generated_gradients import COUNT, INPUTS, LIMIT, quietly

LOST = 2.0**-12


def steps(program: sh.Program, inputs: list[Any], element: int, precision: str) -> list[tuple[Any, Any]]:
    """Return the lines and values of an element's steps."""
    found: list[tuple[Any, Any]] = []
    setting = Setting(program, tuple(inputs), options={"precision": precision})
    params, data = setting.data()
    run = Interpreter(program.ir, precision, LIMIT)
    run.run_element(
        list(setting.element(element).values()),
        params,
        data,
        setting.index(element),
        setting.element_shape,
        trace=lambda loc, name, value, iterations: found.append((loc, np.array(value))),
    )
    return found


def excluded(program: sh.Program, inputs: list[Any], element: int) -> str | None:
    """Return why an element does not count, None if it does."""
    narrow, wide = (steps(program, inputs, element, p) for p in ("f32", "f64"))
    if [loc for loc, _ in narrow] != [loc for loc, _ in wide]:
        return "flips"
    for (_, a), (_, b) in zip(narrow, wide, strict=True):
        if a.dtype.kind != "f":
            if (a != b).any():
                return "flips"
        elif (np.abs(a - b) > LOST * np.abs(b)).any():
            return "second order"
    return None


def check(tree: Tree) -> None:
    program = record(tree)
    names = [n for n, cls in program.outputs.items() if cls.size == 1 and cls.type.is_float]
    inputs = [INPUTS[n] for n in program.inputs]
    if not names or not {"a", "v"} & set(program.inputs):
        return
    try:
        report = sh.accuracy.roundings(
            program, dict(zip(program.inputs, inputs, strict=True)), output=names[0], samples=COUNT, most=COUNT
        )
    except sh.RecordError as error:
        if not error.message.startswith("reverse mode"):
            raise
        return
    result = program.compile("numpy", loop_limit=LIMIT).run(*inputs)
    outputs = result.outputs if isinstance(result.outputs, tuple) else (result.outputs,)
    found = outputs[list(program.outputs).index(names[0])]
    with np.errstate(all="ignore"):
        beyond = np.abs(found - report.values) > report.bounds * (1 + LOST)
        counts = np.isfinite(found) & np.isfinite(report.values) & np.isfinite(report.bounds) & result.written
    for element in np.flatnonzero(beyond & counts):
        why = excluded(program, inputs, int(element))
        assert why is not None, (
            f"element {element}: {found[element]}, {report.values[element]}, {report.bounds[element]}\n{source(tree)}"
        )


@pytest.mark.sampled(200)
@pytest.mark.parametrize("shard", range(400))
def test_the_bound_holds(shard: int) -> None:
    @quietly
    @given(trees())
    def run_one(tree: Tree) -> None:
        check(tree)

    seed(f"roundings {shard}")(run_one)()
