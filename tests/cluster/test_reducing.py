"""sh.reduce and sh.scan over Dask arrays: the bits of one stream for any chunks."""

from __future__ import annotations

import dask
import dask.array as da
import numpy as np
import pytest

import shpy as sh


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@sh.program
def later(a: sh.Attrib3f, b: sh.Attrib3f) -> sh.Attrib3f:
    return a * 0.75 + b.yzx


@pytest.fixture(autouse=True)
def one_thread():
    with dask.config.set(scheduler="synchronous"):
        yield


draw = np.random.default_rng(5)


@pytest.mark.parametrize("n", [1, 2, 4095, 4097, 70_001])
@pytest.mark.parametrize("chunks", [1_000, 8_192, 12_345])
def test_sums_have_the_bits_of_one_stream(n, chunks):
    x = (draw.standard_normal(n) * 10.0 ** draw.integers(-6, 6, n)).astype(np.float32)
    wanted = sh.reduce(add, sh.Stream(x, sh.Attrib1f, "numpy"))
    found = sh.reduce(add, da.from_array(x, chunks=chunks))
    assert (found.shape, found.dtype) == ((), np.float32)
    assert np.float32(found.compute()).tobytes() == wanted.tobytes()
    assert wanted == sh.Stream(x, sh.Attrib1f, "numpy").sum()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("chunks", [(5_000, 7, 3), (9_001, 2, 3), (333, 1, 1)])
@pytest.mark.parametrize("axis", [None, 0, np.int64(1), -1])
def test_vectors_along_axes(chunks, axis):
    x = draw.standard_normal((9_001, 7, 3)).astype(np.float32)
    wanted = np.asarray(sh.reduce(later, sh.Stream(x, sh.Attrib3f, "numpy"), axis=axis))
    found = sh.reduce(later, da.from_array(x, chunks=chunks), axis=axis)
    assert found.shape == wanted.shape
    assert found.compute().tobytes() == wanted.tobytes()


def test_mistakes_are_errors_before_anything_runs():
    x = da.ones((4, 3), chunks=2)
    with pytest.raises(sh.ShpyTypeError, match="axis=2 of an array of 2 axes of elements is not an axis\n"):
        sh.reduce(add, x, axis=2)
    with pytest.raises(sh.ShpyTypeError, match="has no result"):
        sh.reduce(add, x[:0])
    with pytest.raises(sh.ShpyTypeError, match="takes floats, not bool"):
        sh.reduce(add, x > 1)
    with pytest.raises(sh.ShpyTypeError, match="takes a program of two scalars or vectors"):
        sh.reduce(max, x)
    filtered = da.ones(9, chunks=2, dtype=np.float32)
    filtered = filtered[filtered > 0]
    for call in (lambda: sh.reduce(add, filtered), lambda: sh.scan(add, filtered), lambda: sh.sort(filtered)):
        with pytest.raises(sh.ShpyTypeError, match="the array has chunks of unknown sizes") as caught:
            call()
        assert caught.value.cure == "array.compute_chunk_sizes()"


@pytest.mark.parametrize("n", [1, 2, 4096, 4097, 20_001])
@pytest.mark.parametrize("chunks", [1_000, 8_192])
@pytest.mark.parametrize("exclusive", [False, True])
def test_scans_have_the_bits_of_one_stream(n, chunks, exclusive):
    x = (draw.standard_normal(n) * 10.0 ** draw.integers(-6, 6, n)).astype(np.float32)
    wanted = sh.scan(add, sh.Stream(x, sh.Attrib1f, "numpy"), exclusive).numpy()
    found = sh.scan(add, da.from_array(x, chunks=chunks), exclusive)
    assert (found.shape, found.dtype) == (wanted.shape, wanted.dtype)
    assert found.compute().tobytes() == wanted.tobytes()


def test_scans_of_vectors_keep_the_shape():
    x = draw.standard_normal((9_001, 7, 3)).astype(np.float32)
    wanted = sh.scan(later, sh.Stream(x, sh.Attrib3f, "numpy")).numpy()
    found = sh.scan(later, da.from_array(x, chunks=(700, 7, 2)))
    assert found.shape == x.shape
    assert found.compute().tobytes() == wanted.tobytes()
