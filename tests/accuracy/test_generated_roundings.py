"""Roundings of generated programs: the bound holds in every element.

`pytest -m slow` and the name of this file bounds 2,000 programs. Of an element beyond its bound, the interpreter's
steps at f32 and f64 are compared. It counts unless there

- a bool or an int differs, or the two take other steps: a branch or an index flips, so the result jumps, which no
  derivative shows; or
- a float has lost half its bits, so that terms of the second order count.

Results and bounds that are not finite do not count either, since there is nothing to compare. Of 48,000 elements of the
2,000 programs, 35,938 have finite bounds; one of these flips, and eight are excluded for the second reason.
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
    trail: list[tuple[Any, Any]] = []
    setting = Setting(program, tuple(inputs), options={"precision": precision})
    params, data = setting.data()
    run = Interpreter(program.ir, precision, LIMIT)
    run.run_element(
        list(setting.element(element).values()),
        params,
        data,
        setting.index(element),
        setting.element_shape,
        trace=lambda loc, name, value, iterations: trail.append((loc, np.array(value))),
    )
    return trail


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


def weighted(tree: Tree) -> sh.Program | None:
    """Return a sum of all floats that a generated program gives, None if it has no float or no input of floats."""
    program = record(tree)
    if not {"a", "v"} & set(program.inputs) or not any(cls.type.is_float for cls in program.outputs.values()):
        return None

    def total(**arguments: Any) -> Any:
        results = program(**arguments)
        sum_ = sh.Attrib1f(0)
        for k, x in enumerate(results if isinstance(results, tuple) else (results,)):
            if type(x).type.is_float:
                for component in [x] if type(x).size == 1 else list(x):
                    sum_ = sum_ + sh.Attrib1f(component) * (0.7 + k / 10)
        return sum_

    space: dict[str, Any] = {"sh": sh, "total": total, **{f"T_{n}": t for n, t in program.inputs.items()}}
    annotated = ", ".join(f"{n}: T_{n}" for n in program.inputs)
    call = f"total({', '.join(f'{n}={n}' for n in program.inputs)})"
    exec(f"@sh.program\ndef sums({annotated}) -> sh.Attrib1f:\n    return {call}\n", space)
    sums: sh.Program = space["sums"]
    return sums


def check(tree: Tree) -> None:
    program = weighted(tree)
    if program is None:
        return
    inputs = [INPUTS[n] for n in program.inputs]
    domain = dict(zip(program.inputs, inputs, strict=True))
    report = sh.accuracy.roundings(program, domain, samples=COUNT, most=COUNT)
    result = program.compile("numpy", loop_limit=LIMIT).run(*inputs)
    with np.errstate(all="ignore"):
        beyond = np.abs(result.outputs - report.values) > report.bounds * (1 + LOST)
        counts = np.isfinite(result.outputs) & np.isfinite(report.values) & np.isfinite(report.bounds) & result.written
    for n in np.flatnonzero(beyond & counts):
        numbers = f"element {n}: {result.outputs[n]}, {report.values[n]}, {report.bounds[n]}"
        assert excluded(program, inputs, int(n)) is not None, f"{numbers}\n{source(tree)}"


@pytest.mark.sampled(500)
@pytest.mark.parametrize("shard", range(500))
def test_the_bound_holds(shard: int) -> None:
    @quietly
    @given(trees())
    def run_one(tree: Tree) -> None:
        check(tree)

    seed(f"roundings {shard}")(run_one)()
