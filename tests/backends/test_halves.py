"""Functions of binary16: every result of strict mode is the exact value, rounded once."""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np
import pytest
from backends.running import flushes_denormals
from backends.test_math_modes import REFERENCES, UNARY, program

import shpy as sh
from shpy.ir.ops import OPS
from shpy.passes.formulas.strict.halves import EXCEPTIONS
from shpy.testing.arrays import differing

ALL = np.arange(1 << 16, dtype=np.uint16).view(np.float16)


def rounded(name: str) -> Any:
    """Return the exact values rounded: numpy's in binary64 where they decide, else mpmath's, in 200 bits."""
    with np.errstate(all="ignore"):
        values = np.asarray(OPS[name].meaning(ALL.astype(np.float64)))
        results, ends = (
            values.astype(np.float16),
            [(values * (1 + e)).astype(np.float16) for e in (-(2.0**-46), 2.0**-46)],
        )
    for n in np.flatnonzero((ends[0] != ends[1]) & ~np.isnan(values)):
        with mp.workprec(200):
            exact = REFERENCES[name](mp.mpf(float(ALL[n])))
            low, high = sorted(map(float, (ends[0][n], ends[1][n])))
            middle = (mp.mpf(low) + high) / 2
            even = float(results[n])  # a tie, which numpy has rounded to even
            results[n] = low if exact < middle else high if exact > middle else even
    return results


@pytest.mark.sampled(36)
@pytest.mark.parametrize("name", UNARY)
def test_all_binary16_are_the_exact_value_rounded_everywhere(name: str) -> None:
    wanted = rounded(name)
    for backend, options in (("numpy", {}), ("opencl", {"lanes": 1}), ("opencl", {"lanes": 16}), ("glsl", {})):
        found = program(name).compile(backend, precision="f16", **options)(ALL)
        wrong = differing(found, wanted)
        if flushes_denormals(backend):
            wrong &= ~((np.abs(wanted) < 2.0**-14) | (np.abs(ALL) < 2.0**-14))
        assert not wrong.any(), [(backend, x, y) for x, y in zip(ALL[wrong], found[wrong], strict=True)][:5]


def test_hypotenuses_of_binary16_are_the_exact_value_rounded_everywhere() -> None:
    # In binary64 the sum of the squares is exact wherever the root is close to the middle of two binary16.
    rng = np.random.default_rng(4)
    x = rng.integers(0, 1 << 16, 1 << 18, dtype=np.uint16)
    y = (x + rng.integers(-6 << 10, 6 << 10, 1 << 18)).astype(np.uint16)
    x, y = (np.concatenate([v.view(np.float16), ALL[k::64]]) for v, k in ((x, 0), (y, 7)))
    with np.errstate(all="ignore"):
        root = np.sqrt(x.astype(np.float64) ** 2 + y.astype(np.float64) ** 2).astype(np.float16)
    wanted = np.where(np.isinf(x) | np.isinf(y), np.float16(np.inf), root)
    for backend, options in (("numpy", {}), ("opencl", {"lanes": 1}), ("opencl", {"lanes": 16}), ("glsl", {})):
        found = program("hypot").compile(backend, precision="f16", **options)(x, y)
        wrong = differing(found, wanted)
        if flushes_denormals(backend):
            wrong &= (np.abs(x) >= 2.0**-14) & (np.abs(y) >= 2.0**-14)
        assert not wrong.any(), [(backend, *row) for row in zip(x[wrong], y[wrong], found[wrong], strict=True)][:5]


def test_each_exception_is_rounded_wrong_by_way_of_binary32() -> None:
    for name, exceptions in EXCEPTIONS.items():
        x, values = np.array(exceptions, np.float16).T
        found = program(name).compile("numpy", precision="f16", math="portable")(x)
        assert (found != values).any(), name


def test_functions_of_vectors_are_rounded_once() -> None:
    @sh.program
    def spread(x: sh.Attrib3f) -> sh.Attrib3f:
        return sh.tan(x)

    x = np.array([[94.8125, -94.8125, 0.5]], np.float16)
    for backend in ("numpy", "opencl", "glsl"):
        found = spread.compile(backend, precision="f16")(x)
        assert found.tolist() == [[0.63330078125, -0.63330078125, 0.54638671875]]
