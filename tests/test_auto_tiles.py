"""The tiles of numpy's first calls under the backend "auto": the clock is read soon."""

import numpy as np
import pytest

import shpy as sh
from shpy.backend.numpy.tables import places_of
from shpy.run import tiers

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


@pytest.mark.parametrize("live", [7000, 300])
def test_opencl_goes_on_in_the_middle_of_a_list(monkeypatch, live):
    """A program that discards most elements at its start runs the others from a list, which has tiles of its own."""
    for name, value in {
        "_COLD": (0.0, 0.0),
        "_CACHED": (0.0, 0.0),
        "_START": 0.0,
        "_COMPILER": 0.0,
        "_LOOK": 0.0,
    }.items():
        monkeypatch.setattr(tiers, name, value)

    @sh.program
    def rare(x: sh.Attrib1f, k: sh.Attrib1i):
        with sh.SH_IF(k >= live):
            sh.SH_DISCARD()
        return sh.sin(x) * 2

    k, ended = np.arange(len(X), dtype=np.int32)[::-1].copy(), []
    kernel = rare.compile("auto")
    quick = type(kernel._executable._quick)
    run_until = quick.run_until

    def watched(self, *arguments):
        result = run_until(self, *arguments)
        ended.append(result[0])
        return result

    monkeypatch.setattr(quick, "run_until", watched)
    out, expected = np.full(len(X), -5, np.float32), np.full(len(X), -5, np.float32)
    kernel.run(X, k, out=out)
    assert (ended[0], kernel.runs_on) == (False, "opencl")
    rare.compile("numpy").run(X, k, out=expected)
    assert out.tobytes() == expected.tobytes()
    assert np.count_nonzero(out != -5) == live
