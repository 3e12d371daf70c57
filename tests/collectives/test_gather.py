"""sh.gather reads the element at each index, the nearest one where it is out of range."""

import re

import numpy as np
import pytest
from collectives.generated import LARGE, OFTEN, assert_same_bits, by_programs, floats, generated, moved, stream

import shpy as sh

__all__ = ["by_programs", "moved"]


def check(backend, count, seed, **options):
    for n, rng in generated(count, seed, **options):
        x = floats(rng, max(n, 1))
        index = rng.integers(-3, len(x) + 3, rng.choice([n, 2 * n + 1, n // 3])).astype(np.int32)
        given = stream(x, sh.Attrib1f, backend)
        assert_same_bits(sh.gather(given, stream(index, sh.Attrib1i, backend)), x[index.clip(0, len(x) - 1)])


@pytest.mark.sampled(3)
def test_elements_at_indices(moved):
    check(moved, OFTEN, 1)


def test_many_elements(moved):
    check(moved, 11, 2, sizes=LARGE)


@pytest.mark.sampled(2)
def test_programs_do_the_same(by_programs):
    check(by_programs, 100, 5)


@pytest.mark.slow
def test_elements_at_indices_at_length(moved):
    check(moved, 10_000, 3)


def test_the_result_has_the_shape_of_the_index(moved):
    x = np.arange(12, dtype=np.float32).reshape(3, 4)
    index = np.array([[0, 5], [11, 99], [-1, 2**40]])
    found = sh.gather(stream(x, sh.Attrib1f, moved), index)
    assert_same_bits(found, x.reshape(-1)[index.clip(0, 11)])


def test_no_index_gives_no_element(moved):
    found = sh.gather(stream([1, 2], sh.Attrib1i, moved), [])
    assert found.shape == (0,)
    assert found.type is sh.Attrib1i


def test_unsigned_indices_have_no_sign(moved):
    index = np.array([0, 2**31, 2**32 - 1, 3], np.uint32)
    found = sh.gather(stream([1, 2, 3, 4], sh.Attrib1f, moved), stream(index, sh.Attrib1u, moved))
    assert found.numpy().tolist() == [1, 4, 4, 4]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("cls", [sh.Attrib3f, sh.Attrib2i, sh.Attrib4u, sh.Attrib1b, sh.Matrix3f])
def test_every_type(moved, cls):
    rng = np.random.default_rng(5)
    shape = {sh.Attrib3f: (20, 3), sh.Attrib2i: (20, 2), sh.Attrib4u: (20, 4), sh.Matrix3f: (20, 3, 3)}.get(cls, (20,))
    x = rng.integers(0, 2, shape)
    given = stream(x != 0 if cls is sh.Attrib1b else x, cls, moved)
    index = rng.integers(0, 20, 33)
    assert_same_bits(sh.gather(given, index), given.numpy()[index])


FIELDS = {f"field{k}": (sh.Attrib1f, sh.Attrib3f, sh.Attrib1b, sh.Attrib2i)[k % 4] for k in range(18)}
Wide = sh.struct(type("Wide", (), {"__annotations__": dict(FIELDS)}))
"""A struct of more leaves than a kernel of OpenCL gathers."""


def test_elements_of_many_leaves(moved):
    rng = np.random.default_rng(8)
    shapes = {sh.Attrib3f: (20, 3), sh.Attrib2i: (20, 2)}
    fields = {name: rng.integers(0, 2, shapes.get(cls, (20,))) for name, cls in FIELDS.items()}
    fields |= {name: fields[name] != 0 for name, cls in FIELDS.items() if cls is sh.Attrib1b}
    index = rng.integers(0, 20, 33)
    gathered = sh.gather(sh.Stream(fields, Wide, moved), index).numpy()
    for name, array in fields.items():
        assert np.array_equal(getattr(gathered, name), array[index])


def test_halves_and_doubles():
    x = np.random.default_rng(6).standard_normal(20)
    for backend, precision in (("numpy", "f64"), ("opencl", "f64"), ("opencl", "f16"), ("glsl", "f16")):
        given = sh.Stream(x, sh.Attrib1f, backend, precision=precision)
        assert_same_bits(sh.gather(given, np.arange(20)[::-1]), given.numpy()[::-1])


@pytest.mark.parametrize(
    ("x", "index", "message"),
    [
        ([1, 2], [0.5], "index takes ints, not float64"),
        ([1, 2], [[0], [0, 1]], "index is not an array: setting an array element with a sequence"),
        ([], [0], "gather from a stream without elements"),
        ([1, 2], lambda: sh.Stream([0.0], sh.Attrib1f, "numpy"), "index is <Stream (1,) of Attrib1f on numpy>"),
        ([1, 2], lambda: sh.Stream([0], sh.Attrib1i, "opencl"), "stream.to('numpy')"),
    ],
)
def test_indices_that_do_not_fit(x, index, message):
    index = index() if callable(index) else index
    with pytest.raises(sh.ShpyTypeError, match=re.escape(message)):
        sh.gather(stream(np.float32(x), sh.Attrib1f, "numpy"), index)
