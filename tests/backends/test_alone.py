"""Subroutines that each lane of a packet runs alone: the same bits as where all lanes run them together."""

from typing import NamedTuple

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_ELSE, SH_IF, SH_RETURN, SH_WHILE
from shpy.ir.parser import parse

TABLE = np.random.default_rng(0).random((64, 4)).astype(np.float32)


class Found(NamedTuple):
    place: sh.Attrib3f
    steps: sh.Attrib1i
    odd: sh.Attrib1b


def program(alone=True):
    rows = sh.Table(TABLE, sh.Attrib4f)

    @sh.subroutine(alone=alone)
    def wander(start: sh.Attrib3f, limit: sh.Attrib1f, forward: sh.Attrib1b) -> Found:
        place = sh.Attrib3f(start)
        steps = sh.Attrib1i(0)
        with SH_IF(limit < 0.1):
            SH_RETURN(Found(-place, -1, forward))
        with SH_WHILE(lambda: sh.length(place) < 40 * limit):
            row = rows[steps]
            place += row.xyz * row.w + sh.cond(forward, 0.5, 0.25)
            steps += 1
            with SH_IF(sh.any_lane(place.x > 30)):
                SH_BREAK()
        return Found(place, steps, (steps & 1) == 1)

    @sh.program
    def many(start: sh.Attrib3f, limit: sh.Attrib1f) -> Found:
        place = sh.Attrib3f(1, 2, 3)
        steps = sh.Attrib1i(-7)
        odd = sh.Attrib1b(False)
        with SH_IF(limit > 0.05):
            found = wander(start, limit, start.x > 0.5)
            place[:] = found.place
            steps[:] = found.steps
            with SH_IF(found.odd):
                odd[:] = wander(place.zxy, 0.3, True).odd
        with SH_ELSE():
            place[:] = wander(start, 0.2, False).place
        return Found(place, steps, odd)

    return many


@pytest.mark.slow
@pytest.mark.parametrize("limit", [pytest.param(1000, marks=pytest.mark.slow), None])
def test_every_width_gives_the_same_bits(limit):
    many = program()
    random = np.random.default_rng(1)
    given = random.random((137, 3)).astype(np.float32), random.random(137).astype(np.float32)
    wanted = many.compile("numpy", loop_limit=limit)(*given)
    assert len(np.unique(wanted.steps)) > 5
    assert wanted.odd.any()
    found = [many.compile("glsl", loop_limit=limit)(*given)]
    kernels = [many.compile("opencl", lanes=lanes, loop_limit=limit) for lanes in (1, 4, 16, 32)]
    assert "_alone(" in kernels[2].source
    assert "_alone(" not in kernels[0].source
    kernels.append(program(alone=False).compile("opencl", lanes=8, loop_limit=limit))
    assert "_alone(" not in kernels[-1].source
    for given_back in [*found, *(kernel(*given) for kernel in kernels)]:
        for one, other in zip(wanted, given_back, strict=True):
            np.testing.assert_array_equal(one, other)


def climbs(name):
    """Return a program of which some elements run a loop alone, over a table of this name."""
    rows = sh.Table(TABLE, sh.Attrib4f, name)

    @sh.subroutine(alone=True)
    def climb(start: sh.Attrib3f, limit: sh.Attrib1f, forward: sh.Attrib1b) -> Found:
        place = sh.Attrib3f(start)
        steps = sh.Attrib1i(0)
        with SH_WHILE(lambda: place.x < 9 * limit):
            row = rows[steps & 63]
            place += sh.cond(forward, row.xyz, row.zzz) + 0.125
            steps += 1
            SH_BREAK(place.y > 7)
        return Found(place, steps, forward & ((steps & 1) == 1))

    @sh.program
    def climbing(start: sh.Attrib3f, limit: sh.Attrib1f) -> Found:
        with SH_IF(limit <= 0.4):
            SH_RETURN(Found(sh.Attrib3f(1, 2, 3), -7, False))
        return climb(start, limit, start.z > 0.3)

    return climbing


