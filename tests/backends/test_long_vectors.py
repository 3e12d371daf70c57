"""Vectors of eight: on every target, uniform and varying in packets, in subroutines, arrays and branches."""

from __future__ import annotations

import pickle
import re
from typing import Any

import numpy as np
import pytest
from backends.running import compiled_anew

import shpy as sh
from shpy import SH_FOR, SH_IF, SH_WHILE
from shpy.ir.parser import parse
from shpy.ir.text import print_module

WAYS = [("numpy", None), *(("opencl", n) for n in (1, 4, 8, 16)), ("glsl", None)]
everywhere = pytest.mark.parametrize(("backend", "lanes"), WAYS)
RNG = np.random.default_rng(8)
A, B = RNG.normal(size=(2, 37, 4)).astype(np.float32)
V = np.concatenate([A, B], axis=1)
N = RNG.integers(-2, 11, 37).astype(np.int32)


def run(program: sh.Program, backend: str, lanes: int | None, *arrays: Any, **options: Any) -> Any:
    """Return the result of a program at a width."""
    return program.compile(backend, lanes=lanes or "auto", **options)(*arrays)


@sh.subroutine
def doubled(v: sh.Attrib8f, factor: sh.Attrib1f) -> sh.Attrib8f:
    v *= factor  # changes the caller's variable, too
    return v + v


@sh.subroutine(alone=True)
def folded(a: sh.Attrib4f, b: sh.Attrib4f, n: sh.Attrib1i) -> sh.Attrib1f:
    v = sh.Attrib8f(a, b)
    k = sh.Attrib1i(0)
    with SH_WHILE(lambda: k < n):
        v[:] = sh.max(v, v[1, 2, 3, 4, 5, 6, 7, 0])
        k += 1
    return v[0]


@sh.program
def mixed(a: sh.Attrib4f, b: sh.Attrib4f, n: sh.Attrib1i) -> tuple[sh.Attrib4f, sh.Attrib4f, sh.Attrib1f, sh.Attrib1f]:
    v = sh.Attrib8f(a, b)
    w = sh.Attrib8f(v)
    twice = doubled(w, 0.5)
    many = sh.Array(sh.Attrib8f, 3)
    with SH_FOR(0, 3) as k:
        many[k] = twice + k
    with SH_IF(n > 3):
        w[5] = v[n]
        w[:] = sh.cond(w > 0, w, many[n])
    return w[0:4], w[7, 6, 5, 4], sh.dot(v, w), folded(a, b, n)


def expected() -> tuple[Any, ...]:
    w, twice = V * np.float32(0.5), V * np.float32(0.5) * 2
    changed = np.array(w)
    changed[:, 5] = V[np.arange(37), np.clip(N, 0, 7)]
    element = twice + np.clip(N, 0, 2)[:, None].astype(np.float32)
    w = np.where((N > 3)[:, None], np.where(changed > 0, changed, element), w)
    dot = np.zeros(37, np.float32)
    for k in range(8):
        dot = dot + V[:, k] * w[:, k] if k else V[:, 0] * w[:, 0]
    folds = np.array([V[i, np.arange(max(n, 0) + 1) % 8].max() for i, n in enumerate(N)])
    return w[:, :4], w[:, :3:-1], dot, folds


@pytest.mark.sampled(6)
@everywhere
def test_vectors_of_eight_meet_everything_else(backend: str, lanes: int | None) -> None:
    for result, right in zip(run(mixed, backend, lanes, A, B, N), expected(), strict=True):
        np.testing.assert_array_equal(result, right)


def test_the_program_travels_and_its_text_is_read_back() -> None:
    module = mixed.ir
    again = parse(print_module(module))
    assert print_module(again) == print_module(module)
    assert re.search(r"swizzle\.s7654", print_module(module))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(mixed))(A, B, N)[0], expected()[0])


@sh.program
def shared(x: sh.Attrib1f, table: sh.Table[sh.Attrib4f]) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_FOR(0, 4) as k:
        row = sh.Attrib8f(table[2 * k], table[2 * k + 1])
        row[:] = sh.max(row, row[4, 5, 6, 7, 0, 1, 2, 3]) * sh.max_lane(sh.cond(x > 2, 1.0, 2.0))
        with SH_IF(sh.any(row > 1e9)):
            total += 1
        total += row[3] * x
    return total


