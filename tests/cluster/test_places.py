"""sh.gather, sh.compact and sh.scatter over Dask arrays: the elements of one stream for any chunks."""

from __future__ import annotations

import re

import dask
import dask.array as da
import numpy as np
import pytest

import shpy as sh

draw = np.random.default_rng(5)


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


@sh.program
def mixed(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a * 0.75 + b


@sh.program
def turned(a: sh.Attrib3f, b: sh.Attrib3f) -> sh.Attrib3f:
    return a * 0.75 + b.yzx


@sh.program
def mixed_doubles(a: sh.Attrib1d, b: sh.Attrib1d) -> sh.Attrib1d:
    return a * 0.75 + b


@pytest.fixture(autouse=True)
def one_thread():
    with dask.config.set(scheduler="synchronous"):
        yield


@pytest.mark.sampled(4)
@pytest.mark.parametrize("chunks", [(20, 31), (3, 10), (1, 31), (20, 1)])
@pytest.mark.parametrize("size", [1, 3])
def test_compacted_elements_and_indices_are_those_of_one_stream(chunks, size):
    x = draw.standard_normal((20, 31, 3)[: 2 + (size > 1)]).astype(np.float32)
    mask = draw.random((20, 31)) < 0.3
    wanted = sh.compact(sh.Stream(x, sh.Attrib3f if size > 1 else sh.Attrib1f, "numpy"), mask)
    cut = da.from_array(x, chunks=(*chunks, 2)[: x.ndim])
    for marks in (mask, da.from_array(mask, chunks=(7, 9))):
        for array, stream in zip(sh.compact(cut, marks), wanted, strict=True):
            assert array.dtype == stream.numpy().dtype
            assert array.compute().tobytes() == stream.numpy().tobytes()


@pytest.mark.sampled(9)
@pytest.mark.parametrize("chunks", [(20, 31), (3, 10), (1, 31)])
@pytest.mark.parametrize("combine", [None, mixed, turned])
def test_scattered_values_have_the_bits_of_one_stream(chunks, combine):
    vectors = combine is turned
    x = draw.standard_normal((20, 31, 3)[: 2 + vectors]).astype(np.float32)
    index = draw.integers(-9, 200, (20, 31))
    index[5, 6] = 2**40
    index[:, 3] = 77
    values = sh.Stream(x, sh.Attrib3f if vectors else sh.Attrib1f, "numpy")
    wanted = sh.scatter(values, index, (12, 16), combine).numpy()
    cut = da.from_array(x, chunks=(*chunks, 2)[: x.ndim])
    for given in (index, da.from_array(index, chunks=(7, 9))):
        found = sh.scatter(cut, given, (12, 16), combine)
        assert (found.shape, found.dtype) == (wanted.shape, wanted.dtype)
        assert found.compute().tobytes() == wanted.tobytes()


@pytest.mark.sampled(4)
@pytest.mark.parametrize("chunks", [(20, 31), (3, 10), (1, 31)])
@pytest.mark.parametrize("kind", [None, sh.Attrib3f, sh.Attrib1i])
def test_gathered_elements_have_the_bits_of_one_stream(chunks, kind):
    vectors = kind is sh.Attrib3f
    x = (draw.standard_normal((20, 31, 3)[: 2 + vectors]) * 99).astype(np.int32 if kind is sh.Attrib1i else np.float32)
    x.flat[7] = 0 if kind is sh.Attrib1i else np.nan
    index = draw.integers(-9, 700, (11, 4))
    index[2, 3], index[0, 0] = 2**40, 7
    wanted = sh.gather(sh.Stream(x, kind or sh.Attrib1f, "numpy"), index).numpy()
    cut = da.from_array(x, chunks=(*chunks, 2)[: x.ndim])
    for table in (cut, x):
        for places in (da.from_array(index, chunks=(3, 4)), index):
            if table is cut or places is not index:
                gathered = sh.gather(table, places, kind) if kind else sh.gather(table, places)
                assert (gathered.shape, gathered.dtype) == (wanted.shape, wanted.dtype)
                assert gathered.compute().tobytes() == wanted.tobytes()


def test_gather_from_a_table_that_is_cut_holds_no_whole_table():
    """Each task of the graph takes a chunk of the table, and gives the elements that one chunk of indices names."""
    table = da.arange(100_000, chunks=1_000, dtype=np.float32)
    index = da.from_array(draw.integers(0, 100_000, 50).astype(np.uint8), chunks=25)
    gathered = sh.gather(table, index)
    largest = []
    with (
        dask.config.set(scheduler="synchronous"),
        dask.callbacks.Callback(posttask=lambda key, result, *_: largest.append(getattr(result, "size", 0))),
    ):
        assert gathered.compute().tobytes() == index.compute().astype(np.float32).tobytes()
    assert max(largest) == 1_000


def test_mistakes_of_gather_are_errors_before_anything_runs():
    table, index = da.ones((6, 4), chunks=3), np.array([1, 2])
    stream = sh.Stream(np.zeros(4), sh.Attrib1f, "numpy")
    for call, message in (
        (lambda: sh.gather(table, index * 1.5), "index takes ints, not float64"),
        (lambda: sh.gather(da.ones(0), index), "gather from an array without elements"),
        (lambda: sh.gather(table, index, sh.Attrib3f), "the table is an Attrib3f"),
        (lambda: sh.gather(table[table[:, 0] > 0], index), "the table has chunks of unknown sizes"),
        (
            lambda: sh.gather(stream, da.from_array(index)),
            "<Stream (4,) of Attrib1f on numpy> lies on a device of this",
        ),
        (
            lambda: sh.gather(stream, index, sh.Attrib1f),
            "type= beside <Stream (4,) of Attrib1f on numpy>, which has its",
        ),
        (
            lambda: sh.gather(table, index, Ray),
            "sh.gather of a Dask array reads numbers and vectors, not the struct Ray",
        ),
        (lambda: sh.gather({"o": table}, index), "gather takes one Dask array, not a dict of them"),
        (lambda: sh.gather(table, index, int), "a Table holds values of the language, not <class 'int'>"),
    ):
        with pytest.raises(sh.ShpyTypeError, match=re.escape(message)):
            call()
    assert sh.gather(table, np.zeros((0, 2), np.int32)).compute().shape == (0, 2)


def test_numbers_that_a_stream_does_not_hold_are_not_compacted():
    kept = sh.compact(da.from_array(np.array([1, 2**40, 3]), chunks=2), np.array([True, True, False]))
    with pytest.raises(sh.ShpyTypeError, match=re.escape(f"holds {2**40}, out of the range of")):
        kept.elements.compute()


def test_few_values_scattered_over_many_places_make_few_blocks():
    found = sh.scatter(da.ones(4, chunks=2), np.array([0, 1, 70_000, 99_999]), 100_000, combine=mixed)
    assert found.npartitions < 100
    assert np.flatnonzero(found.compute()).tolist() == [0, 1, 70_000, 99_999]


def test_nothing_goes_to_nowhere():
    x = da.zeros((0,), dtype=np.float32)
    assert sh.scatter(x, np.zeros(0, np.int32), 5).compute().tolist() == [0] * 5
    assert sh.scatter(da.ones(3), np.zeros(3, np.int32), (0, 2)).compute().shape == (0, 2)
    assert sh.compact(x, np.zeros(0, bool)).elements.compute().shape == (0,)


def test_mistakes_are_errors_before_anything_runs():
    x, index = da.ones((4, 3), chunks=2), np.zeros((4, 3), np.int32)
    with pytest.raises(sh.ShpyTypeError, match=r"mask has the shape \(4, 2\), and the array \(4, 3\)"):
        sh.compact(x, np.zeros((4, 2), bool))
    with pytest.raises(sh.ShpyTypeError, match="mask takes bools, not int32"):
        sh.compact(x, index)
    with pytest.raises(sh.ShpyTypeError, match="index takes ints, not float64"):
        sh.scatter(x, x, 4)
    with pytest.raises(sh.ShpyTypeError, match="scatter of a Dask array makes a new one of a shape"):
        sh.scatter(x, index)
    with pytest.raises(sh.ShpyTypeError, match="takes scalars and vectors, not 7 components"):
        sh.scatter(da.ones((4, 7)), np.zeros(4, np.int32), 4)
    with pytest.raises(sh.ShpyTypeError, match="scatter takes a program of two elements"):
        sh.scatter(x, index, 4, max)
    filtered = da.ones(9, chunks=2, dtype=np.float32)
    with pytest.raises(sh.ShpyTypeError, match="the array has chunks of unknown sizes"):
        sh.compact(filtered[filtered > 0], np.ones(9, bool))


@pytest.mark.parametrize("dtype", [np.float64, np.float16])
def test_floats_of_other_sizes_keep_their_digits(dtype):
    x = draw.standard_normal(50).astype(dtype)
    mask, index = x > 0, draw.integers(0, 7, 50)
    cut = da.from_array(x, chunks=20)
    kept = sh.compact(cut, mask).elements
    assert (kept.dtype, kept.compute().tobytes()) == (dtype, x[mask].tobytes())
    last = np.zeros(7, dtype)
    last[index] = x
    found = sh.scatter(cut, index, 7)
    assert (found.dtype, found.compute().tobytes()) == (dtype, last.tobytes())


def test_moving_float64_takes_no_device_that_has_it(monkeypatch):
    monkeypatch.setenv("SHPY_BACKEND", "glsl")
    x = draw.standard_normal(50)
    cut, index = da.from_array(x, chunks=20), np.arange(50)
    assert np.array_equal(sh.sort(cut).compute(), np.sort(x))
    assert np.array_equal(sh.argsort(cut).compute(), np.argsort(x))
    assert np.array_equal(sh.scatter(cut, index, 50).compute(), x)


@pytest.mark.parametrize(("combine", "cls"), [(mixed, sh.Attrib1f), (mixed_doubles, sh.Attrib1d)])
def test_combining_computes_in_the_floats_of_the_program(combine, cls):
    x, index = draw.standard_normal(50), draw.integers(0, 7, 50)
    wanted = sh.scatter(sh.Stream(x, cls, "numpy"), index, 7, combine).numpy()
    found = sh.scatter(da.from_array(x, chunks=20), index, 7, combine)
    assert (found.dtype, found.compute().tobytes()) == (wanted.dtype, wanted.tobytes())
