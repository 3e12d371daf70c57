"""Functions of numbers: known answers, and the same bits on every backend."""

import math

import numpy as np
import pytest
from backends.running import covering

import shpy as sh
from shpy import library

EDGES = np.float32(
    [0, -0.0, 1, -1, 0.5, 2, 3e-30, 4e-30, 3e30, 4e30, 3.4028235e38, 2.0**-126, np.inf, -np.inf, np.nan, 16777217]
)
X, Y = (grid.ravel() for grid in np.meshgrid(EDGES, EDGES))

on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])


@sh.program
def numbers(x: sh.Attrib1f, y: sh.Attrib1f):
    return library.lerp(x, y, 0.25), library.isfinite(x), library.log10(x), library.hypot(x, y)


@sh.program
def vectors(v: sh.Vector3f, w: sh.Attrib3f) -> tuple[sh.Vector3f, sh.Attrib3b, sh.Matrix3f, sh.Matrix2f]:
    return library.hypot(v, w), library.isfinite(v), library.outer(v, w), library.outer(w.xy, v.zx)


def test_all_backends_give_the_same_bits():
    sh.testing.assert_equivalent(numbers, X, Y, backends=covering(1))
    v = np.random.default_rng(1).permutation(np.repeat(EDGES, 30))[:240].reshape(2, -1, 3)
    sh.testing.assert_equivalent(vectors, *v, backends=covering(2))


@pytest.mark.sampled(3)
@on_every_backend
def test_lerp_is_exact_at_its_ends(backend):
    @sh.program
    def ends(a: sh.Attrib1f, b: sh.Attrib1f, t: sh.Attrib1f) -> sh.Attrib1f:
        return library.lerp(a, b, t)

    a, b = np.float32([0.1, -3e30, 1 / 3, 1e-20]), np.float32([1e9, 0.7, 3e30, -5])
    kernel = ends.compile(backend)
    np.testing.assert_array_equal(kernel(a, b, 0), a)
    np.testing.assert_array_equal(kernel(a, b, 1), b)
    np.testing.assert_array_equal(kernel(2, 4, [0.25, 0.5]), [2.5, 3])


@on_every_backend
def test_hypot_is_that_of_c99(backend):
    found = numbers.compile(backend)(X, Y)[3]
    with np.errstate(over="ignore"):
        exact = np.hypot(X.astype(np.longdouble), Y.astype(np.longdouble))
        np.testing.assert_array_equal(found, exact.astype(np.float32))
    assert numbers.compile(backend)(np.inf, np.nan)[3] == np.inf
    assert np.isnan(numbers.compile(backend)(1, np.nan)[3])
    np.testing.assert_array_equal(
        numbers.compile(backend)([3 * 2.0**100, -5, 0], [2.0**102, 12, -0.0])[3], np.float32([5 * 2.0**100, 13, 0])
    )


def test_hypot_broadcasts_and_widens():
    assert library.hypot is sh.hypot
    assert np.asarray(library.hypot((3, 5), (4, 12))).tolist() == [5, 13]
    assert np.asarray(library.hypot(sh.Vector2f(3, 8), 15)).tolist() == pytest.approx([math.hypot(3, 15), 17])
    assert type(library.hypot(sh.Vector2f(3, 8), 15)) is sh.Vector2f
    assert type(library.hypot(sh.Attrib1d(3), sh.Attrib1f(4))) is sh.Attrib1d


@on_every_backend
def test_the_logarithm_of_each_power_of_ten_is_a_whole_number(backend):
    powers = range(-37, 39)
    x = np.float32([float(f"1e{k}") for k in powers])
    np.testing.assert_array_equal(numbers.compile(backend)(x, 0)[2], powers)
    edges = numbers.compile(backend)([0, -1, np.inf, np.nan], 0)[2]
    np.testing.assert_array_equal(edges, [-np.inf, np.nan, np.inf, np.nan])


def test_the_logarithm_of_each_power_of_ten_is_a_whole_number_in_binary64():
    powers = range(-307, 309)
    found = numbers.compile("numpy", precision="f64")([float(f"1e{k}") for k in powers], 0)[2]
    np.testing.assert_array_equal(found, powers)


@pytest.mark.sampled(3)
@on_every_backend
def test_outer_is_numpys(backend):
    v, w = np.float32([[1, 2, 3], [-4, 0.5, 8]])
    found = vectors.compile(backend)(v, w)
    np.testing.assert_array_equal(found[2], np.outer(v, w))
    np.testing.assert_array_equal(found[3], np.outer(w[:2], v[[2, 0]]))


def test_outer_refuses_vectors_of_two_sizes():
    with pytest.raises(sh.ShpyTypeError, match="one size, not 2 and 3") as error:
        library.outer((1, 2), (1, 2, 3))
    assert error.value.cure == "sh.library.outer(a.xyz, b.xyz)"
    assert error.value.loc.file == __file__
    with pytest.raises(sh.ShpyTypeError, match="2 or 3 or 4 components, not 1"):
        library.outer(1, (1, 2))


def test_what_lies_in_the_library_is_named_where_shpy_is_asked_for_it():
    for name in ("isfinite", "outer", "fbm"):
        with pytest.raises(AttributeError) as error:
            getattr(sh, name)
        assert error.value.cure.startswith(f"sh.library.{name}")
    assert sh.library is library
    assert sorted(library.__all__) == library.__all__
    assert all(getattr(library, name).__doc__ for name in library.__all__)


ONE, TWO, FOUR = sh.Attrib1f(2), sh.Attrib2f(1, 2), sh.Attrib4f(1, 2, 3, 4)


@pytest.mark.parametrize(
    ("name", "p"),
    [("cubemap", ONE), ("cubemap", TWO), ("cubemap", FOUR), ("scale", ONE), ("luminance", TWO), ("rotate", TWO)],
)
def test_the_cure_for_a_wrong_number_of_components_is_taken(name, p):
    with pytest.raises(sh.ShpyTypeError) as caught:
        getattr(sh.library, name)(p)
    eval(caught.value.cure, {"sh": sh, "p": p})
