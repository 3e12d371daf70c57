"""Exits of loops that compare what the loop has stepped with a constant, in every spelling and on every backend.

Mesa 22.3 counts the iterations of such loops from the first value, and leaves at once where that fulfils the
comparison. A driver of which the probe finds so does not know the first value (`_hide_first_values` of
shpy/backend/emit/structure.py).
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from backends.running import TARGETS

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DISCARD, SH_DO, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_UNTIL, SH_WHILE

COMPARED = (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne)
Compared = tuple[Any, Any, Callable[[Any, Any], Any], int]
"""A first value, a step, and the comparison with a number."""

ROUNDS = 5
A = np.float32([0, 1, 2])
"""0: the loop is not entered."""


def while_return(left: Callable[[Any], Any], v: Any, a: Any, step: Any) -> Any:
    @sh.subroutine
    def inside(v, a):
        n = sh.Attrib1i(0)
        with SH_WHILE(lambda: (n < ROUNDS) & (a > 0)):
            n += 1
            v += step
            SH_RETURN(n * 10, left(v))
        a += 1
        return n

    return inside(v, a)


def while_called(left: Callable[[Any], Any], v: Any, a: Any, step: Any) -> Any:
    @sh.subroutine
    def stepped(v):
        v += step
        return left(v)

    n = sh.Attrib1i(0)
    with SH_WHILE(lambda: (n < ROUNDS) & (a > 0)):
        n += 1
        SH_BREAK(stepped(v))
    return n


def do_until(left: Callable[[Any], Any], v: Any, a: Any, step: Any) -> Any:
    n = sh.Attrib1i(0)
    with SH_DO():
        n += 1
        v += step
        SH_BREAK(n >= ROUNDS)
        SH_UNTIL(left(v))
    return n


def for_break(left: Callable[[Any], Any], v: Any, a: Any, step: Any) -> Any:
    n = sh.Attrib1i(0)
    with SH_FOR(ROUNDS):
        n += 1
        v += step
        SH_BREAK(left(v))
    return n


def for_in_for(left: Callable[[Any], Any], v: Any, a: Any, step: Any) -> Any:
    n = sh.Attrib1i(0)
    with SH_FOR(2):
        with SH_FOR(ROUNDS):
            SH_CONTINUE(a < 0)
            v += step
            n += 1
            with SH_IF(left(v)):
                n += 100
                SH_BREAK()
        n += 1000
    return n


def continue_return(left: Callable[[Any], Any], v: Any, a: Any, step: Any) -> Any:
    @sh.subroutine
    def inside(v, a):
        n = sh.Attrib1i(0)
        with SH_WHILE(lambda: (n < ROUNDS) & (a > 0)):
            n += 1
            v += step
            SH_CONTINUE(left(v))
            SH_RETURN(n * 10)
        a += 1
        return n

    return inside(v, a)


def continue_break(left: Callable[[Any], Any], v: Any, a: Any, step: Any) -> Any:
    n = sh.Attrib1i(0)
    with SH_FOR(ROUNDS):
        n += 1
        v += step
        with SH_IF(a > 1):
            SH_CONTINUE(left(v))
            n += 100
        SH_BREAK(a > 0)
    return n


def else_break(left: Callable[[Any], Any], v: Any, a: Any, step: Any) -> Any:
    n = sh.Attrib1i(0)
    with SH_WHILE(lambda: (n < ROUNDS) & (a > 0)):
        v += step
        with SH_IF(left(v)):
            n += 1
        with SH_ELSE():
            n += 10
            SH_BREAK()
    return n


def breaking(condition: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Return a loop that is left by a condition on whether `left` holds, and on the input."""

    def loop(left: Callable[[Any], Any], v: Any, a: Any, step: Any) -> Any:
        n = sh.Attrib1i(0)
        with SH_WHILE(lambda: (n < ROUNDS) & (a > 0)):
            n += 1
            v += step
            SH_BREAK(condition(left(v), a))
        return n

    return loop


