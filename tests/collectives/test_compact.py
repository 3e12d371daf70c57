"""sh.compact gives the elements of a mask in their order, on every backend."""

import re

import numpy as np
import pytest
from collectives.generated import LARGE, OFTEN, assert_same_bits, by_programs, floats, generated, moved, stream

import shpy as sh

__all__ = ["by_programs", "moved"]


@sh.struct
class Part:
    at: sh.Point3f
    alive: sh.Attrib1b


def check(backend, count, seed, **options):
    for n, rng in generated(count, seed, **options):
        x, mask = floats(rng, n), rng.random(n) < rng.choice([0, 0.02, 0.5, 0.9, 1])
        kept, indices = sh.compact(stream(x, sh.Attrib1f, backend), stream(mask, sh.Attrib1b, backend))
        assert kept.shape == indices.shape == (mask.sum(),)
        assert_same_bits(indices, np.flatnonzero(mask).astype(np.int32))
        assert_same_bits(kept, x[mask])


@pytest.mark.sampled(3)
def test_the_marked_elements_stay_in_order(moved):
    check(moved, OFTEN, 1)


def test_many_elements(moved):
    check(moved, 11, 2, sizes=LARGE)


@pytest.mark.slow
def test_programs_do_the_same(by_programs):
    check(by_programs, 100, 5)


@pytest.mark.slow
def test_the_marked_elements_stay_in_order_at_length(moved):
    check(moved, 10_000, 3)


def test_the_mask_may_be_an_array_and_axes_are_taken_in_c_order(moved):
    x = np.arange(24, dtype=np.int32).reshape(4, 6)
    kept, indices = sh.compact(stream(x, sh.Attrib1i, moved), x % 5 == 0)
    assert kept.numpy().tolist() == indices.numpy().tolist() == [0, 5, 10, 15, 20]
    assert kept.backend == indices.backend == moved


def test_structs_are_kept_whole(moved):
    rng = np.random.default_rng(4)
    at, alive = rng.standard_normal((50, 3)).astype(np.float32), rng.random(50) < 0.5
    kept = sh.compact(stream({"at": at, "alive": alive}, Part, moved), alive).elements
    assert kept.type is Part
    assert_same_bits(kept.numpy().at, at[alive])
    assert kept.numpy().alive.all()


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.ones(3, np.int32), "mask takes bools, not int32"),
        ([[True], [True, False]], "mask is not an array: setting an array element with a sequence"),
        (np.ones(3, np.bool_), "mask has the shape (3,), and the stream (4,)"),
        (sh.Stream([1, 0, 1, 0], sh.Attrib1i, "numpy"), "mask is <Stream (4,) of Attrib1i on numpy>"),
    ],
)
def test_masks_that_do_not_fit(mask, message):
    with pytest.raises(sh.ShpyTypeError, match=re.escape(message)) as error:
        sh.compact(stream(np.zeros(4), sh.Attrib1f, "numpy"), mask)
    assert "test_compact.py" in str(error.value)


def test_an_empty_list_is_a_mask_of_no_elements():
    kept = sh.compact(stream(np.zeros(0, np.float32), sh.Attrib1f, "numpy"), [])
    assert (kept.elements.shape, kept.indices.shape) == ((0,), (0,))


def test_a_mask_of_another_device():
    with pytest.raises(sh.ShpyTypeError, match=re.escape("stream.to('opencl')")):
        sh.compact(stream(np.zeros(4), sh.Attrib1f, "opencl"), stream(np.ones(4, np.bool_), sh.Attrib1b, "numpy"))


def test_an_array_is_no_stream():
    with pytest.raises(sh.ShpyTypeError, match="compact takes a Stream, not ndarray"):
        sh.compact(np.zeros(4), np.ones(4, np.bool_))
