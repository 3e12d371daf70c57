"""Gradients of generated programs: forward mode agrees with reverse mode at f64, and each has the same bits everywhere.

`pytest -m slow` and the name of this file runs 2,000 programs. At kinks the two modes may meet an infinity in different
places, so numbers count where both are finite.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

import shpy as sh
from shpy.testing.generated.inputs import elements
from shpy.testing.generated.source import record, source
from shpy.testing.generated.strategy import trees
from shpy.testing.generated.syntax import Tree
from tests.backends.running import differs, run

COUNT = 24
LIMIT = 4096
quietly = settings(
    max_examples=5,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.generate],
    print_blob=False,
)


def moderate() -> list[Any]:
    """Return the inputs of generated programs, with floats that no sum of products takes to infinity."""
    rng = np.random.default_rng(0)
    return [
        np.where(np.isfinite(a) & (np.abs(a) < 100), a, rng.uniform(-2, 2, a.shape)).astype(a.dtype)
        if a.dtype.kind == "f"
        else a
        for a in elements(COUNT)
    ]


INPUTS = dict(zip("avnh", moderate(), strict=True))


def derivative(tree: Tree, mode: str) -> sh.Program | None:
    """Return the gradient of the sum of a program's floats; None where there is none, or reverse mode refuses."""
    program = record(tree)
    names = list(program.inputs)
    wrt = tuple(n for n in names if n in ("a", "v"))
    if not wrt or not any(cls.type.is_float for cls in program.outputs.values()):
        return None

    def total(**arguments: Any) -> Any:
        results = program(**arguments)
        sum_ = sh.Attrib1f(0)
        for x in results if isinstance(results, tuple) else (results,):
            if type(x).type.is_float:
                for component in [x] if type(x).size == 1 else list(x):
                    sum_ = sum_ + sh.Attrib1f(component)
        return sum_

    total.inputs = program.inputs  # type: ignore[attr-defined]
    annotated = ", ".join(f"{n}: T_{n}" for n in names)
    space: dict[str, Any] = {"sh": sh, "total": total, **{f"T_{n}": t for n, t in program.inputs.items()}}
    call = f"sh.gradient(total, {wrt}, mode={mode!r}, most={COUNT})({', '.join(f'{n}={n}' for n in names)})"
    try:
        exec(f"@sh.program\ndef slopes({annotated}):\n    return {call}\n", space)
    except sh.RecordError as error:
        if "does not depend on" in error.message or error.message.startswith("reverse mode"):
            return None
        raise
    slopes: sh.Program = space["slopes"]
    return slopes


def outputs_of(program: sh.Program, target: str, **options: Any) -> tuple[list[Any], Any]:
    inputs = [INPUTS[n] for n in program.inputs]
    try:
        result = run(program, target, *inputs, loop_limit=LIMIT, **options)
    except sh.LoopLimitExceeded as error:
        result = error.result
    return list(result.outputs), result.written


def check(tree: Tree, target: str) -> None:
    wide: dict[str, Any] = {}
    for mode in ("forward", "reverse"):
        program = derivative(tree, mode)
        if program is None:
            continue
        wide[mode], written = outputs_of(program, "numpy", precision="f64")
        expected, _ = outputs_of(program, "numpy")
        for a, b in zip(outputs_of(program, target)[0], expected, strict=True):
            with np.errstate(all="ignore"):
                flushed = np.abs(a.astype(np.float64) - b) < 1e-30
            assert not (differs(a, b) & ~flushed).any(), f"{mode} on {target}\n{source(tree)}"
    if len(wide) == 2:
        for a, b in zip(wide["forward"], wide["reverse"], strict=True):
            with np.errstate(all="ignore"):
                counts = np.isfinite(a) & np.isfinite(b) & (np.abs(a) < 1e12)
                counts &= np.reshape(written, (-1,) + (1,) * (a.ndim - 1))
                error = np.abs(a - b) / (1 + np.abs(a) + np.abs(b))
            assert (error[counts] < 1e-9).all(), f"forward {a[counts]}, reverse {b[counts]}\n{source(tree)}"


@pytest.mark.sampled(400)
@pytest.mark.parametrize("shard", range(400))
def test_gradients_of_generated_programs(shard: int) -> None:
    target = ("opencl-1", "glsl", "opencl-8", "glsl", "opencl-16")[shard % 5]

    @quietly
    @given(trees())
    def run_one(tree: Tree) -> None:
        check(tree, target)

    seed(f"gradients {shard}")(run_one)()
