"""sh.histogram counts as np.histogram and np.bincount do, on every backend."""

import re

import numpy as np
import pytest
from collectives.generated import LARGE, OFTEN, assert_same_bits, computed, floats, generated, moved, stream

import shpy as sh
from shpy.backend.glsl.device import collective as glsl

__all__ = ["computed", "moved"]


def counted(x, bins, **options):
    finite = x[~np.isnan(x)]
    return np.histogram(finite.astype(np.float64), bins, **options)[0].astype(np.int32)


def check(backend, count, seed, **options):
    for n, rng in generated(count, seed, **options):
        x, given = floats(rng, n), None
        given = stream(x, sh.Attrib1f, backend)
        if n % 2:
            edges = np.sort(rng.choice([*rng.standard_normal(8), 0.0, 1.0, 1e-40, np.inf, -np.inf], 5))
        else:
            edges = np.histogram_bin_edges(np.float32([]), int(rng.integers(1, 40)), (-2, 1.7))
            assert_same_bits(sh.histogram(given, len(edges) - 1, range=(-2, 1.7)), counted(x, edges))
        assert_same_bits(sh.histogram(given, edges), counted(x, edges))


@pytest.mark.sampled(4)
def test_bins_are_those_of_numpy(computed):
    check(computed, OFTEN, 1)


@pytest.mark.sampled(2)
def test_many_elements(computed):
    check(computed, 4, 2, sizes=LARGE[-4:])


@pytest.mark.slow
def test_bins_are_those_of_numpy_at_length(computed):
    check(computed, 10_000, 3)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("span", [(0, 1), (-2, 1.7), (1, 1 + 2**-10), (0, 1e-40), (-3e38, 3e38), (1e30, 2e30), (5, 5)])
def test_bins_of_equal_width_are_those_of_their_edges(computed, span):
    """The guess of a bin may be wrong by any number: the edges decide."""
    rng = np.random.default_rng(8)
    for bins in (1, 2, 3, 100, 4096):
        edges = np.histogram_bin_edges(np.float32([]), bins, span)
        near = rng.choice(edges, 300).astype(np.float32)
        x = np.concatenate([
            near, np.nextafter(near, np.float32(np.inf)), np.nextafter(near, np.float32(-np.inf)), floats(rng, 50),
            rng.uniform(*span, 500).astype(np.float32), np.float32([np.inf, -np.inf, np.nan, 0, -0.0]),
        ])  # fmt: skip
        assert_same_bits(sh.histogram(stream(x, sh.Attrib1f, computed), bins, range=span), counted(x, edges))


def test_numbers_are_counted(moved):
    for n, rng in generated(50, 4, sizes=(0, 1, 2, 61, 4097)):
        x, bins = rng.integers(-3, 20, n).astype(np.int32), int(rng.integers(1, 25))
        wanted = np.bincount(x[(x >= 0) & (x < bins)], minlength=bins).astype(np.int32)
        assert_same_bits(sh.histogram(stream(x, sh.Attrib1i, moved), bins), wanted)
        unsigned = sh.histogram(stream(x.view(np.uint32), sh.Attrib1u, moved), bins)
        assert_same_bits(unsigned, wanted)


def test_counts_beyond_what_floats_hold_are_added(monkeypatch):
    monkeypatch.setattr(glsl, "_EXACT", 1000)
    monkeypatch.setattr(glsl, "_AT_ONCE", 300)
    x = np.random.default_rng(6).integers(0, 9, 5021).astype(np.int32)
    assert_same_bits(sh.histogram(stream(x, sh.Attrib1i, "glsl"), 9), np.bincount(x).astype(np.int32))


@pytest.mark.sampled(2)
def test_edges_between_ints(computed):
    x = np.array([-(2**31), -5, 0, 1, 2, 3, 2**31 - 1], np.int32)
    for edges in ([0.5, 1, 2.5], [-1e12, 0, 1e12], [-9, -5.5], [1e10, 1e11], [-1e11, -1e10], [0, 1, 2**31 - 1]):
        assert_same_bits(sh.histogram(stream(x, sh.Attrib1i, computed), edges), counted(x, edges))
    assert_same_bits(sh.histogram(stream(x, sh.Attrib1i, computed), 3, range=(0, 3)), counted(x, 3, range=(0, 3)))


@pytest.mark.parametrize("edges", [[-1e-45, 0, np.finfo(np.float32).max], [-1e300, 1e-300, 1e300]])
def test_edges_beside_the_last_floats_raise_nothing(edges):
    x = np.float32([-3e38, -1e-45, 0, 1e-45, 3e38])
    wanted = np.histogram(x.astype(np.float64), edges)[0]
    with np.errstate(all="raise"):
        found = sh.histogram(sh.Stream(x, sh.Attrib1f, "numpy"), edges)
    assert found.numpy().tolist() == wanted.tolist()


def test_images(computed):
    x = np.random.default_rng(5).random((40, 30)).astype(np.float32)
    assert_same_bits(sh.histogram(stream(x, sh.Attrib1f, computed), 256, range=(0, 1)), counted(x, 256, range=(0, 1)))


@pytest.mark.parametrize(
    ("x", "cls", "options", "message"),
    [
        ([0.5], sh.Attrib1f, {"bins": 4}, "range=(0, 1)"),
        ([0.5], sh.Attrib1f, {"bins": 0, "range": (0, 1)}, "a histogram of 0 bins"),
        ([0.5], sh.Attrib1f, {"bins": 3, "range": (1, 0)}, "range=(1, 0)"),
        ([0.5], sh.Attrib1f, {"bins": [2, 1]}, "ascending order"),
        ([0.5], sh.Attrib1f, {"bins": [0, np.nan]}, "ascending order"),
        ([0.5], sh.Attrib1f, {"bins": [[0], [0, 1]]}, "bins is not an array: setting an array element with a sequence"),
        ([True], sh.Attrib1b, {"bins": 2}, "numbers of one component"),
        ([[1, 2]], sh.Attrib2f, {"bins": [0, 1]}, "numbers of one component"),
    ],
)
def test_arguments_that_do_not_fit(x, cls, options, message):
    with pytest.raises(sh.ShpyTypeError, match=re.escape(message)):
        sh.histogram(sh.Stream(x, cls, "numpy"), **options)


def test_more_bins_than_halves_in_the_range_are_given_as_edges():
    halves = sh.Stream(np.float16([0.1, 0.1, 0.9]), sh.Attrib1h, "numpy")
    with pytest.raises(sh.ShpyTypeError, match="Too many bins for data range") as caught:
        sh.histogram(halves, 5000, range=(0, 1))
    assert caught.value.cure == "np.linspace(low, high, 5001) for bins, without a range"
    wanted = np.histogram(np.float64(np.float16([0.1, 0.1, 0.9])), 5000, (0, 1))[0]
    assert np.array_equal(sh.histogram(halves, np.linspace(0, 1, 5001)), wanted)