@pytest.mark.sampled(8)
@pytest.mark.parametrize(
    ("name", "widths"),
    [("rows", (1, 4, 16, 32)), ("k", (4,)), ("n", (16,)), ("lanes", (4,)), ("there", (16,)), ("steps_of", (32,)),
     ("other_k", (4,))],
)  # fmt: skip
def test_two_elements_take_turns_with_the_bits_of_each(name, widths):
    """Whatever the user's names are: the loop over the lanes has names of its own beside them."""
    climbing = climbs(name)
    random = np.random.default_rng(2)
    given = random.random((259, 3)).astype(np.float32), random.random(259).astype(np.float32)
    wanted = climbing.compile("numpy", loop_limit=None)(*given)
    assert len(np.unique(wanted.steps)) > 8
    assert 20 < wanted.odd.sum() < 200
    for lanes in widths:
        kernel = climbing.compile("opencl", lanes=lanes, loop_limit=None)
        assert ("climb_two(" in kernel.source) == (lanes > 1)
        for one, other in zip(wanted, kernel(*given), strict=True):
            np.testing.assert_array_equal(one, other)


def test_what_a_subroutine_changes_comes_back_of_each_of_two_elements():
    """Also where the user's names are those of the pair."""

    @sh.subroutine(alone=True)
    def move(place: sh.Attrib1f, there: sh.Attrib1f, other_there: sh.Attrib1i) -> None:
        with SH_WHILE(lambda: place < there):
            place += 0.5 + place * place
            other_there += 1

    @sh.program
    def moving(x: sh.Attrib1f, far: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1i]:
        place, steps = x.copy(), sh.Attrib1i(0)
        with SH_IF(far > 1):
            move(place, far, steps)
            move(place, far * 2, steps)
        return place, steps

    given = np.linspace(-2, 2, 101, dtype=np.float32), np.linspace(0, 50, 101, dtype=np.float32)
    kernel = moving.compile("opencl", lanes=16, loop_limit=None)
    assert "move_two(" in kernel.source
    for one, other in zip(moving.compile("numpy", loop_limit=None)(*given), kernel(*given), strict=True):
        assert len(np.unique(one)) > 3
        np.testing.assert_array_equal(one, other)


def test_elements_whose_loop_counts_its_iterations_run_one_after_the_other():
    source = climbs("rows").compile("opencl", lanes=16, loop_limit=1000).source
    assert "climb_alone(" in source
    assert "climb_two(" not in source


def test_one_result_and_a_uniform_argument():
    @sh.subroutine(alone=True)
    def root(x: sh.Attrib1f, steps: sh.Attrib1i) -> sh.Attrib1f:
        guess = sh.Attrib1f(1)
        with SH_WHILE(lambda: guess * guess < x * sh.Attrib1f(steps)):
            guess += 0.125
        return guess

    @sh.program
    def roots(x: sh.Attrib1f) -> sh.Attrib1f:
        return root(x, 3)

    x = np.linspace(0, 9, 50, dtype=np.float32)
    np.testing.assert_array_equal(roots.compile("numpy")(x), roots.compile("opencl", lanes=8)(x))


def test_the_text_says_that_a_function_is_run_alone():
    module = program().ir
    assert "alone function wander(" in str(module)
    assert parse(str(module)) == module


def test_arrays_are_refused():
    @sh.subroutine(alone=True)
    def fill(values: sh.Array, at: sh.Attrib1i) -> sh.Attrib1f:
        return values[at]

    def reads(at: sh.Attrib1i) -> sh.Attrib1f:
        values = sh.Array(sh.Attrib1f, 4)
        return fill(values, at)

    with pytest.raises(sh.ShpyError, match="fill is run by each element alone and takes no arrays"):
        sh.program(reads)


def test_the_index_in_a_grid_is_that_of_each_element():
    """The subroutine reads it, calls a function that does, or calls a function that has a form for lines."""

    @sh.subroutine
    def column(x: sh.Attrib1f) -> sh.Attrib1f:
        return x + sh.Attrib1f(sh.grid_index(2).y)

    @sh.subroutine(alone=True)
    def itself(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * sh.Attrib1f(sh.grid_index(2).y)

    @sh.subroutine(alone=True)
    def by_callee(x: sh.Attrib1f) -> sh.Attrib1f:
        return column(x)

    @sh.subroutine(alone=True)
    def power(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
        return sh.pow(x, y)

    @sh.program
    def all_of_them(x: sh.Attrib1f) -> sh.Attrib3f:
        row, _ = sh.grid_index(2)
        return sh.vec3(itself(x), by_callee(x), power(x, sh.Attrib1f(row)))

    x = np.full((3, 20), 2, np.float32)
    expected = np.stack([x * np.arange(20), x + np.arange(20), x ** np.arange(3)[:, None]], -1)
    for lanes in (1, 4, 16):
        assert np.array_equal(all_of_them.compile("opencl", lanes=lanes)(x), expected)
