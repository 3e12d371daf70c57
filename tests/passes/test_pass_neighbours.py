"""Which reads of a table are found to lie beside the element's own place, and that they give what they gave."""

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR, SH_IF, SH_WHILE
from shpy.backends.base import Options
from shpy.backends.numpy.tables import Place, TableView
from shpy.ir.nodes import Let
from shpy.ir.traverse import walk
from shpy.ir.verifier import verify
from shpy.passes.neighbours import find_neighbours
from shpy.passes.pipeline import Target, prepare
from shpy.passes.vectorize import vectorize

Image = sh.Table[sh.Attrib1f, 2]


def reads(program):
    """The operations by which the prepared program reads tables."""
    vector = vectorize(prepare(program.ir, Options(), Target("vector", vector=True)).module)
    made = find_neighbours(vector).module
    verify(made)
    return sorted(s.op for s in walk(made.entry.body) if isinstance(s, Let) and s.op in ("table", "neighbour"))


@sh.program
def constants(t: Image):
    row, column = sh.grid_index(2)
    return t[row - 1, column] + t[row, column + 3] + t[1 + row, 2 + column - 5]


@sh.program
def vectors(t: Image):
    return t[sh.grid_index(2) + sh.Attrib2i(1, -2)]


@sh.program
def counted(t: Image, by: sh.Attrib1i):
    row, column = sh.grid_index(2)
    total = sh.Attrib1f(0)
    with SH_FOR(-2, 3) as k:
        total += t[row, column + k]
    return total


@sh.program
def line(t: sh.Table[sh.Attrib3f]):
    i = sh.grid_index(1)
    return t[i + 1] - t[i - 1]


@pytest.mark.parametrize(("program", "count"), [(constants, 3), (vectors, 1), (counted, 1), (line, 2)])
def test_the_own_place_moved_by_what_is_uniform_is_found(program, count):
    assert reads(program) == ["neighbour"] * count


@sh.program
def swapped(t: Image):
    row, column = sh.grid_index(2)
    return t[column, row]


@sh.program
def scaled(t: Image):
    row, column = sh.grid_index(2)
    return t[row, 2 * column] + t[row, 5 - column]


@sh.program
def varying(t: Image, by: sh.Attrib1i):
    row, column = sh.grid_index(2)
    return t[row, column + by]


@sh.program
def of_another_rank(t: sh.Table[sh.Attrib1f]):
    return t[sh.grid_index(2).y + 1]


@sh.program
def where_lanes_leave(t: Image):
    row, column = sh.grid_index(2)
    total, k = sh.Attrib1f(0), sh.Attrib1i(0)
    with SH_WHILE(lambda: total < 10):
        k += 1
        total += 1 + t[row, column + k]
    return total


@pytest.mark.parametrize("program", [swapped, scaled, varying, of_another_rank, where_lanes_leave])
def test_any_other_index_is_left_alone(program):
    assert "neighbour" not in reads(program)


limit = sh.Param(sh.Attrib1i, 3, name="limit")


@sh.program
def stencil(t: Image, u: sh.Table[sh.Attrib4f, 2]):
    row, column = sh.grid_index(2)
    total = sh.Attrib4f(0)
    with SH_FOR(-2, 3) as k:
        total += t[row + k, column - 2 * k] * u[row, column + k]
    with SH_IF(t[row, column] > 0.5):
        total += t[row + limit, column]
    return total, t[row - limit, column + limit]


OFFSETS = (0, 1, -4, 30, -1000, 2**31 - 1, -(2**31))


@pytest.mark.parametrize("target", ["numpy", "opencl-4", "opencl-16", "opencl-1", "glsl"])
@pytest.mark.parametrize(
    ("shape", "extents"), [((9, 23), (9, 23)), ((40, 33), (7, 90)), ((3, 4), (11, 2)), ((1, 70), (1, 1))]
)
def test_they_give_what_they_gave(target, shape, extents):
    rng = np.random.default_rng(7)
    given = rng.random(extents).astype(np.float32), rng.random((*extents, 4)).astype(np.float32)
    name, _, lanes = target.partition("-")
    kernel = stencil.compile(name, **({"lanes": int(lanes)} if lanes else {}))
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.int32)

    def at(table, y, x):
        return table[np.clip(y, 0, extents[0] - 1), np.clip(x, 0, extents[1] - 1)]

    for offset in OFFSETS:
        limit.value = offset
        total = np.zeros((*shape, 4), np.float32)
        for k in range(-2, 3):
            total += at(given[0], row + k, column - 2 * k)[..., None] * at(given[1], row, column + k)
        far = at(given[0], row + np.int32(offset), column)
        total += np.where(at(given[0], row, column) > 0.5, far, 0)[..., None]
        found = kernel(*given, shape=shape)
        assert np.array_equal(found[0], total)
        with np.errstate(over="ignore"):
            assert np.array_equal(found[1], at(given[0], row - np.int32(offset), column + np.int32(offset)))


@pytest.mark.parametrize("shape", [(200,), (13, 17), (1, 200), (200, 1)])
@pytest.mark.parametrize("extents", [(5,), (300,), (6, 9), (40, 50), (13, 17)])
def test_a_tile_anywhere_reads_its_neighbours(shape, extents):
    if len(shape) != len(extents):
        return
    for tail in ((), (3,)):
        array = np.random.default_rng(3).random((*extents, *tail)).astype(np.float32)
        table = TableView(array, len(extents))
        for start, stop in ((0, 7), (3, 4), (16, 35), (90, 200), (0, 200)):
            place = Place(start, stop, shape)
            for offset in ((0, 0), (1, -1), (-3, 8), (50, -90), (2**31 - 1, 5)):
                moved = offset[-len(extents) :]
                by = np.array(moved, np.int32).reshape(-1, *[1] * (len(moved) > 1))
                assert np.array_equal(table.neighbour(place, *moved), table.gather(place.index + by))
