"""Dask arrays with empty chunks, and of no elements, give what one stream gives."""

import dask.array as da
import numpy as np
import pytest

import shpy as sh


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


X = np.array([[3, 1, 4, 1], [5, 9, 2, 6]], np.float32)
WORK = {
    "reduce": lambda x: sh.reduce(add, x),
    "scan": lambda x: sh.scan(add, x),
    "sort": sh.sort,
    "compact": lambda x: sh.compact(x, x > 2).elements,
    "scatter": lambda x: sh.scatter(x, (x * 0).astype("i4"), 2),
}


@pytest.mark.parametrize("chunks", [((0, 2), (4,)), ((1, 0, 1), (4, 0)), ((2, 0), (1, 0, 3))], ids=str)
@pytest.mark.parametrize("name", WORK)
def test_empty_chunks_add_nothing(name, chunks):
    found = np.asarray(WORK[name](da.from_array(X, chunks=chunks)).compute())
    wanted = np.asarray(WORK[name](da.from_array(X, chunks=(2, 4))).compute())
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("name", ["scan", "sort", "compact"])
def test_an_array_of_no_elements_has_none_afterwards(name):
    empty = da.from_array(np.zeros((0, 3), np.float32), chunks=((0,), (1, 2)))
    assert np.asarray(WORK[name](empty).compute()).size == 0
