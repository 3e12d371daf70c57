"""Several runs of a kernel, on the interpreter and on every backend: uniforms, tables, out, limits."""

from __future__ import annotations

import re

import numpy as np
import pytest
from backends.running import BACKENDS, TARGETS, flushes_denormals, kernel

import shpy as sh
from shpy import SH_DISCARD, SH_FOR, SH_IF, SH_WHILE
from shpy.testing.arrays import flat_leaves

X = np.array([-3, -1, 0.5, 2, 40], np.float32)
everywhere = pytest.mark.parametrize("backend", BACKENDS)


@everywhere
def test_a_param_is_set_between_runs(backend: str) -> None:
    gain = sh.Param(sh.Attrib2f, (1, 2), name="gain")

    @sh.program
    def scaled(x: sh.Attrib1f) -> sh.Attrib2f:
        return gain * x

    compiled = kernel(scaled, backend)
    np.testing.assert_array_equal(compiled(X), X[:, None] * [1, 2])
    gain.value = (-0.5, 8)
    np.testing.assert_array_equal(compiled(X), X[:, None] * [-0.5, 8])


@everywhere
def test_a_matrix_param_is_set_between_runs(backend: str) -> None:
    turn = sh.Param(sh.Matrix2f, [[0, -1], [1, 0]], name="turn")

    @sh.program
    def turned(p: sh.Vector2f) -> sh.Vector2f:
        return turn @ p

    points = np.array([[1, 2], [3, -4]], np.float32)
    compiled = kernel(turned, backend)
    np.testing.assert_array_equal(compiled(points), points @ [[0, 1], [-1, 0]])
    turn.value = [[2, 0], [0, 3]]
    np.testing.assert_array_equal(compiled(points), points * [2, 3])


@everywhere
def test_a_table_is_updated_between_runs(backend: str) -> None:
    heights = sh.Table([1.0, 2.0, 3.0], sh.Attrib1f)

    @sh.program
    def read(i: sh.Attrib1i) -> sh.Attrib1f:
        return heights[i]

    compiled = kernel(read, backend)
    assert compiled([0, 1, 2, 3]).tolist() == [1, 2, 3, 3]
    heights.update([4.0, 5.0, 6.0])
    assert compiled([0, 1, 2, 3]).tolist() == [4, 5, 6, 6]


@everywhere
def test_a_texture_is_updated_between_runs(backend: str) -> None:
    image = sh.Texture2D(np.zeros((2, 2)), filter="nearest", name="image")

    @sh.program
    def read(uv: sh.TexCoord2f) -> sh.Color1f:
        return image(uv)

    compiled = kernel(read, backend)
    assert compiled([[0.1, 0.1], [0.9, 0.9]]).tolist() == [0, 0]
    image.update(np.array([[1, 2], [3, 4]], np.uint8) * 51)
    np.testing.assert_array_equal(compiled([[0.1, 0.1], [0.9, 0.9]]), np.array([51, 204], np.float32) / 255)


