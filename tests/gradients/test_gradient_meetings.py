"""Derivatives in threads, on a backend that changes, after edits of a file, and `first_nan` in the stress mode."""

from __future__ import annotations

import importlib
import sys
import threading
from pathlib import Path
from typing import Any

import dask
import dask.array as da
import numpy as np
import pytest
from stress.mode import stressed

import shpy as sh
from shpy import SH_BREAK, SH_FOR
from shpy.run import tiers
from tests.test_auto import EAGER, X as LONG, same

RNG = np.random.default_rng(8)
X, N = RNG.random(60).astype(np.float32), RNG.integers(0, 9, 60).astype(np.int32)
PLACES = RNG.random((13, 17, 3)).astype(np.float32)
heights = sh.Table(RNG.random((4, 5)), sh.Attrib1f, name="heights")


@sh.program
def walked(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_FOR(0, 9) as k:
        SH_BREAK(k > n)
        total += heights[k % 4, sh.Attrib1i(x * 5)] * 2
    return total * total


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("backend", "precision"), [("numpy", "f32"), ("opencl", "f16")])
def test_threads_that_derive_at_once(backend: str, precision: Any) -> None:
    """Each thread records the derivative, or they share one, and all make the first call at the same time."""
    shared, barrier = sh.value_and_gradient(walked, heights), threading.Barrier(4)
    results: list[Any] = [None] * 4

    def call(k: int) -> None:
        barrier.wait()
        step = sh.value_and_gradient(walked, heights) if k % 2 else shared
        results[k] = step(X, N, backend=backend, precision=precision)

    threads = [threading.Thread(target=call, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    value, slopes = shared(X, N, backend="numpy", precision=precision)
    assert slopes.dtype == np.dtype(precision.replace("f", "float"))
    for again, others in results:
        assert again == value
        assert np.array_equal(others, slopes)
    assert np.allclose(slopes, shared(X, N, backend="numpy", precision="f64")[1], rtol=1e-2)


@sh.program
def folded(x: sh.Attrib1f) -> sh.Attrib1f:
    kept = sh.Array(sh.Attrib1f, [1, 2])

    def f(q: Any) -> Any:
        kept[1] = sh.exp(-q * q) * kept[0] + kept[1]
        return kept[1] * q

    return sh.gradient(f, mode="reverse")(x) + kept[1]


def test_threads_share_a_gradient_while_auto_changes_its_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    """The function stores into an array around it, and is derived twice; OpenCL takes over with the same bits."""
    for name, value in EAGER.items():
        monkeypatch.setattr(tiers, name, value)
    slopes = folded.gradient("x", mode="reverse")
    kernel, expected, results = slopes.compile("auto"), slopes.compile("numpy")(LONG), list[Any]()
    threads = [threading.Thread(target=lambda: results.extend(kernel(LONG) for _ in range(4))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert kernel.runs_on == "opencl"
    assert [same(result, expected) for result in results] == [True] * 16


WEIGHT = sh.Param(sh.Attrib1f, 0.75, name="weight")


@sh.subroutine
def root(c: sh.Attrib1f) -> sh.Attrib1f:
    x = sh.Attrib1f(1)
    with SH_FOR(0, 12):
        x -= (x * x * x + x - c) / (3 * x * x + 1)
    return x


@root.tangent
def root_tangent(x: Any, c: Any, d_c: Any) -> Any:
    return d_c / (3 * x * x + 1)


@sh.program
def bent(x: sh.Attrib3f, k: sh.Attrib1f) -> sh.Attrib1f:
    return root(sh.dot(x, x) * WEIGHT) * sh.sin(k)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_derivatives_are_computed_in_other_processes(mode: Any) -> None:
    """A gradient by an input and a Param, through a rule of its own, and one whose function stores into an array."""

    @sh.program
    def placed(x: sh.Attrib3f, k: sh.Attrib1f) -> tuple[sh.Attrib3f, sh.Attrib1f]:
        kept = sh.Array(sh.Attrib1f, [1, 2])

        def f(q: Any) -> Any:
            kept[1] = root(sh.dot(q, q) * WEIGHT) * kept[0] + kept[1]
            return kept[1] * sh.sin(k)

        return sh.gradient(f, mode=mode)(x), kept[1]

    kernels = [p.compile("numpy") for p in (bent.gradient("x", WEIGHT, mode=mode, value=True), placed)]
    expected = [array for kernel in kernels for array in kernel(PLACES, X[:17])]
    cut = da.from_array(PLACES, chunks=(5, 17, 3))
    blocks = [array for kernel in kernels for array in sh.map_blocks(kernel, cut, X[:17])]
    with dask.config.set(scheduler="processes", num_workers=1):
        for a, b in zip(dask.compute(*blocks), expected, strict=True):
            assert a.tobytes() == b.tobytes()


TEXT = """import shpy as sh
from shpy import SH_FOR
gain = sh.Param(sh.Attrib1f, 2.0, name="gain")

@sh.subroutine
def square(c: sh.Attrib1f) -> sh.Attrib1f:
    return c * c

@square.tangent
def square_tangent(y, c, d_c):
    return 2 * c * d_c

def height(p):
    return square(p.x) * gain

@sh.program
def slope(p: sh.Attrib2f) -> sh.Attrib2f:
    return sh.gradient(height)(p)

@sh.program
def error(p: sh.Attrib2f) -> sh.Attrib1f:
    return height(p)
"""
EDITS = {
    "2 * c * d_c": ("5 * c * d_c", [30, 0], 9),
    "square(p.x)": ("square(p.y)", [0, 10], 1),
    "* gain": ("* gain * gain", [0, 20], 4),
}


def test_derivatives_after_edits_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rule of a tangent, the function that is derived, and a Param that it reads."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    file, text = tmp_path / "derived_and_edited.py", TEXT
    file.write_text(text)
    module = importlib.import_module("derived_and_edited")
    assert module.slope([3, 1]).tolist() == [12, 0]
    for before, (after, slopes, by_gain) in EDITS.items():
        text = text.replace(before, after)
        file.write_text(text)
        importlib.reload(module)
        assert module.slope([3, 1]).tolist() == slopes
        assert module.error.gradient("p")([3, 1]).d_p.tolist() == slopes
        assert sh.value_and_gradient(module.error, module.gain)([3, 1])[1] == by_gain
    file.write_text(
        text.replace("    return square", "    n = 0\n    with SH_FOR(0, 3):\n        n = n + 1\n    return n * square")
    )
    with pytest.raises(sh.RecordError, match="`n` is rebound inside"):
        importlib.reload(module).slope([3, 1])


@sh.program
def sharpen(u: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
    i = sh.grid_index(1)
    return sh.sqrt(u[i - 1] + u[i + 1] - u[i])


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["numpy", "opencl"])
def test_the_first_nan_of_a_chain_in_the_stress_mode(backend: str) -> None:
    for seed in range(3):
        with stressed(seed):
            first = sh.testing.first_nan(sh.repeat(sharpen, 50), u=[4, 5, 6, 8, 7, 5], shape=6, backend=backend)
        assert first is not None
        assert (first.program, first.run, first.element) == ("sharpen", 8, (2,))
        assert first.text.startswith("sqrt(")
