"""Kernels that know their place in a grid run on blocks of rows, in which a row or a column is computed but once."""

import numpy as np
import pytest
from backends.running import covering

import shpy as sh
from shpy import SH_DISCARD, SH_FOR, SH_IF, SH_WHILE
from shpy.backend.base import Call, Options
from shpy.backend.numpy.device.run import TARGET, NumpyBackend
from shpy.backend.numpy.tables import Place, TableView
from shpy.backend.numpy.text import apart
from shpy.ir.tabledata import TableData
from shpy.passes.pipeline import prepare

SHAPES = [(0, 3), (3, 0), (1, 1), (1, 9), (9, 1), (5, 4), (7, 6), (3, 40)]


@sh.program
def scene(light: sh.Attrib1f, colors: sh.Table[sh.Attrib3f, 2]) -> tuple[sh.Attrib3f, sh.Attrib1i]:
    """A bit of everything that can stand in straight code: vectors, tables, masks, a uniform loop, a discard."""
    row, column = sh.grid_index(2)
    at = (sh.vec2(column, row) + 0.5) / 4.0
    color = sh.Attrib3f(colors[row, column + 1])
    with SH_FOR(3) as k:
        color += sh.noise(at * (k + 1)) * sh.vec3(at, light)
    with SH_IF(row > 1):
        color[:] = sh.normalize(color) + colors[column, row]
    SH_DISCARD((row == 0) & (column > 2))
    return color, sh.Attrib1i(sh.length(at) * 100)


def run(module, shape, tile, *, blocks):
    """The outputs and the status, in tiles of `tile` lanes."""
    rng = np.random.default_rng(3)
    executable = NumpyBackend().compile(module, Options(), tile=tile)
    assert executable.layout.grid
    assert executable.layout.apart
    executable.layout = apart.ApartLayout(executable.layout.vector, apart=True, grid=blocks)
    count = int(np.prod(shape))
    light = rng.random(count).astype(np.float32)
    table = TableData(rng.random((6, 5, 3)).astype(np.float32))
    outputs = np.full((count, 3), -1, np.float32), np.full(count, -1, np.int32)
    status = executable.run(Call(shape, (light,), outputs, {}, {"colors": table}))
    return *outputs, status


@pytest.mark.sampled(6)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("tile", [12, 50, 1000])
def test_blocks_give_what_lanes_give(shape, tile):
    module = scene.ir
    assert all(map(np.array_equal, run(module, shape, tile, blocks=True), run(module, shape, 7, blocks=False)))


def test_every_backend_gives_the_same():
    rng = np.random.default_rng(1)
    colors, light = rng.random((6, 5, 3)).astype(np.float32), rng.random((40, 50)).astype(np.float32)
    sh.testing.assert_equivalent(scene, light, colors=sh.Table(colors, sh.Attrib3f), backends=covering(0))


def layout_of(program):
    return apart.lay_out(prepare(program.ir, Options(), TARGET).module)


def test_what_depends_on_the_column_alone_is_one_row():
    @sh.program
    def columns() -> sh.Attrib1f:
        row, column = sh.grid_index(2)
        return sh.sqrt(sh.Attrib1f(column)) + row

    seen = []
    kernel = columns.compile("numpy")
    entry = kernel._executable.entry

    def watched(grid_index, *others):
        seen.append([axis.shape for axis in grid_index])
        return entry(grid_index, *others)

    kernel._executable.entry = watched
    np.testing.assert_array_equal(kernel(shape=(3, 4)), np.sqrt(np.float32([0, 1, 2, 3])) + np.float32([[0], [1], [2]]))
    assert seen == [[(3, 1), (1, 4)]]


def test_vectors_are_taken_apart_where_loops_make_them():
    @sh.program
    def makes(c: sh.Attrib2f) -> sh.Attrib2f:
        z = sh.Attrib2f(0, 0)
        with SH_FOR(9):
            z[:] = sh.Attrib2f(z.x * z.x - z.y * z.y, 2 * z.x * z.y) + c
        return z

    @sh.program
    def uses(c: sh.Attrib2f) -> sh.Attrib2f:
        z = sh.Attrib2f(c.yx)
        with SH_FOR(9):
            z[:] = z * z - c
        return z

    assert layout_of(makes).apart
    assert not layout_of(uses).apart


def test_lanes_that_leave_a_loop_are_no_block():
    @sh.program
    def leaves() -> sh.Attrib1f:
        x = sh.Attrib1f(sh.grid_index(2).x)
        with SH_WHILE(lambda: x < 10):
            x += 3
        return x

    assert not layout_of(leaves).grid


def test_neighbours_of_any_block_are_the_nearest_elements():
    """Blocks and runs of elements in tables smaller, larger and of other shape than the grid, near and far offsets."""
    rng = np.random.default_rng(11)
    for _ in range(600):
        height, width = rng.integers(1, 40, 2)
        table = rng.random((height, width), np.float32)
        shape = tuple(int(n) for n in rng.integers(1, 40, 2))
        block = bool(rng.integers(2))
        if block:
            first = int(rng.integers(0, shape[0]))
            start, stop = first * shape[1], int(rng.integers(first + 1, shape[0] + 1)) * shape[1]
        else:
            start = int(rng.integers(0, shape[0] * shape[1]))
            stop = int(rng.integers(start + 1, shape[0] * shape[1] + 1))
        place, view = Place(start, stop, shape, block), TableView(table, 2)
        y, x = np.unravel_index(np.arange(start, stop), shape)
        for reach in (1, 2, 3, 16, 17, 60):
            down, across = (int(n) for n in rng.integers(-reach, reach + 1, 2))
            expected = table[np.clip(y + down, 0, height - 1), np.clip(x + across, 0, width - 1)]
            assert np.array_equal(np.ravel(view.neighbour(place, down, across)), expected)


@sh.program
def spread_twice(u: sh.Table[sh.Attrib1f, 2], v: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f, sh.Attrib1f]:
    at = sh.grid_index(2)
    around = u[at + (0, 1)] + u[at - (1, 0)]
    return around * v, around * v, v - around


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_the_results_of_a_stencil_reach_any_array(precision):
    """Several outputs may be equal, an output may be an input, and arrays that numbers lie apart in are written too."""
    rng = np.random.default_rng(3)
    u, v = rng.random((9, 300), np.float32), rng.random((9, 300), np.float32)
    kernel = spread_twice.compile("numpy", precision=precision)
    wanted = [result.copy() for result in kernel(u, v)]
    np.testing.assert_array_equal(wanted[0], wanted[1])
    sh.testing.assert_equivalent(spread_twice, u, v, backends=["interpreter", "numpy"], precision=precision)
    wide = np.zeros((9, 600), wanted[0].dtype)
    out = wide[:, ::2], np.zeros_like(wanted[0]), v.astype(wanted[0].dtype)
    kernel.run(u, out[2], out=out)
    for one, other in zip(out, kernel(u, v.astype(wanted[0].dtype)), strict=True):
        np.testing.assert_array_equal(one, other)
    assert not wide[:, 1::2].any()
