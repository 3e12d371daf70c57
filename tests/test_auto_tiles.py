"""The tiles of numpy's first calls under the backend "auto": the clock is read soon."""

import numpy as np
import pytest

import shpy as sh
from shpy.backend.numpy.tables import places_of

X = np.linspace(-4, 4, 70_000, dtype=np.float32)


@pytest.mark.parametrize("known", [False, True])
def test_the_first_tile_takes_less_time_than_compiling(monkeypatch, known):
    """The clock is read after 256 elements, which may take a minute; where their time is not long, after a tile."""

    @sh.program
    def twice(x: sh.Attrib1f):
        return x * 2

    kernel, sizes = twice.compile("auto"), []
    executable = kernel._executable
    quick = type(executable._quick)
    run_until = quick.run_until

    def watched(self, call, stop, first):
        return run_until(self, call, lambda done: sizes.append(done), first)

    monkeypatch.setattr(quick, "run_until", watched)
    if known:
        executable._elements, executable._seconds = 1000, 1e-6
    expected = [65_536] if known else [256, 1280, 5376, 21_760]
    assert np.array_equal(kernel(X), X * 2)
    assert sizes == expected
    executable._elements, executable._seconds = 1000, 1000.0
    del sizes[:]
    kernel(X)
    assert sizes[0] == 256


@pytest.mark.parametrize(
    "shape", [(70_000,), (7, 10_000), (300, 233), (1, 70_000), (70_000, 1), (8, 70_001), (3, 5, 7)]
)
@pytest.mark.parametrize("grid", [True, False])
@pytest.mark.parametrize("first", [None, 1, 256, 4096, 65_536])
def test_tiles_that_grow_cover_each_element_once(shape, grid, first):
    places = places_of(shape, 65_536, grid=grid, first=first)
    assert [p.start for p in places] == [0, *(p.stop for p in places[:-1])]
    assert places[-1].stop == np.prod(shape)
    assert all(0 < p.stop - p.start <= 65_536 for p in places)
    assert all(p.start % shape[1] == p.stop % shape[1] == 0 for p in places if p.block)
    assert all(p.block == places[0].block for p in places)
