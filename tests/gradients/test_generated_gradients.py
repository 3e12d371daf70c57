"""Gradients of generated programs: forward mode agrees with reverse mode at f64, and each has the same bits everywhere.

`pytest -m slow` and the name of this file runs 2,000 programs at f64, and 500 of them on GLSL and in packets of every
width. At kinks the two modes may meet an infinity in different places, so numbers count where both are finite.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

import shpy as sh
from shpy.testing.denormals import meets_denormals
from shpy.testing.generated.inputs import elements
from shpy.testing.generated.source import record, source
from shpy.testing.generated.strategy import trees
from shpy.testing.generated.syntax import Tree
from shpy.testing.observers import Setting
from tests.backends.running import differs, flushes_denormals, run

COUNT = 24
LIMIT = 4096
quietly = settings(
    max_examples=4,
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


def derivative(tree: Tree) -> sh.Program | None:
    """Return the program of the gradient of the sum of a program's floats, in both modes; None where there is none.

    The sum goes through a variable and an array around the function, whose contents are outputs too.
    """
    program = record(tree)
    names = list(program.inputs)
    wrt = tuple(n for n in names if n in ("a", "v"))
    if not wrt or not any(cls.type.is_float for cls in program.outputs.values()):
        return None

    def total(kept: Any, last: Any, **arguments: Any) -> Any:
        results = program(**arguments)
        sum_ = sh.Attrib1f(0)
        for x in results if isinstance(results, tuple) else (results,):
            if type(x).type.is_float:
                for component in [x] if type(x).size == 1 else list(x):
                    sum_ = sum_ + sh.Attrib1f(component)
        kept[1] = sum_ * 0.5 + kept[0]
        last[:] = last + kept[1]
        return sum_ + last

    def derived(mode: str, arguments: dict[str, Any]) -> list[Any]:
        kept, last = sh.Array(sh.Attrib1f, [1, 2]), sh.Attrib1f(0)
        f = functools.partial(total, kept, last)
        f.inputs = program.inputs  # type: ignore[attr-defined]
        slopes = sh.gradient(f, wrt, mode=mode, most=COUNT)(**arguments)  # type: ignore[arg-type]
        return [*slopes, kept[0], kept[1], last]

    annotated = ", ".join(f"{n}: T_{n}" for n in names)
    space: dict[str, Any] = {"sh": sh, "derived": derived, **{f"T_{n}": t for n, t in program.inputs.items()}}
    args = f"dict({', '.join(f'{n}={n}' for n in names)})"
    text = f"return (*derived('forward', {args}), *derived('reverse', {args}))"
    try:
        exec(f"@sh.program\ndef slopes({annotated}):\n    {text}\n", space)
    except sh.RecordError as error:
        if "does not depend on" not in error.message:
            raise
        return None
    slopes: sh.Program = space["slopes"]
    return slopes


def outputs_of(program: sh.Program, target: str, **options: Any) -> tuple[list[Any], Any]:
    inputs = [INPUTS[n] for n in program.inputs]
    try:
        result = run(program, target, *inputs, loop_limit=LIMIT, **options)
    except sh.LoopLimitExceeded as error:
        result = error.result
    return list(result.outputs), result.written


def check_modes(tree: Tree) -> None:
    """Compare the gradients of both modes at f64. Where terms cancel, errors at f32 are some 2**29 times as large."""
    program = derivative(tree)
    if program is None:
        return
    results, written = outputs_of(program, "numpy", precision="f64")
    half = len(results) // 2
    for a, b in zip(results[:half], results[half:], strict=True):
        with np.errstate(all="ignore"):
            counts = np.isfinite(a) & np.isfinite(b) & np.reshape(written, (-1,) + (1,) * (a.ndim - 1))
            apart = np.abs(a - b)
            wrong = counts & ~(apart < 1e-13 * (1 + np.abs(a) + np.abs(b)))
            if wrong.any():
                singles, _ = outputs_of(program, "numpy")
                lost = np.concatenate([np.abs(x - y).ravel() for x, y in zip(singles, results, strict=True)])
                wrong &= apart > 2.0**-26 * lost.max(where=np.isfinite(lost), initial=0)
        assert not wrong.any(), f"forward {a[wrong]}, reverse {b[wrong]}\n{source(tree)}"


def check_bits(tree: Tree, target: str) -> None:
    """Compare the gradients on a target and on numpy, but of elements whose denormals a device flushes on the way."""
    program = derivative(tree)
    if program is None:
        return
    expected, _ = outputs_of(program, "numpy")
    for k, (a, b) in enumerate(zip(outputs_of(program, target)[0], expected, strict=True)):
        off = differs(a, b)
        wrong = off.any(axis=-1) if off.ndim > 1 else off
        if wrong.any() and flushes_denormals(target):
            inputs = tuple(INPUTS[n] for n in program.inputs)
            wrong &= ~meets_denormals(Setting(program, inputs, {}, None, {"loop_limit": LIMIT}))
        assert not wrong.any(), f"output {k} on {target}\n{source(tree)}"


@pytest.mark.sampled(500)
@pytest.mark.parametrize("shard", range(500))
def test_both_modes_agree(shard: int) -> None:
    @quietly
    @given(trees())
    def run_one(tree: Tree) -> None:
        check_modes(tree)

    seed(f"gradients {shard}")(run_one)()


@pytest.mark.sampled(125)
@pytest.mark.parametrize("shard", range(125))
def test_gradients_have_the_same_bits(shard: int) -> None:
    target = ("opencl-1", "opencl-4", "opencl-8", "glsl", "opencl-16", "opencl-64", "opencl-32")[shard % 7]

    @quietly
    @given(trees())
    def run_one(tree: Tree) -> None:
        check_bits(tree, target)

    seed(f"gradients {shard}")(run_one)()
