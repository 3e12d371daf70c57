"""Stencils in packets: the kernel asks once whether all neighbours of a packet are in range; answers stay the same.

Expected values are those of numpy's indexing of the whole grid, and of the numpy backend.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import shpy as sh
from shpy.testing.arrays import flat_leaves

RNG = np.random.default_rng(5)
LANES = (4, 8, 16, 32, 64)
SIDES = ((1, 1), (3, 64), (5, 63), (2, 65), (7, 128), (4, 131), (65, 200), (3, 1030))
"""Grids with packets at all borders, in the middle, and in part beyond the end of a row; one has long lines."""
SYMBOL = "bool inside = "


def moved(
    field: NDArray[Any], shape: tuple[int, int], by: tuple[int, int], moduli: tuple[int, int] | None = None
) -> NDArray[Any]:
    """Return what the element at `by` from each place of a grid holds: modulo `moduli`, then the nearest in range."""
    places = [np.arange(n, dtype=np.int32) + np.int32(b) for n, b in zip(shape, by, strict=True)]
    if moduli is not None:
        places = [np.mod(p, m) for p, m in zip(places, moduli, strict=True)]
    rows, columns = (np.clip(p, 0, n - 1) for p, n in zip(places, field.shape, strict=True))
    return field[np.ix_(rows, columns)]


def stencil(offsets: tuple[tuple[int, int], ...], wraps: str = "") -> sh.Program:
    """Record the neighbours at some offsets, one output each."""

    @sh.program
    def around(t: sh.Table[sh.Attrib1f, 2], other: sh.Attrib2i) -> Any:
        place = sh.grid_index(2)
        moduli = {"grid": sh.grid_shape(2), "table": t.shape, "other": other}
        places = [place + by for by in offsets]
        return tuple(t[p % moduli[wraps] if wraps else p] for p in places)

    return around


NEAR = ((0, 0), (-1, 0), (1, 1), (0, -17), (2, 3))


@pytest.mark.sampled(18)
@pytest.mark.parametrize("wraps", ["", "grid", "table"])
@pytest.mark.parametrize("lanes", LANES)
def test_borders(lanes: int, wraps: str) -> None:
    compiled = stencil(NEAR, wraps).compile("opencl", lanes=lanes)
    assert SYMBOL in compiled.source
    for shape in (*SIDES, (37, lanes)):  # the last one has a packet in each line
        field = RNG.random(shape, np.float32)
        answers = compiled(field, (1, 1), shape=shape)
        for by, answer in zip(NEAR, answers, strict=True):
            assert np.array_equal(answer, moved(field, shape, by, shape if wraps else None)), (shape, by)


@pytest.mark.sampled(16)
@pytest.mark.parametrize("wraps", ["", "grid", "table", "other"])
@pytest.mark.parametrize("sides", [((6, 150), (6, 150)), ((6, 150), (9, 70)), ((6, 150), (3, 300)), ((1, 1), (5, 64))])
@pytest.mark.parametrize("lanes", [4, 16, pytest.param(64, marks=pytest.mark.slow)])
def test_tables_of_other_sizes_than_the_grid_and_moduli_that_are_not_its_shape(
    lanes: int, sides: tuple[tuple[int, int], tuple[int, int]], wraps: str
) -> None:
    size, shape = sides
    other = (4, 97)
    field = RNG.random(size, np.float32)
    compiled = stencil(NEAR, wraps).compile("opencl", lanes=lanes)
    assert (SYMBOL in compiled.source) == (wraps != "other")
    answers = compiled(field, other, shape=shape)
    moduli = {"": None, "grid": shape, "table": size, "other": other}[wraps]
    for by, answer in zip(NEAR, answers, strict=True):
        assert np.array_equal(answer, moved(field, shape, by, moduli)), by


FAR = (1 << 16, (1 << 16) + 1, 2**31 - 1, -(2**31))


@pytest.mark.sampled(6)
@pytest.mark.parametrize("by", [(0, FAR[0]), (0, FAR[1]), (0, -FAR[1]), (FAR[2], 0), (0, FAR[2]), (FAR[3], FAR[3])])
@pytest.mark.parametrize("wraps", ["", "grid"])
def test_far_offsets_wrap_around_as_ints_do(by: tuple[int, int], wraps: str) -> None:
    shape = (3, FAR[1] + 70)
    field = RNG.random(shape, np.float32)
    offsets = (by, (0, 1))
    compiled = stencil(offsets, wraps).compile("opencl", lanes=16)
    assert (SYMBOL in compiled.source) == (max(map(abs, by)) <= 1 << 16)
    with np.errstate(over="ignore"):
        for k, answer in enumerate(compiled(field, (1, 1), shape=shape)):
            assert np.array_equal(answer, moved(field, shape, offsets[k], shape if wraps else None))


@sh.program
def two(a: sh.Table[sh.Attrib1i, 2], b: sh.Table[sh.Attrib1b, 2], x: sh.Attrib1f) -> sh.Attrib1f:
    i = sh.grid_index(2)
    total = sh.Attrib1f(a[i - (2, 5)] + a[i + (0, 1)]) + x
    return sh.cond(b[i + (1, 0)], total, -total)


@sh.program
def guarded(a: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    i = sh.grid_index(2)
    sh.SH_DISCARD(a[i] < 0.5)
    total = sh.Attrib1f(0)
    with sh.SH_FOR(0, 3):
        total += a[i + (0, 1)] - a[i - (1, 0)]
    return total


@sh.program
def single(a: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    i = sh.grid_index(2)
    return a[i + (0, 1)] - a[i - (1, 0)]


@pytest.mark.sampled(12)
@pytest.mark.parametrize("precision", ["f16", "f32", "f64"])
@pytest.mark.parametrize("columns", [140, 1])
@pytest.mark.parametrize("lanes", [4, 16, 64])
def test_types_several_tables_discards_and_loops_give_the_bits_of_numpy(
    lanes: int, columns: int, precision: Any
) -> None:
    shape = (9, columns) if columns > 1 else (37, lanes)
    x = RNG.random(shape).astype({"f16": np.float16, "f32": np.float32, "f64": np.float64}[precision])
    a, b = RNG.integers(-9, 9, (8, 150), np.int32), RNG.random(shape) < 0.5
    for program, arguments in ((two, (a, b, x)), (guarded, (x,)), (single, (x,))):
        runs = [
            program.compile(backend, precision=precision, **options).run(*arguments, shape=shape)
            for backend, options in (("numpy", {}), ("opencl", {"lanes": lanes}))
        ]
        numpy, opencl = ([np.asarray(e) for e in flat_leaves(run.outputs)] for run in runs)
        for expected, answer in zip(numpy, opencl, strict=True):
            assert expected.tobytes() == answer.tobytes(), program


def test_names_of_the_kernels_own_variables() -> None:
    @sh.program
    def many(x: sh.Table[sh.Attrib1f, 2], y: sh.Table[sh.Attrib1f, 2], end: sh.Attrib1f, last: sh.Attrib1f) -> Any:
        i = sh.grid_index(2)
        beside = {"x": x[i + (0, 1)] + end, "y": y[i - (1, 0)] * last, "end": x[i] - y[i], "last": end, "start": x[i]}
        return beside | {"corner": last + 1, "inside": x[i + (2, 0)], "packet": y[i + (0, 3)]}

    a, b = RNG.random((2, 9, 150), np.float32)
    expected, answers = (many.compile(name)(a, b, b, a) for name in ("numpy", "opencl"))
    assert {name: x.tobytes() for name, x in answers.items()} == {name: x.tobytes() for name, x in expected.items()}


def test_a_chain_gives_the_bits_of_numpy() -> None:
    chain = sh.repeat(single, 7)
    field = RNG.random((70, 300), np.float32)
    answers = [chain.run(a=field, backend=name).streams["a"].numpy() for name in ("numpy", "opencl")]
    assert answers[0].tobytes() == answers[1].tobytes()
