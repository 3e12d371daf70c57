"""sh.sort over Dask arrays: the elements of one stream's order for any chunks."""

from __future__ import annotations

import itertools

import dask
import dask.array as da
import numpy as np
import pytest

import shpy as sh
from shpy.collectives.chunk_sorting import network

draw = np.random.default_rng(5)
EDGES = np.array([0.0, -0.0, np.nan, -np.nan, np.inf, -np.inf, 1e-45, -1e-45, 1, -1], np.float32)


@sh.program
def height(p: sh.Attrib3f) -> sh.Attrib1f:
    return sh.floor(p.y)


@sh.program
def nearly_one(x: sh.Attrib1f) -> sh.Attrib1d:
    return 1 + sh.Attrib1d(x) * 1e-12


@sh.program
def halved(x: sh.Attrib1f) -> sh.Attrib1h:
    return sh.Attrib1h(x)


@pytest.fixture(autouse=True)
def one_thread():
    with dask.config.set(scheduler="synchronous"):
        yield


@pytest.mark.parametrize("count", range(1, 10))
def test_the_network_sorts_all_zeros_and_ones(count):
    for bits in itertools.product((0, 1), repeat=count):
        found = list(bits)
        for low, high in network(count):
            assert low < high
            found[low], found[high] = sorted((found[low], found[high]))
        assert found == sorted(bits)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("chunks", [1_000, 777, 130, 90])
@pytest.mark.parametrize("descending", [False, True])
@pytest.mark.parametrize("kind", ["f", "d", "h", "i", "u", "b"])
def test_numbers_are_in_the_order_of_one_stream(chunks, descending, kind):
    x = {
        "f": np.concatenate((draw.standard_normal(900).astype(np.float32), draw.choice(EDGES, 100))),
        "d": 1 + draw.random(1000) * 1e-9,  # of which float32 holds one number
        "h": draw.standard_normal(1000).astype(np.float16),
        "i": draw.integers(-(2**31), 2**31, 1000).astype(np.int32),
        "u": draw.integers(0, 2**32, 1000).astype(np.uint32),
        "b": draw.random(1000) < 0.5,
    }[kind]
    x = draw.permutation(x)
    cls = getattr(sh, f"Attrib1{kind}")
    wanted = sh.sort(sh.Stream(x, cls, "numpy"), descending=descending).numpy()
    found = sh.sort(da.from_array(x, chunks=chunks), descending=descending)
    assert (found.shape, found.dtype) == (wanted.shape, wanted.dtype)
    assert found.compute().tobytes() == wanted.tobytes()
    wanted = sh.argsort(sh.Stream(x, cls, "numpy"), descending=descending).numpy()
    found = sh.argsort(da.from_array(x, chunks=chunks), descending=descending)
    assert (found.shape, found.dtype) == (wanted.shape, wanted.dtype)
    assert found.compute().tobytes() == wanted.tobytes()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("descending", [False, True])
def test_vectors_by_a_key_are_stable(descending):
    x = (draw.standard_normal((20, 31, 3)) * 2).astype(np.float32)
    wanted = sh.sort(sh.Stream(x, sh.Attrib3f, "numpy"), key=height, descending=descending).numpy()
    chunked = da.from_array(x, chunks=(3, 10, 2))
    assert sh.sort(chunked, key=height, descending=descending).compute().tobytes() == wanted.tobytes()
    wanted = sh.argsort(sh.Stream(x, sh.Attrib3f, "numpy"), key=height, descending=descending).numpy()
    assert sh.argsort(chunked, key=height, descending=descending).compute().tobytes() == wanted.tobytes()


@pytest.mark.parametrize("key", [nearly_one, halved])
@pytest.mark.parametrize("descending", [False, True])
def test_keys_may_be_floats_of_any_width(key, descending):
    x = draw.permutation(np.concatenate((draw.standard_normal(200).astype(np.float32), draw.choice(EDGES, 50))))
    wanted = sh.sort(sh.Stream(x, sh.Attrib1f, "numpy"), key=key, descending=descending).numpy()
    assert sh.sort(da.from_array(x, chunks=70), key=key, descending=descending).compute().tobytes() == wanted.tobytes()


@pytest.mark.parametrize("kind", [np.int32, np.uint32])
def test_keys_that_are_out_of_range_count_as_the_nearest(kind):
    x = draw.integers(-20 if kind is np.int32 else 0, 20, 300).astype(kind)
    x[:3] = np.iinfo(kind).max
    cls = sh.Attrib1i if kind is np.int32 else sh.Attrib1u
    wanted = sh.argsort(sh.Stream(x, cls, "numpy"), below=10).numpy()
    assert np.array_equal(sh.argsort(da.from_array(x, chunks=70), below=10).compute(), wanted)


@pytest.mark.parametrize("collective", [sh.unique, lambda x: sh.top_k(x, 2), lambda x: sh.histogram(x, 2)])
def test_collectives_of_one_process_say_how_a_dask_array_becomes_a_stream(collective):
    with pytest.raises(sh.ShpyTypeError, match=r"\w+ takes a Stream, not a Dask array") as caught:
        collective(da.ones(5))
    assert caught.value.cure == "sh.Stream(array.compute(), type)"


def test_mistakes_are_errors_before_anything_runs():
    with pytest.raises(sh.ShpyTypeError, match="takes a program of one scalar or vector as key"):
        sh.sort(da.ones(5), key=max)
    with pytest.raises(sh.ShpyTypeError, match="takes numbers, not complex128"):
        sh.sort(da.ones(5, dtype=complex))
    with pytest.raises(sh.ShpyTypeError, match="below=4 is for keys that are ints"):
        sh.argsort(da.ones(5), below=4)
    with pytest.raises(
        sh.ShpyTypeError, match=r"sh\.argsort over a Dask array takes a program of one scalar or vector"
    ):
        sh.argsort(da.ones(5), key=max)