BREAKING = {
    "while_break": breaking(lambda holds, a: holds),
    "negated_break": breaking(lambda holds, a: ~(holds & (a < 2))),
    "equal_break": breaking(lambda holds, a: holds == (a > 1)),
    "chosen_break": breaking(lambda holds, a: sh.cond(holds, a > 5, a < 5)),
}


def program(spelling: Any, kind: Any, compared: list[Compared]) -> sh.Program:
    """Each comparison with its number in one program."""

    @sh.program
    def looping(a: sh.Attrib1f):
        found = []
        for first, step, compare, limit in compared:
            v, p = kind(first), a + 0
            made = spelling(lambda v, c=compare, k=limit: c(v.x if kind is sh.Attrib2i else v, kind(k).x), v, p, step)
            found.append(sh.Attrib4f(made, v.x, p, 0))
        return found

    return looping


SPELLINGS = (
    while_return,
    while_called,
    do_until,
    for_break,
    for_in_for,
    continue_return,
    continue_break,
    else_break,
)
CASES = [(s, sh.Attrib1i, "strict") for s in SPELLINGS]
CASES += [pytest.param(loop, sh.Attrib1i, "strict", id=name) for name, loop in BREAKING.items()]
CASES += [(while_return, kind, "strict") for kind in (sh.Attrib1u, sh.Attrib1f, sh.Attrib2i)]
CASES += [(BREAKING["while_break"], kind, "fast") for kind in (sh.Attrib1i, sh.Attrib1f)]


@pytest.mark.slow
@pytest.mark.parametrize(("spelling", "kind", "math"), CASES)
def test_an_exit_that_follows_the_step_holds_when_it_should(spelling: Any, kind: Any, math: Any) -> None:
    """Every comparison with each number; with one of them on OpenCL, whose compiler takes a second for all."""
    steps, limits = (((0, 1), (1, 2)), (1, 2, 3)) if kind is sh.Attrib1u else (((0, 1), (1, -1)), (-1, 0, 1, 2))
    for_opencl: list[tuple[Compared, Any]] = []
    for n, (first, step) in enumerate(steps):
        every = [(first, step, *one) for one in itertools.product(COMPARED, limits)]
        made = program(spelling, kind, every)
        wanted = np.stack(made.compile("numpy", math="strict")(A))
        for backend in ("numpy", "glsl"):
            found = np.stack(made.compile(backend, math=math)(A))
            assert np.array_equal(found, wanted), (backend, first, step)
        chosen = (k * len(limits) + (n + k) % len(limits) for k in range(len(COMPARED)))
        for_opencl += [(every[k], wanted[k]) for k in chosen]
    made = program(spelling, kind, [compared for compared, _ in for_opencl])
    for found, (compared, wanted) in zip(made.compile("opencl", math=math)(A), for_opencl, strict=True):
        assert np.array_equal(found, wanted), compared


@pytest.mark.parametrize("backend", TARGETS)
def test_an_exit_may_compare_an_element_of_an_array_that_the_loop_stores_into(backend: str) -> None:
    @sh.program
    def filling(a: sh.Attrib1f):
        held, n = sh.Array(sh.Attrib1u, 4), sh.Attrib1i(0)
        with SH_WHILE(lambda: n < ROUNDS):
            held[n & 3] = sh.Attrib1u(n + 1)
            n += 1
            SH_BREAK(held[0] + held[n & 3] > sh.Attrib1u(a))
        return n

    assert filling.compile(backend)(A).tolist() == filling.compile("numpy")(A).tolist() == [1, 4, 5]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("compare", COMPARED)
def test_a_discard_that_follows_the_step_holds_when_it_should(compare: Callable[[Any, Any], Any]) -> None:
    @sh.program
    def looping(a: sh.Attrib1f):
        n = sh.Attrib1i(0)
        with SH_WHILE(lambda: (n < ROUNDS) & (a > 1)):
            n += 1
            SH_DISCARD(compare(n, 1))
        return n

    wanted = looping.compile("numpy").run(A)
    for backend in TARGETS:
        found = looping.compile(backend).run(A)
        assert np.array_equal(found.written, wanted.written), backend
        assert np.array_equal(found.outputs[wanted.written], wanted.outputs[wanted.written]), backend