@pytest.mark.sampled(3)
@pytest.mark.parametrize("lanes", [4, 8, 16])
def test_a_packet_keeps_what_all_lanes_share(lanes: int) -> None:
    table = RNG.normal(size=(8, 4)).astype(np.float32)
    x = np.arange(37, dtype=np.float32)
    kernel = compiled_anew(shared, "opencl", lanes=lanes)
    assert "float8" in kernel.source
    most = [2 if (x[k : k + lanes] <= 2).any() else 1 for k in range(0, 37, lanes)]
    factor = np.repeat(np.float32(most), lanes)[:37]
    total = np.zeros(37, np.float32)
    for k in range(4):
        total = total + max(table[2 * k, 3], table[2 * k + 1, 3]) * factor * x
    np.testing.assert_array_equal(kernel(x, table), total)


def test_a_packet_splits_what_differs_from_lane_to_lane() -> None:
    @sh.program
    def rotated(a: sh.Attrib4f, b: sh.Attrib4f) -> sh.Attrib4f:
        v = sh.Attrib8f(a, b)
        with SH_IF(a.x > 0):
            v[:] = v[1, 2, 3, 4, 5, 6, 7, 0]
        return v[0:4] + v[4:8]

    kernel = compiled_anew(rotated, "opencl", lanes=16)
    assert not re.search(r"\bfloat8\b", kernel.source)
    turned = np.where(A[:, :1] > 0, np.roll(V, -1, axis=1), V)
    np.testing.assert_array_equal(kernel(A, B), turned[:, :4] + turned[:, 4:])


@pytest.mark.sampled(6)
@everywhere
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_at_other_precisions(backend: str, lanes: int | None, precision: str) -> None:
    if precision == "f64" and backend == "glsl":
        return
    kind = {"f16": np.float16, "f64": np.float64}[precision]
    results = run(mixed, backend, lanes, A, B, N, precision=precision)
    np.testing.assert_array_equal(results[0], run(mixed, "numpy", None, A, B, N, precision=precision)[0])
    assert results[0].dtype == kind


NEWER = ("expm1", "log1p", "exp10", "cbrt", "erf", "erfc", "sinpi", "cospi", "hypot")


def summed(v: Any) -> Any:
    """Return a sum of elementary functions of a vector, each after half of those before."""
    total = v * 0
    for name in NEWER:
        total = total * 0.5 + getattr(sh, name)(v, *[1 - v] * (name == "hypot"))
    return total


@sh.program
def of_eight(a: sh.Attrib4f, b: sh.Attrib4f) -> tuple[sh.Attrib4f, sh.Attrib4f]:
    total = summed(sh.Attrib8f(a, b))
    return total[0:4], total[4:8]


@sh.program
def of_four(a: sh.Attrib4f) -> sh.Attrib4f:
    return summed(a)


@pytest.mark.sampled(30)  # each width and each option once
@everywhere
@pytest.mark.parametrize(
    "options", [{}, {"fuse": True}, {"precision": "f16"}, {"precision": "f64"}, {"math": "portable"}], ids=str
)
def test_functions_of_eight_are_those_of_four(backend: str, lanes: int | None, options: dict[str, Any]) -> None:
    if options.get("precision") == "f64" and backend == "glsl":
        return
    low, high = run(of_eight, backend, lanes, A * 0.5, B * 0.5, **options)
    assert np.isfinite(low).mean() > 0.8
    np.testing.assert_array_equal(low, run(of_four, "numpy", None, A * 0.5, **options))
    np.testing.assert_array_equal(high, run(of_four, "numpy", None, B * 0.5, **options))


def test_vectors_of_eight_stay_inside() -> None:
    eight = sh.Attrib8f

    def into(x: sh.Attrib8f) -> sh.Attrib1f:
        return x[0]

    def out(x: sh.Attrib1f):
        return sh.Attrib8f(x)

    gain = sh.Param(sh.Attrib1f, 2, name="gain")
    for misuse in (
        lambda: sh.program(into),
        lambda: sh.program(out),
        lambda: sh.Param(eight, range(8)),
        lambda: sh.Table(np.zeros((3, 8)), eight),
        lambda: sh.Table[eight],
        lambda: sh.Stream(np.zeros((3, 8)), eight, backend="numpy"),
    ):
        with pytest.raises(sh.ShpyTypeError, match="is an Attrib8f, and vectors of eight live inside of programs"):
            misuse()
    with pytest.raises(sh.ShpyTypeError, match="an Attrib8f follows no Param outside of a program"):
        sh.Attrib8f(gain)
    with pytest.raises(sh.ShpyIndexError, match="5 components are picked"):
        sh.Attrib8f(1)[0:5]
    assert np.asarray(sh.Attrib8f(1) + 1).tolist() == [2] * 8
    assert not hasattr(sh, "Point8f")
