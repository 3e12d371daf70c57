"""Loops that leave nothing but sums: numpy computes several iterations at once, and not a bit changes."""

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR, SH_IF, SH_WHILE

RNG = np.random.default_rng(5)
POINTS = RNG.normal(size=(37, 4)).astype(np.float32)
BODIES = sh.Table(POINTS, sh.Attrib4f, name="bodies")
N = sh.Param(sh.Attrib1i, 17, name="n")
HEIGHTS = sh.Table(RNG.random((6, 9)).astype(np.float32), sh.Attrib1f, name="heights")


def pull(x: sh.Point3f) -> tuple[sh.Vector3f, sh.Attrib1f]:
    total, most = sh.Vector3f(0, 0, 0), sh.Attrib1f(1)
    with SH_FOR(37) as j:
        away = BODIES[j].xyz - x
        near = sh.rsqrt(sh.dot(away, away) + 0.01)
        total += BODIES[j].w * near * away
        most *= 1 + near / 8
    return total, most


def every_other(x: sh.Attrib1f) -> sh.Attrib1f:
    total = sh.Attrib1f(x)
    with SH_FOR(30, 1, -3) as j:
        total += sh.length(BODIES[j].xyz) * x / j
    return total


def in_strides(x: sh.Attrib1i) -> sh.Attrib1i:
    total = sh.Attrib1i(x)
    with SH_FOR(3, 17, 4) as j:
        total += (x + j) * (x ^ j)
    return total


def rows_of_a_table(x: sh.Attrib1i) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_FOR(6) as j:
        total += sh.cond(j > 3, HEIGHTS[j, x], HEIGHTS[x, j] / 3)
    return total


def on_a_grid() -> sh.Attrib1f:
    row, column = sh.grid_index(2)
    total = sh.Attrib1f(0)
    with SH_FOR(7) as j:
        total += sh.sqrt(sh.Attrib1f(row * j)) * column
    return total


def in_a_loop_that_lanes_leave(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_WHILE(lambda: x < 2.0):
        total = sh.Attrib1f(0)
        with SH_FOR(5) as j:
            total += sh.abs(BODIES[j].x * x)
        x += total + 0.25
    return x


TOGETHER = [pull, every_other, in_strides, rows_of_a_table, on_a_grid, in_a_loop_that_lanes_leave]


def given(function):
    kind = function.__annotations__.get("x")
    if kind is None:
        return {"shape": (5, 8)}
    if kind is sh.Attrib1i:
        return {"x": np.arange(40, dtype=np.int32)}
    return {"x": RNG.normal(size=(40, 3) if kind is sh.Point3f else 40).astype(np.float32)}


@pytest.mark.sampled(6)
@pytest.mark.parametrize("function", TOGETHER, ids=lambda f: f.__name__)
def test_the_sums_are_those_of_single_iterations(function):
    program = sh.program(function)
    assert " in iterations_of(" in program.compile("numpy").source
    sh.testing.assert_equivalent(program, **given(function), backends=["numpy", "interpreter", "opencl"])


def test_as_many_iterations_at_once_as_fill_an_array(monkeypatch):
    from shpy.backend.numpy import lanes

    program, x = sh.program(pull), RNG.normal(size=(40, 3)).astype(np.float32)
    found = program.compile("numpy")(x)
    for together in (1, 79, 80, 400, 10**6):
        monkeypatch.setattr(lanes, "TOGETHER", together)
        assert len(list(lanes.iterations_of(np.int32(0), 37, 1, 40))) == -(-37 // max(1, together // 40))
        assert all(map(np.array_equal, program.compile("numpy")(x), found))


def as_many_as_given(x: sh.Attrib1f) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_FOR(N) as j:  # its iterations are limited, and therefore counted
        total += x * j
    return total


def scan(x: sh.Attrib1f) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_FOR(9) as j:
        total += x * total + j
    return total


def masked(x: sh.Attrib1f) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_FOR(9) as j, SH_IF(x > j):
        total += x
    return total


def last(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
    total, seen = sh.Attrib1f(0), sh.Attrib1f(0)
    with SH_FOR(9) as j:
        total += x * j
        seen[:] = x - j
    return total, seen


def constant(x: sh.Attrib1f) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_FOR(9):
        total += x
    return total


@sh.subroutine
def counted(x: sh.Attrib1i) -> sh.Attrib1i:
    counts = sh.Array(sh.Attrib1i, 40)
    counts[x] = 2
    counts[x + 1] += 3
    return counts[2]


def of_arrays_of_a_subroutine(x: sh.Attrib1i) -> sh.Attrib1i:
    total = sh.Attrib1i(0)
    with SH_FOR(20) as j:
        total += counted((x ^ j) % 4)
    return total


@sh.subroutine
def asked(x: sh.Attrib1i) -> sh.Attrib1i:
    return sh.cond(sh.any_lane(x > 58), 1, x)


def of_what_lanes_say_in_a_subroutine(x: sh.Attrib1i) -> sh.Attrib1i:
    total = sh.Attrib1i(0)
    with SH_FOR(20) as j:
        total += asked(x + j)
    return total


ONE_AT_A_TIME = [
    as_many_as_given, scan, masked, last, constant, of_arrays_of_a_subroutine, of_what_lanes_say_in_a_subroutine,
]  # fmt: skip


@pytest.mark.parametrize("function", ONE_AT_A_TIME, ids=lambda f: f.__name__)
def test_loops_that_do_more_than_sum_run_one_iteration_at_a_time(function):
    program = sh.program(function)
    assert " in iterations_of(" not in program.compile("numpy").source
    if function is not of_what_lanes_say_in_a_subroutine:
        sh.testing.assert_equivalent(program, **given(function), backends=["numpy", "interpreter"])


def test_lanes_are_asked_about_one_iteration():
    x = np.arange(40, dtype=np.int32)
    found = sh.program(of_what_lanes_say_in_a_subroutine).compile("numpy")(x)
    expected = sum(np.ones_like(x) if (x + j > 58).any() else x + j for j in range(20))
    assert np.array_equal(found, expected)