@everywhere
def test_tables_of_other_sizes_take_the_same_kernel(backend: str) -> None:
    @sh.program
    def last(table: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
        return table[table.shape[0] + 5]

    compiled = kernel(last, backend)
    for size in (1, 3, 200):
        assert compiled(np.arange(size, dtype=np.float32), shape=()) == size - 1


def halved() -> sh.Program:
    @sh.program
    def half(x: sh.Attrib1f) -> sh.Attrib1f:
        SH_DISCARD(x < 0)
        return x / 2

    return half


@everywhere
def test_out_may_be_an_input(backend: str) -> None:
    x = X.copy()
    result = kernel(halved(), backend).run(x, out=x)
    assert result.outputs is x
    np.testing.assert_array_equal(x, np.where(X < 0, X, X / 2))
    assert (result.count, result.written.tolist()) == (3, [False, False, True, True, True])


@everywhere
def test_out_may_be_an_input_upside_down(backend: str) -> None:
    x = X.copy()
    kernel(halved(), backend).run(x[::-1], out=x)
    np.testing.assert_array_equal(x, np.where(X[::-1] < 0, X, X[::-1] / 2))


@everywhere
def test_out_need_not_be_contiguous(backend: str) -> None:
    whole = np.full((2, 10), 9, np.float32)
    kernel(halved(), backend).run(X, out=whole[1, ::2])
    np.testing.assert_array_equal(whole[1, ::2], np.where(X < 0, 9, X / 2))
    assert (whole[0] == 9).all()
    assert (whole[1, 1::2] == 9).all()


@everywhere
def test_without_out_discarded_elements_are_zero(backend: str) -> None:
    np.testing.assert_array_equal(kernel(halved(), backend)(X), np.where(X < 0, 0, X / 2))


@everywhere
def test_a_kernel_takes_shape_after_shape(backend: str) -> None:
    compiled = kernel(halved(), backend)
    for shape in ((5,), (), (3, 4), (0, 2), (1,), (2, 1, 7)):
        x = np.full(shape, 4, np.float32)
        result = compiled.run(x)
        assert np.shape(result.outputs) == shape
        assert (np.asarray(result.outputs) == 2).all()
        assert result.count == x.size


@everywhere
def test_a_loop_beyond_its_limit_is_told_with_its_line_and_its_result(backend: str) -> None:
    @sh.program
    def climb(x: sh.Attrib1f):
        n = sh.Attrib1i(0)
        with SH_IF(x > 0):
            with SH_WHILE(lambda: x < 10):
                x += 1
                n += 1
        return n, x

    line = climb.ir.entry.loc.line + 4
    with pytest.raises(
        sh.LoopLimitExceeded, match=re.escape(f"{__file__}:{line}: this loop took more than 8 iterations")
    ) as told:
        kernel(climb, backend, loop_limit=8)(X)
    error = told.value
    assert error.count == 1
    assert error.loc is not None
    assert (error.loc.file, error.loc.line) == (__file__, line)
    assert error.result.written.tolist() == [True, True, False, True, True]
    assert error.result.count == 4
    assert [a.tolist() for a in flat_leaves(error.result.outputs)] == [[0, 0, 0, 8, 0], [-3, -1, 0, 10, 40]]
    n, x = kernel(climb, backend, loop_limit=10)(X)
    assert n.tolist() == [0, 0, 10, 8, 0]
    assert x.tolist() == [-3, -1, 10.5, 10, 40]


@everywhere
def test_elements_that_are_stopped_leave_out_as_it_was(backend: str) -> None:
    @sh.program
    def spin(n: sh.Attrib1i) -> sh.Attrib1i:
        total = sh.Attrib1i(0)
        with SH_FOR(n) as i:
            total += i
        return total

    out = np.full(4, 77, np.int32)
    with pytest.raises(sh.LoopLimitExceeded):
        kernel(spin, backend, loop_limit=5).run([2, 4, 9, 1000], out=out)
    assert out.tolist() == [1, 6, 77, 77]


def test_glsl_refuses_doubles_at_the_line_that_has_them() -> None:
    @sh.program
    def wide(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.Attrib1f(sh.Attrib1d(x) * 2)

    with pytest.raises(sh.CompileError, match=re.escape(f"{__file__}:")) as told:
        wide.compile("glsl")
    assert "numpy" in str(told.value)
    with pytest.raises(sh.CompileError):
        halved().compile("glsl", precision="f64")


@pytest.mark.parametrize("backend", TARGETS)
def test_a_device_that_flushes_denormals_says_so(backend: str) -> None:
    @sh.program
    def scaled(x: sh.Attrib1f, by: sh.Attrib1f) -> sh.Attrib1f:
        return x * by

    denormal = scaled.compile(backend)(np.float32(1e-38), np.float32(0.125))
    assert flushes_denormals(backend) == bool(denormal == 0)
