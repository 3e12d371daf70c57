"""Reads of a table beside the element's own place are found, and keep their results."""

import itertools

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR, SH_IF, SH_WHILE
from shpy.backend.base import Options
from shpy.backend.numpy.tables import Place, TableView
from shpy.ir.meaning import floor_mod_int
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


@sh.program
def board(t: Image):
    at = sh.grid_index(2)
    return t[(at + (1, -1)) % sh.grid_shape(2)] + t[(at - 2) % sh.grid_shape(2)] + t[at % t.shape]


@sh.program
def ring(t: sh.Table[sh.Attrib3f]):
    return t[(sh.grid_index(1) - 1) % 5]


@pytest.mark.parametrize(
    ("program", "count"), [(constants, 3), (vectors, 1), (counted, 1), (line, 2), (board, 3), (ring, 1)]
)
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


@sh.program
def wrapped_on_one_axis(t: Image):
    row, column = sh.grid_index(2)
    return t[row, (column + 1) % 7]


@sh.program
def moved_after(t: Image):
    return t[(sh.grid_index(2) + 1) % sh.grid_shape(2) + 1] + t[sh.grid_index(2) % 9 % 4]


@sh.program
def modulo_what_varies(t: Image, by: sh.Attrib1i):
    return t[sh.grid_index(2) % by] + t[5 % sh.grid_index(2)]


OTHERS = [swapped, scaled, varying, of_another_rank, where_lanes_leave]


@pytest.mark.parametrize("program", [*OTHERS, wrapped_on_one_axis, moved_after, modulo_what_varies])
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


@pytest.mark.sampled(6)
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


modulus = sh.Param(sh.Attrib1i, 3, name="modulus")


@sh.program
def torus(t: Image, u: sh.Table[sh.Attrib3f, 2], v: sh.Table[sh.Attrib1b, 2]):
    at = sh.grid_index(2)
    near = t[(at + (1, -1)) % sh.grid_shape(2)] - t[(at - (2, 3)) % t.shape]
    return near, u[(at + limit) % modulus], v[(at - limit) % sh.Attrib2i(4, modulus)]


@sh.program
def circle(t: sh.Table[sh.Attrib2f], u: sh.Table[sh.Attrib1f]):
    i = sh.grid_index(1)
    return t[(i - limit) % modulus] + u[(i + 1) % sh.grid_shape(1)]


MODULI = (64, 1, 0, -5, 17, 2**31 - 1, -(2**31))


@pytest.mark.sampled(18)
@pytest.mark.parametrize("target", ["numpy", "opencl-4", "opencl-16", "opencl-64", "opencl-1", "glsl"])
@pytest.mark.parametrize(("shape", "extents"), [((64, 64), (64, 64)), ((40, 33), (7, 90)), ((3, 4), (11, 2))])
def test_boards_that_wrap_around_give_what_they_gave(target, shape, extents):
    rng = np.random.default_rng(7)
    given = rng.random(extents, np.float32), rng.random((*extents, 3), np.float32), rng.random(extents) < 0.5
    name, _, lanes = target.partition("-")
    options = {"lanes": int(lanes)} if lanes else {}
    kernel, around = torus.compile(name, **options), circle.compile(name, **options)
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.int32)

    def at(table, *index):
        moduli = index[len(index) // 2 :]
        wrapped = [floor_mod_int(i, np.int32([n])) for i, n in zip(index, moduli, strict=False)]
        return table[tuple(np.clip(i, 0, n - 1) for i, n in zip(wrapped, table.shape, strict=False))]

    for offset, n in itertools.product((0, 1, -4, 30, 2**31 - 1, -(2**31)), MODULI):
        limit.value, modulus.value, by = offset, n, np.int32(offset)
        near = at(given[0], row + 1, column - 1, *shape) - at(given[0], row - 2, column - 3, *extents)
        with np.errstate(over="ignore"):
            wanted = near, at(given[1], row + by, column + by, n, n), at(given[2], row - by, column - by, 4, n)
            i = np.arange(shape[0] * shape[1], dtype=np.int32)
            flat = given[1][..., :2].reshape(-1, 2)
            once = at(flat, i - by, n) + at(given[0].ravel(), i + 1, len(i))[:, None]
        for found, expected in zip(kernel(*given, shape=shape), wanted, strict=True):
            assert np.array_equal(found, expected), (offset, n)
        assert np.array_equal(around(flat, given[0].ravel(), shape=len(i)), once), (offset, n)


@pytest.mark.sampled(2)
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
                for moduli in (extents, (4, 11)[-len(extents) :], (0, 2**31 - 1)[-len(extents) :]):
                    divisor = np.array(moduli, np.int32).reshape(by.shape)
                    expected = table.gather(floor_mod_int(place.index + by, divisor))
                    assert np.array_equal(table.neighbour(place, *moved, *moduli), expected)
