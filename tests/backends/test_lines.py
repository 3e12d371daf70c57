"""Values that depend on the line of the grid alone: packets compute them once, with the bits of each element."""

import re
from typing import Any

import numpy as np
import pytest
from backends.test_packets import same
from passes.random_ir import LOOP_LIMIT, random_module

import shpy as sh
from shpy import SH_BREAK, SH_ELSE, SH_FOR, SH_IF
from shpy.backend.base import Call, Options
from shpy.backend.opencl.device.building import backend
from shpy.backend.opencl.packets import module as packets
from shpy.ir.builder import Builder
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Let, Module, Status
from shpy.ir.tabledata import TableData
from shpy.ir.traverse import walk
from shpy.ir.types import Base, vec
from shpy.passes.lines import in_lines, mixed, reads_lines

SHAPES = ((3, 5), (5, 32), (33, 37), (2, 3, 33), (2, 2, 3, 17))
TABLES = {
    "data": TableData(np.arange(5, dtype=np.float32)),
    "grid": TableData(np.arange(12, dtype=np.float32).reshape(2, 3, 2)),
}


@pytest.mark.sampled(12)
@pytest.mark.parametrize("seed", range(60))
def test_random_programs_in_lines(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lanes that diverge stay in lines here, too, so that every form of control flow depends on lines."""
    monkeypatch.setattr(packets, "_stay_together", lambda module: True)
    shape, lanes = SHAPES[seed % len(SHAPES)], (4, 8, 16)[seed % 3]
    module = random_module(seed, axes=len(shape))
    count, rng = int(np.prod(shape)), np.random.default_rng(seed)
    inputs = (
        rng.normal(0, 2, count).astype(np.float32),
        rng.normal(0, 2, (1 if seed % 7 == 0 else count, 3)).astype(np.float32),
        rng.integers(-3, 4, 1 if seed % 4 == 0 else count).astype(np.int32),
        rng.integers(0, 2**32, count).astype(np.uint32),
    )
    results = []
    for width in (lanes, 1):
        executable = backend.compile(module, Options(loop_limit=LOOP_LIMIT, lanes=width))
        outputs = (np.zeros(count, np.float32), np.zeros((count, 3), np.float32), np.zeros(count, np.int32))
        status = executable.run(Call(shape, inputs, outputs, {"scale": np.float32(1.5)}, TABLES))
        ended = np.ones(count, np.int32) if status is None else status
        results.append(([str(executable.loops[k - 2]) if k > 1 else k for k in ended], *outputs))
    assert results[0][0] == results[1][0]
    for one, other in zip(results[0][1:], results[1][1:], strict=True):
        same(one, other)
    reference = Interpreter(module, loop_limit=LOOP_LIMIT)
    for at in rng.choice(count, min(count, 12), replace=False):
        index = tuple(int(i) for i in np.unravel_index(at, shape))
        element = [a[at if len(a) > 1 else 0] for a in inputs]
        tables = {name: table.array for name, table in TABLES.items()}
        expected, ended = reference.run_element(element, {"scale": np.float32(1.5)}, tables, index, shape)
        assert (ended == Status.WRITTEN) == (results[0][0][at] == Status.WRITTEN)
        if ended == Status.WRITTEN:
            for output, value in zip(results[0][1:], expected, strict=True):
                same(output[at], value)


# Programs that depend on lines in every way


@sh.subroutine
def shade(p: sh.Attrib2f) -> sh.Attrib1f:
    return sh.noise(p) + sh.fract(p.y) * sh.floor(p.x)


@sh.program
def branches(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib2i]:
    row, column = sh.grid_index(2)
    y, n = sh.Attrib1f(x), sh.Attrib2i(row, 0)
    with SH_IF(row % 3 == 0):
        y += sh.sqrt(row)
        with SH_IF(column > 2):
            y *= 2
    with SH_ELSE():
        n.y += row * row
    with SH_IF(x > row):
        y -= row
    return y, n


@sh.program
def loops(x: sh.Attrib1f) -> sh.Attrib1f:
    row, column = sh.grid_index(2)
    total = sh.Attrib1f(0)
    with SH_FOR(0, row) as k:
        SH_BREAK(k > 6)
        with SH_IF(k + column > 4):
            total += x / (k + 1)
    return total


@sh.program
def functions(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f, sh.Attrib1f]:
    row, column = sh.grid_index(2)
    p = 0.37 * sh.Attrib2f(row, column)
    return shade(p), shade(p.yx), shade(sh.Attrib2f(row, 0.5)) * x + sh.atan2(row, column) + sh.pow(row, x)


@sh.program
def volume(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib3i]:
    z, y, c = sh.grid_index(3)
    return x * z - y + sh.noise(0.2 * sh.Attrib3f(z, y, c)), sh.Attrib3i(c, z, y)


PROGRAMS = {"branches": branches, "loops": loops, "functions": functions, "volume": volume}


@pytest.mark.parametrize("lanes", [4, 16, 64])
@pytest.mark.parametrize("name", PROGRAMS)
def test_every_backend_has_the_bits_of_numpy(name: str, lanes: int) -> None:
    program = PROGRAMS[name]
    shape = (3, 5, 37) if name == "volume" else (13, 37)
    x = np.random.default_rng(1).normal(3, 4, shape).astype(np.float32)
    expected = program.compile("numpy")(x)
    outputs = program.compile("opencl", lanes=lanes)(x)
    alone = program.compile("opencl", lanes=1)(x)
    for one, other, third in zip(*map(listed, (outputs, expected, alone)), strict=True):
        same(one, other)
        same(third, other)


def listed(outputs: Any) -> list[Any]:
    return list(outputs) if isinstance(outputs, tuple) else [outputs]


# Texts


def entry_of(program: sh.Program, lanes: int = 8) -> str:
    """Return the last functions of the text: the kernel, and the entry where it is a function of its own."""
    source = program.compile("opencl", lanes=lanes).source
    start = source.find(f" {program.name}_packet(")
    return source[start if start >= 0 else source.index("__kernel") :]


def test_values_of_a_line_are_scalars() -> None:
    text = entry_of(functions)
    assert "int grid_line = corner.y;" in text
    assert "float p_x = 0.37f" in text
    assert "float8 p_y = 0.37f" in text
    assert "float t5 = shade_3(t, 0.5f);" in text


def test_functions_have_a_form_for_each_combination_of_arguments() -> None:
    source = functions.compile("opencl", lanes=8).source
    forms = set(re.findall(r"float8 noise2\w*\(([^)]*)\)", source))
    assert {"float p_x, float8 p_y", "float8 p_x, float p_y"} <= {form for form in forms if form.startswith("float")}


def test_branches_by_line_are_branches() -> None:
    @sh.program
    def chosen(x: sh.Attrib1f) -> sh.Attrib1f:
        row, column = sh.grid_index(2)
        y = sh.Attrib1f(x)
        with SH_IF(row > 4):
            y += sh.sqrt(column)
        return y

    assert "if (grid_line > 4) {" in entry_of(chosen)


def test_lanes_that_diverge_stay_in_blocks() -> None:
    @sh.program
    def escape(x: sh.Attrib1f) -> sh.Attrib1f:
        row, _ = sh.grid_index(2)
        n = sh.Attrib1f(0)
        with SH_FOR(0, 50):
            SH_BREAK(x > n * row)
            n += 1
        return n

    assert "grid_line" not in escape.compile("opencl", lanes=16).source


def test_stencils_still_read_neighbours() -> None:
    @sh.program
    def slope(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
        row, column = sh.grid_index(2)
        height, width = sh.grid_shape(2)
        return u[row + 1, column] - u[(row - 1) % height, (column + 1) % width] + sh.cond(row > 2, 0.5, 1.0)

    u = np.random.default_rng(2).normal(size=(19, 45)).astype(np.float32)
    kernels = [slope.compile("opencl", lanes=16), slope.compile("numpy")]
    assert "sh_near2_f" in kernels[0].source
    assert "sh_around2_f" in kernels[0].source
    assert "sh_gather" not in kernels[0].source[kernels[0].source.index(" slope_packet(") :]
    same(*(k(u=u, shape=u.shape) for k in kernels))


def test_a_function_that_reads_the_index_varies_with_it() -> None:
    """Its arguments did not, so that it was called for one lane, which the driver refused."""

    @sh.subroutine
    def ramp(k: sh.Attrib1f) -> sh.Attrib1f:
        return k * sh.grid_index(2).x + sh.grid_index(2).y

    @sh.program
    def plane() -> sh.Attrib1f:
        return ramp(sh.Attrib1f(2))

    row, column = np.indices((5, 19), dtype=np.float32)
    for lanes in (1, 4, 16):
        np.testing.assert_array_equal(plane.compile("opencl", lanes=lanes)(shape=(5, 19)), 2 * row + column)


def test_the_pass_reads_whole_lines_and_parts_of_them() -> None:
    b = Builder("parts")
    index = b.let("grid_index", type=vec(Base.I, 3))
    y = b.output(vec("i"), "y")
    b.store(y, b.let("add", b.swizzle(index, (1,)), b.swizzle(index, (2,))))
    module = Module("parts", (), (), (), (), (b.finish(),))
    assert reads_lines(module)
    lets = [s for s in walk(in_lines(module).entry.body) if isinstance(s, Let)]
    assert [s.op for s in lets] == ["grid_index", "grid_line", "swizzle", "swizzle", "add"]
    assert lets[1].value.type == vec(Base.I, 2)


def test_small_functions_stay_pure() -> None:
    names = mixed(functions.ir)
    assert "noise2" in names
    assert not {"gradient2", "scramble"} & names
