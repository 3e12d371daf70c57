"""sh.scatter writes each value to its place; of several for a place the last stays, or a left fold combines them."""

import re
from typing import NamedTuple

import numpy as np
import pytest
from collectives.generated import (
    LARGE,
    OFTEN,
    assert_same_bits,
    by_programs,
    computed,
    floats,
    generated,
    moved,
    stream,
)

import shpy as sh

__all__ = ["by_programs", "computed", "moved"]


class Weighted(NamedTuple):
    at: sh.Point3f
    weight: sh.Attrib1f


@sh.program
def mixed(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a * 0.75 + b


@sh.program
def joined(a: Weighted, b: Weighted) -> Weighted:
    return Weighted(a.at - b.at, a.weight * 0.5 + b.weight)


def last_ones(x, index, target):
    for value, place in zip(x, index, strict=True):
        if 0 <= place < len(target):
            target[place] = value
    return target


def left_folds(x, index, target, combine):
    touched = set()
    for value, place in zip(x, index, strict=True):
        if 0 <= place < len(target):
            target[place] = combine(target[place], value) if place in touched else value
            touched.add(place)
    return target


def places(rng, n, size):
    return rng.integers(-2, size + 2, n).astype(np.int32)


def check(backend, count, seed, **options):
    for n, rng in generated(count, seed, **options):
        x, size = floats(rng, n), int(rng.choice([0, 1, n // 4 + 1, 2 * n + 1]))
        index, held = places(rng, n, size), floats(rng, size)
        given, at = stream(x, sh.Attrib1f, backend), stream(index, sh.Attrib1i, backend)
        if n % 2:
            assert_same_bits(sh.scatter(given, at, size), last_ones(x, index, np.zeros(size, np.float32)))
        else:
            out = stream(held, sh.Attrib1f, backend)
            assert sh.scatter(given, at, out=out) is out
            assert_same_bits(out, last_ones(x, index, held.copy()))


def check_folds(backend, count, seed, **options):
    for n, rng in generated(count, seed, **options):
        x, size = rng.standard_normal(n).astype(np.float32), int(rng.choice([1, 3, n // 4 + 1, 2 * n + 1]))
        index = places(rng, n, size)
        found = sh.scatter(stream(x, sh.Attrib1f, backend), stream(index, sh.Attrib1i, backend), size, combine=mixed)
        wanted = left_folds(x, index, np.zeros(size, np.float32), lambda a, b: a * np.float32(0.75) + b)
        assert_same_bits(found, wanted)


@pytest.mark.sampled(3)
def test_the_last_value_stays(moved):
    check(moved, OFTEN, 1)


def test_many_values(moved):
    check(moved, 11, 2, sizes=LARGE)


@pytest.mark.sampled(2)
def test_values_are_folded_in_order(computed):
    check_folds(computed, OFTEN, 3)


@pytest.mark.sampled(2)
def test_many_values_are_folded_in_order(computed):
    check_folds(computed, 2, 4, sizes=(4097, 20_011))


@pytest.mark.slow
def test_programs_do_the_same(by_programs):
    check(by_programs, 100, 8)


@pytest.mark.slow
def test_at_length(moved):
    check(moved, 10_000, 5)


@pytest.mark.slow
def test_folds_at_length(computed):
    check_folds(computed, 10_000, 6)


def test_structs_are_folded(computed):
    rng = np.random.default_rng(7)
    at, weight = rng.standard_normal((60, 3)).astype(np.float32), rng.standard_normal(60).astype(np.float32)
    index = places(rng, 60, 8)
    found = sh.scatter(stream({"at": at, "weight": weight}, Weighted, computed), index, (2, 4), combine=joined)
    assert found.shape == (2, 4)
    assert_same_bits(found.numpy().at.reshape(8, 3), left_folds(at, index, np.zeros((8, 3), np.float32), np.subtract))
    half = np.float32(0.5)
    wanted = left_folds(weight, index, np.zeros(8, np.float32), lambda a, b: a * half + b)
    assert_same_bits(found.numpy().weight.reshape(8), wanted)


@sh.program
def added(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@sh.program
def added_counts(a: sh.Attrib2i, b: sh.Attrib2i) -> sh.Attrib2i:
    return b + a


@sh.program
def added_ints(a: sh.Attrib1i, b: sh.Attrib1i) -> sh.Attrib1i:
    return a + b


@sh.program
def doubled(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + a


@pytest.mark.sampled(4)
@pytest.mark.parametrize("precision", ["f32", "f64", "f16"])
def test_sums_are_folded(computed, precision):
    if (computed, precision) == ("glsl", "f64"):
        with pytest.raises(sh.ShpyTypeError, match="no f64"):
            sh.Stream([1], sh.Attrib1f, computed, precision=precision)
        return
    rng, dtype = np.random.default_rng(8), np.dtype(f"f{int(precision[1:]) // 8}")
    x = rng.standard_normal(300).astype(dtype)
    x[:40] = rng.choice([-0.0, 0.0, np.inf, np.nan, 6e4, 6e-8], 40)
    index = places(rng, 300, 50)
    values = sh.Stream(x, sh.Attrib1f, computed, precision=precision)
    for program, combine in ((added, np.add), (doubled, lambda a, _: a + a)):
        with np.errstate(all="ignore"):
            expected = left_folds(x, index, np.zeros(50, dtype), combine)
        folded = sh.scatter(values, index, 50, combine=program).numpy()
        for array in (folded, expected):
            array[np.isnan(array)] = np.nan  # of one sign
        assert_same_bits(folded, expected)


@pytest.mark.sampled(2)
def test_sums_of_ints_wrap_and_may_be_written_among_their_values(computed):
    values = stream([[2**31 - 1, 1], [1, 2], [5, 6], [7, 8]], sh.Attrib2i, computed)
    sh.scatter(values, [3, 3, -1, 0], combine=added_counts, out=values)
    assert values.numpy().tolist() == [[7, 8], [1, 2], [5, 6], [-(2**31), 3]]
    index = stream([1, 1, 1, 9], sh.Attrib1i, computed)
    sh.scatter(stream([5, 6, 7, 8], sh.Attrib1i, computed), index, combine=added_ints, out=index)
    assert index.numpy().tolist() == [1, 18, 1, 9]


def test_out_keeps_its_elements_and_takes_no_part_in_folds(computed):
    out = stream([10, 20, 30, 40], sh.Attrib1f, computed)
    values = stream([1, 2, 4], sh.Attrib1f, computed)
    assert sh.scatter(values, [2, 0, 2], combine=mixed, out=out).numpy().tolist() == [2, 20, 4.75, 40]


def test_values_out_of_range_are_dropped_also_where_all_of_them_are(computed):
    for values, cls, add in (([1, 2], sh.Attrib1f, added), ([[1, 2], [3, 4]], sh.Attrib2i, added_counts)):
        sums = sh.scatter(stream(values, cls, computed), [-1, 5], 5, combine=add)
        assert not sums.numpy().any()


def test_values_may_be_written_among_themselves(moved):
    x = stream([1, 2, 3, 4], sh.Attrib1f, moved)
    sh.scatter(x, [3, 2, 1, 0], out=x)
    assert x.numpy().tolist() == [4, 3, 2, 1]
    index = stream([2, 0, 1, 9], sh.Attrib1i, moved)
    sh.scatter(stream([5, 6, 7, 8], sh.Attrib1i, moved), index, out=index)
    assert index.numpy().tolist() == [6, 7, 5, 9]


def test_indices_may_be_unsigned_and_of_several_axes(moved):
    index = stream(np.array([[0, 2**32 - 1], [5, 0]], np.uint32), sh.Attrib1u, moved)
    found = sh.scatter(stream([[1, 2], [3, 4]], sh.Attrib1f, moved), index, (3, 2))
    assert found.numpy().tolist() == [[4, 0], [0, 0], [0, 3]]
    folded = sh.scatter(stream([[1, 2], [3, 4]], sh.Attrib1f, moved), index, (3, 2), combine=mixed)
    assert folded.numpy().tolist() == [[4.75, 0], [0, 0], [0, 3]]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "scatter needs a shape"),
        ({"index": [0], "shape": 4}, "index has the shape (1,), and the values (3,)"),
        ({"shape": 4, "combine": joined}, "joined"),
        ({"shape": 4, "combine": max}, "sh.scatter takes a program of two elements"),
        ({"shape": 4, "out": (sh.Attrib1f, "numpy")}, "not Attrib1f of shape (4,)"),
        ({"out": (sh.Attrib1i, "numpy")}, "out is <Stream (5,) of Attrib1i on numpy>"),
        ({"out": (sh.Attrib1f, "opencl")}, "stream.to('numpy')"),
    ],
)
def test_arguments_that_do_not_fit(options, message):
    out = {"out": sh.Stream.empty(5, *options["out"])} if "out" in options else {}
    with pytest.raises(sh.ShpyTypeError, match=re.escape(message)):
        sh.scatter(stream([1, 2, 3], sh.Attrib1f, "numpy"), **{"index": [0, 1, 2], **options, **out})
