"""Loops with more exits than a driver nests blocks: Mesa 22.3 told of an end, Mesa 26.0 was wrong in silence."""

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DO, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_UNTIL, SH_WHILE
from shpy.passes.nesting import shelter_loops

MANY = 100


def steps(x: sh.Attrib1i, t: sh.Attrib1i, leave) -> None:
    """Take steps until one is that of x: there the loop is left in the way of `leave`."""
    for k in range(MANY):
        with SH_IF(x == k):
            t[:] = 5 * k
        leave(x == k)
        t[:] = 3 * t + k


def mixed(x: sh.Attrib1i, t: sh.Attrib1i) -> None:
    for k in range(MANY):
        (SH_BREAK if k % 2 else SH_CONTINUE)(x == k)
        t[:] = 3 * t + k


def breaks_of_one_iteration(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t = sh.Attrib1i(x)
    with SH_DO():
        steps(x, t, SH_BREAK)
        SH_UNTIL(True)
    return t


def breaks_before_a_break(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t = sh.Attrib1i(x)
    with SH_WHILE(lambda: t != 7):
        steps(x, t, SH_BREAK)
        SH_BREAK()
    return t


def continues_of_one_iteration(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t = sh.Attrib1i(x)
    with SH_FOR(0, 1):
        steps(x, t, SH_CONTINUE)
    return t


def continues(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t = sh.Attrib1i(x)
    with SH_FOR(0, n):
        steps(x, t, SH_CONTINUE)
    return t


def both_in_an_inner_loop(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t, rounds = sh.Attrib1i(x), sh.Attrib1i(0)
    with SH_WHILE(lambda: rounds < n):
        rounds += 1
        with SH_FOR(0, n) as i:
            mixed(x + i, t)
            t += 1
        t += rounds
    return t


def a_break_of_one_iteration_first(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t = sh.Attrib1i(x)
    with SH_DO():
        for k in range(MANY):
            SH_BREAK(x == k)
            t[:] = 3 * t + k
        SH_BREAK()
    return t + n


def both_before_a_condition_at_the_end(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t, rounds = sh.Attrib1i(x), sh.Attrib1i(0)
    with SH_DO():
        rounds += 1
        mixed(x + rounds, t)
        t ^= rounds
        SH_UNTIL(lambda: rounds >= n)
    return t


def breaks_before_a_value_of_the_body(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t, rounds = sh.Attrib1i(x), sh.Attrib1i(0)
    with SH_DO():
        next_round = rounds + 1
        steps(x + rounds, t, SH_BREAK)
        rounds[:] = next_round
        SH_UNTIL(next_round >= n)
    return t + rounds


def a_choice_of_exits_at_the_end(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t = sh.Attrib1i(x)
    with SH_WHILE(lambda: t != 7):
        steps(x, t, SH_BREAK)
        with SH_IF(t > n):
            SH_BREAK()
        with SH_ELSE():
            t += 1
            SH_BREAK()
    return t


def a_choice_of_returns_at_the_end(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t = sh.Attrib1i(x)
    for k in range(MANY):
        SH_RETURN(7 * k, x == k)
        t[:] = 3 * t + k
    with SH_IF(t > n):
        SH_RETURN(t)
    with SH_ELSE():
        SH_RETURN(t + 1)


@sh.subroutine
def found(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    t = sh.Attrib1i(x)
    with SH_FOR(0, n):
        for k in range(MANY):
            SH_RETURN(7 * k, x == k)
            t[:] = 3 * t + k
    return t


def returns_of_a_subroutine(x: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
    return found(x, n) + found(x + 1, n)


FUNCTIONS = [
    breaks_of_one_iteration,
    breaks_before_a_break,
    continues_of_one_iteration,
    continues,
    both_in_an_inner_loop,
    a_break_of_one_iteration_first,
    both_before_a_condition_at_the_end,
    breaks_before_a_value_of_the_body,
    a_choice_of_exits_at_the_end,
    a_choice_of_returns_at_the_end,
    returns_of_a_subroutine,
]
"""Recorded by the tests that run: each has hundreds of statements."""


@pytest.mark.sampled(12)
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_all_exits_of_a_loop_are_taken(function):
    program = sh.program(function)
    x = np.arange(-3, 120, dtype=np.int32)
    for n in (np.int32(3), (x % 4).astype(np.int32)):
        expected = program.compile("numpy")(x, n)
        assert np.unique(expected).size > 50
        assert program.compile("glsl")(x, n).tobytes() == expected.tobytes()


def test_the_exits_of_a_sheltered_loop_leave_a_loop_of_one_iteration():
    source = sh.program(continues).compile("glsl").source
    assert source.count("while (sh_running) {  // one iteration: so that exits do not nest what follows them") == 1
    assert source.count("continue;") == 0
    assert source.count("if (sh_nothing == 0u) {") == 1


def test_a_loop_with_few_exits_has_no_shelter():
    module = sh.program(continues).ir
    assert shelter_loops(module, 200) == module
    assert shelter_loops(module, 72) != module
