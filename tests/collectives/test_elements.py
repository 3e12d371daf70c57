"""Reductions and scans of unusual elements: those of a NamedTuple, and of shapes of which an axis is empty."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from collectives.definition import target

import shpy as sh
from shpy.backend.registry import NAMES

__all__ = ["target"]


class Part(NamedTuple):
    turned: sh.Matrix2f
    count: sh.Attrib1i


class Step(NamedTuple):
    scale: sh.Attrib1f
    part: Part


@sh.struct
class Pair:
    low: sh.Attrib1f
    high: sh.Attrib1f


@sh.program
def join(a: Step, b: Step) -> Step:
    return Step(a.scale * b.scale, Part(a.part.turned @ b.part.turned, a.part.count + b.part.count))


@sh.program
def widest(a: Pair, b: Pair) -> tuple[sh.Attrib1f, sh.Attrib1f]:
    return sh.min(a.low, b.low), sh.max(a.high, b.high)


def steps(*shape):
    rng = np.random.default_rng(3)
    matrices = rng.integers(-2, 3, (*shape, 2, 2)).astype(np.float32)
    return Step(rng.choice([0.5, 1.0, 2.0], shape), Part(matrices, np.ones(shape, np.int32)))


@pytest.mark.sampled(12)
@pytest.mark.parametrize("n", [1, 7, 200])
def test_elements_of_a_named_tuple(target, n):
    given = steps(n)
    stream = sh.Stream(given, Step, target)
    whole = sh.reduce(join, stream)
    assert type(whole) is Step
    assert type(whole.part) is Part
    assert (whole.scale, whole.part.count) == (np.prod(given.scale), n)
    product = np.eye(2)
    for matrix in given.part.turned:
        product = product @ matrix
    assert np.allclose(whole.part.turned, product)
    prefixes = sh.scan(join, stream)
    assert prefixes.type is Step
    assert np.array_equal(prefixes.numpy().scale, np.cumprod(given.scale))
    assert np.array_equal(prefixes.numpy().part.count, np.arange(1, n + 1))
    before = sh.scan(join, stream, exclusive=True).numpy()
    assert np.array_equal(before.part.count, np.arange(n))
    assert np.array_equal(before.scale[1:], np.cumprod(given.scale)[:-1])


@pytest.mark.sampled(4)
def test_named_tuples_along_an_axis(target):
    given = steps(3, 5)
    rows = sh.reduce(join, sh.Stream(given, Step, target), axis=1)
    assert (rows.type, rows.shape) == (Step, (3,))
    assert np.array_equal(rows.numpy().scale, np.prod(given.scale, axis=1))


@pytest.mark.sampled(4)
def test_a_program_that_returns_a_tuple_combines_structs(target):
    x = np.random.default_rng(1).normal(size=50).astype(np.float32)
    found = sh.reduce(widest, sh.Stream({"low": x, "high": x}, Pair, target))
    assert (found.low, found.high) == (x.min(), x.max())


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("shape", "axis"), [((0, 3), 1), ((3, 0, 4), 0), ((3, 0, 4), 2), ((2, 0), 0)])
@pytest.mark.parametrize("element", [sh.Attrib1f, sh.Attrib3f, sh.Attrib1b])
@pytest.mark.parametrize("name", NAMES)
def test_results_without_elements_have_the_type_of_others(name, shape, axis, element):
    tail = (element.size,) if element.size > 1 else ()
    dtype = np.bool_ if element is sh.Attrib1b else np.float32
    empty = sh.Stream(np.zeros(shape + tail, dtype), element, name)
    full = sh.Stream(np.ones(tuple(n or 1 for n in shape) + tail, dtype), element, "numpy")
    calls = {
        name: getattr(sh.Stream, name) for name in ("argmin", "argmax", "min", "max", "any", "all", "count", "sum")
    }
    if element is not sh.Attrib1b:
        calls["mean"] = sh.Stream.mean
        for method in ("exact", "compensated"):
            calls[method] = lambda s, axis, method=method: s.sum(method=method, axis=axis)
    for spoken, call in calls.items():
        found, like = call(empty, axis=axis), call(full, axis=axis)
        assert (found.type, found.numpy().dtype) == (like.type, like.numpy().dtype), spoken
        assert found.numpy().shape == np.zeros(shape).sum(axis=axis).shape + tail, spoken
