"""sh.unique gives the distinct elements, sh.top_k the greatest ones, with the same bits on every backend."""

import re

import numpy as np
import pytest
from collectives.generated import LARGE, assert_same_bits, by_programs, floats, generated, moved, stream

import shpy as sh

__all__ = ["by_programs", "moved"]


@sh.struct
class Ball:
    at: sh.Point2f
    mass: sh.Attrib1f


@sh.program
def mass(ball: Ball) -> sh.Attrib1f:
    return ball.mass


def distinct(x):
    """Return the first of each class of equal elements, in ascending order, and the size of its class, by a dict."""
    classes = {}
    for value in x:
        found = classes.setdefault("nan" if np.isnan(value) else float(value), [value, 0])
        found[1] += 1
    order = sorted(key for key in classes if key != "nan") + ["nan"] * ("nan" in classes)
    values = np.array([classes[key][0] for key in order], np.float32)
    return values, np.array([classes[key][1] for key in order], np.int32)


def check_unique(backend, count, seed, **options):
    for n, rng in generated(count, seed, **options):
        x = floats(rng, n)
        values, counts = distinct(x)
        found = sh.unique(stream(x, sh.Attrib1f, backend))
        assert_same_bits(found.elements, values)
        assert_same_bits(found.counts, counts)


def check_top_k(backend, count, seed, **options):
    for n, rng in generated(count, seed, **options):
        x, k = floats(rng, n), int(rng.integers(n + 1))
        order = sorted(range(n), key=lambda i: (not np.isnan(x[i]), 0.0 if np.isnan(x[i]) else -float(x[i])))[:k]
        found = sh.top_k(stream(x, sh.Attrib1f, backend), k)
        assert_same_bits(found.indices, np.array(order, np.int32))
        assert_same_bits(found.elements, x[order] if k else x[:0])


@pytest.mark.sampled(3)
def test_distinct_elements(moved):
    check_unique(moved, 60, 1)


@pytest.mark.sampled(3)
def test_many_distinct_elements(moved):
    check_unique(moved, 6, 2, sizes=LARGE[:6])


@pytest.mark.sampled(3)
def test_the_greatest_elements(moved):
    check_top_k(moved, 150, 3)


def test_the_greatest_of_many_elements(moved):
    check_top_k(moved, 6, 4, sizes=LARGE[:6])


@pytest.mark.slow
def test_programs_do_the_same(by_programs):
    check_unique(by_programs, 60, 5)
    check_top_k(by_programs, 60, 6)


@pytest.mark.sampled(3)
def test_ints_bools_and_several_axes(moved):
    x = np.int32([[3, -1, 3], [2**31 - 1, -(2**31), 3]])
    found = sh.unique(stream(x, sh.Attrib1i, moved))
    assert found.elements.numpy().tolist() == [-(2**31), -1, 3, 2**31 - 1]
    assert found.counts.numpy().tolist() == [1, 1, 3, 1]
    found = sh.unique(stream(x > 2, sh.Attrib1b, moved))
    assert (found.elements.numpy().tolist(), found.counts.numpy().tolist()) == ([False, True], [2, 4])
    assert found.elements.backend == found.counts.backend == moved


@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_floats_of_other_sizes(precision):
    x = sh.Stream([np.nan, 0.5, -0.0, np.nan, 0.0, 0.5], sh.Attrib1f, "numpy", precision=precision)
    found = sh.unique(x)
    assert str(found.elements.numpy().tolist()) == "[-0.0, 0.5, nan]"
    assert found.counts.numpy().tolist() == [2, 2, 2]


def test_the_greatest_structs_by_a_key(moved):
    rng = np.random.default_rng(7)
    at, masses = rng.random((40, 2), np.float32), rng.permutation(40).astype(np.float32)
    found = sh.top_k(stream({"at": at, "mass": masses}, Ball, moved), 3, key=mass)
    order = np.argsort(-masses)[:3]
    assert found.elements.type is Ball
    assert_same_bits(found.elements.numpy().at, at[order])
    assert_same_bits(found.indices, order.astype(np.int32))


@pytest.mark.parametrize("k", [-1, 5, 2.0, True])
def test_a_k_that_does_not_fit(k):
    with pytest.raises(sh.ShpyTypeError, match=re.escape(f"k={k!r}")) as error:
        sh.top_k(stream(np.zeros(4), sh.Attrib1f, "numpy"), k)
    assert "an int from 0 to 4" in str(error.value)
    assert "test_choosing.py" in str(error.value)


def test_vectors_have_no_order():
    x = stream(np.zeros((4, 2)), sh.Attrib2f, "numpy")
    with pytest.raises(sh.ShpyTypeError, match="elements of several components, which have no order") as error:
        sh.unique(x)
    assert "sh.unique(number(stream))" in str(error.value)
    with pytest.raises(sh.ShpyTypeError, match=re.escape("sh.top_k(stream, key=program)")):
        sh.top_k(x, 2)
