"""Every spelling of a loop is driven to its limit, and to the one that the device has: no iteration is lost.

The language has few loops, a printer more: which one it writes depends on where the test stands, on what is stored at
the end of an iteration, and on `continue`. `SPELLINGS` are programs that together have every spelling of every printer,
which the last test proves from the texts.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from loop_stops import stops_loops

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DO, SH_ELSE, SH_FOR, SH_IF, SH_UNTIL, SH_WHILE
from shpy.passes.exits import DEVICE_TURNS

I1 = sh.Attrib1i
Body = Callable[[Any, Any], None]
"""Loop until the second number is reached, and count in the first."""

N = sh.Param(I1, 0, name="bound")


def for_of_input(c: I1, n: I1) -> None:
    with SH_FOR(0, n):
        c += 1


def for_of_param(c: I1, n: I1) -> None:
    with SH_FOR(0, N):
        c += 1


def for_with_continue(c: I1, n: I1) -> None:
    with SH_FOR(0, n) as i:
        c += 1
        with SH_IF(i % 2 == 0):
            SH_CONTINUE()
        c += 0 * i


def for_downwards_with_break(c: I1, n: I1) -> None:
    with SH_FOR(n, 0, -1):
        c += 1
        SH_BREAK(c > 1 << 30)


def for_with_a_step(c: I1, n: I1) -> None:
    with SH_FOR(0, n * 3, sh.Attrib1i(n // n * 3)):
        c += 1


def while_first(c: I1, n: I1) -> None:
    with SH_WHILE(lambda: c < n):
        c += 1


def while_with_continue(c: I1, n: I1) -> None:
    with SH_WHILE(lambda: c < n):
        c += 1
        SH_CONTINUE(c % 3 == 1)
        SH_BREAK(c > 1 << 30)


def while_with_statements_in_its_test(c: I1, n: I1) -> None:
    seen = I1(0)

    def more() -> Any:
        seen[:] = seen + 1
        return seen <= n

    with SH_WHILE(more):
        c += 1
        SH_CONTINUE(c % 3 == 1)
        SH_BREAK(c > 1 << 30)


def do_last(c: I1, n: I1) -> None:
    with SH_DO():
        c += 1
        SH_UNTIL(c >= n)


def do_with_continue(c: I1, n: I1) -> None:
    with SH_DO():
        c += 1
        SH_CONTINUE(c % 3 == 1)
        SH_BREAK(c > 1 << 30)
        SH_UNTIL(lambda: c >= n)


def do_with_a_test_of_its_own(c: I1, n: I1) -> None:
    with SH_DO():
        more = I1(n - c - 1)
        c += 1
        SH_UNTIL(more <= 0)


def do_with_stores_before_its_test(c: I1, n: I1) -> None:
    left = I1(n)
    with SH_DO():
        c += 1
        with SH_IF(c % 3 == 1):
            SH_CONTINUE()
        SH_BREAK(c > 1 << 30)

        def last() -> Any:
            left[:] = left - 1
            return left <= 0

        SH_UNTIL(last)


SPELLINGS: list[Body] = [
    for_of_input, for_of_param, for_with_continue, for_downwards_with_break, for_with_a_step, while_first,
    while_with_continue, while_with_statements_in_its_test, do_last, do_with_continue, do_with_a_test_of_its_own,
    do_with_stores_before_its_test,
]  # fmt: skip
names = pytest.mark.parametrize("spelling", SPELLINGS, ids=lambda s: s.__name__)


def alone(spelling: Body) -> sh.Program:
    @sh.program
    def looping(n: sh.Attrib1i) -> sh.Attrib1i:
        c = I1(0)
        spelling(c, n)
        return c

    return looping


def in_subroutine(spelling: Body) -> sh.Program:
    @sh.subroutine
    def inner(n: sh.Attrib1i) -> sh.Attrib1i:
        c = I1(0)
        spelling(c, n)
        return c

    @sh.program
    def looping(n: sh.Attrib1i) -> sh.Attrib1i:
        return inner(n)

    return looping


def nested(spelling: Body) -> sh.Program:
    """The loop runs 100 times: each is short, and their sum is long."""

    @sh.program
    def looping(n: sh.Attrib1i) -> sh.Attrib1i:
        total = I1(0)
        with SH_FOR(0, 100) as i:
            SH_CONTINUE(i < 0)
            c = I1(0)
            spelling(c, n // 100)
            total += c
        return total

    return looping


def beside(spelling: Body) -> sh.Program:
    """Lanes that diverge take the iterations of both branches."""

    @sh.program
    def looping(n: sh.Attrib1i) -> sh.Attrib1i:
        c = I1(0)
        with SH_IF(n % 200 == 0):
            spelling(c, n)
        with SH_ELSE():
            spelling(c, n)
        return c

    return looping


def known(spelling: Body, n: int) -> Body:
    """The spelling, whose bound is a constant of the program."""
    return lambda c, _: spelling(c, n)


def right_or_told(program: sh.Program, n: np.ndarray, limit: int | None, *, stops: bool) -> None:
    """Run on GLSL over an array and a stream: all is right, or LoopLimitExceeded is raised where the device stops."""
    kernel = program.compile("glsl", loop_limit=limit)
    stream = sh.Stream(n, sh.Attrib1i, backend="glsl")
    if not (stops and stops_loops()):
        assert kernel(n).tolist() == n.tolist()
        assert kernel(stream).numpy().tolist() == n.tolist()
        return
    with pytest.raises(sh.LoopLimitExceeded, match="the device stopped") as error:
        kernel(stream)
    assert error.value.loc is not None
    with pytest.raises(sh.LoopLimitExceeded, match="the device stopped") as error:
        kernel(n)
    result = error.value.result
    assert error.value.count == np.count_nonzero(~result.written) > 0
    assert np.array_equal(result.outputs[result.written], n[result.written])


@pytest.mark.sampled(20)
@names
@pytest.mark.parametrize("around", [alone, in_subroutine, nested, beside], ids=lambda a: a.__name__)
@pytest.mark.parametrize("limit", [None, 1 << 20])
def test_where_the_device_stops_a_loop_it_is_told(spelling: Body, around: Any, limit: int | None) -> None:
    program = around(spelling)
    few, many = np.full(5, 30_000, np.int32), np.full(5, 70_000, np.int32)
    for n, stops in ((few, False), (many, True)):
        N.value = int(n[0]) // (100 if around is nested else 1)
        right_or_told(program, n, limit, stops=stops)


@pytest.mark.sampled(4)
@names
def test_where_the_device_stops_a_loop_of_known_length_it_is_told(spelling: Body) -> None:
    for n in (60_000, 66_000, 200_000):
        N.value = n
        right_or_told(alone(known(spelling, n)), np.full(3, n, np.int32), None, stops=n > DEVICE_TURNS)


def test_branches_that_lanes_take_apart_share_the_iterations_of_the_device() -> None:
    n = np.array([40_000, 40_001] * 4, np.int32)

    @sh.program
    def apart(n: sh.Attrib1i) -> sh.Attrib1i:
        c = I1(n % 2)
        with SH_IF(n % 2 == 0):
            with SH_FOR(0, 40_000) as i:
                c += (i + n) % 2 + (i + n + 1) % 2
        with SH_ELSE():
            with SH_FOR(0, 40_000) as i:
                c += (i + n) % 2 + (i + n + 1) % 2
        return c

    right_or_told(apart, n, None, stops=True)


def test_the_iteration_in_which_an_inner_loop_ends_counts() -> None:
    """1,580 * (1 + 40) iterations are fewer than 65,535, and 1,580 * (1 + 41) are not."""

    @sh.program
    def within(n: sh.Attrib1i) -> sh.Attrib1i:
        c = I1(n % 2)
        with SH_FOR(0, 1580) as i:
            with SH_FOR(0, 40) as j:
                c += (i + j + n) % 2 + (i + j + n + 1) % 2
        return c

    right_or_told(within, np.full(5, 1580 * 40, np.int32), None, stops=True)


def test_arrays_of_a_subroutine_count() -> None:
    """Each call sets its array to zero by a loop, and after 65,535 iterations every later loop is stopped."""

    @sh.subroutine
    def counted(x: sh.Attrib1i) -> sh.Attrib1i:
        counts = sh.Array(I1, 400)
        counts[x] = 1
        return counts[x]

    @sh.program
    def summed(n: sh.Attrib1i) -> sh.Attrib1i:
        total = I1(0)
        with SH_FOR(0, 1000) as i:
            total += counted(n % 7 + i % 5)
        with SH_FOR(0, 1000):
            total += n // 2000
        return total

    right_or_told(summed, np.full(5, 2000, np.int32), None, stops=True)


def every() -> sh.Program:
    """Element by element another loop, for targets whose compilers take long."""

    @sh.program
    def looping(which: sh.Attrib1i, n: sh.Attrib1i) -> sh.Attrib1i:
        c = I1(0)
        for k, spelling in enumerate(SPELLINGS):
            with SH_IF(which == k):
                spelling(c, n)
        return c

    return looping


TARGETS = [("numpy", {}), *(("opencl", {"lanes": n}) for n in (1, 8)), ("glsl", {})]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("backend", "options"), TARGETS, ids=["numpy", "opencl-1", "opencl-8", "glsl"])
def test_each_spelling_takes_its_limit_and_no_iteration_more(backend: str, options: dict[str, Any]) -> None:
    which, n = (a.ravel().astype(np.int32) for a in np.meshgrid(np.arange(len(SPELLINGS)), [1, 2, 49, 50, 51, 90]))
    N.value = 51
    kernel = every().compile(backend, loop_limit=50, **options)
    with pytest.raises(sh.LoopLimitExceeded, match="took more than 50 iterations") as error:
        kernel(which, n)
    result = error.value.result
    taken = np.where(which == SPELLINGS.index(for_of_param), 51, n)
    assert result.written.tolist() == (taken <= 50).tolist()
    assert np.array_equal(result.outputs[result.written], n[result.written])
    assert error.value.count == np.count_nonzero(taken > 50)


C_SPELLINGS = {
    "for with a test": r"for \([^;]*; [^;]+; [^)]+\) \{",
    "for without": r"for \([^;]*;; [^)]+\) \{",
    "while with a test": r"while \((?!true|sh_running)[^;]+\) \{",
    "while without": r"while \((true|sh_running)\) \{",
    "do": r"\} while \(.*\);",
    "do with a test of its own": r"if \([^)]*\) \{[^\n]*\n +break;\n",
    "step at the top": r"again = true;",
}


LACKING = {"glsl": {"while with a test", "do"}, "opencl": {"for without"}}
"""A loop of unknown length tells on GLSL that it finishes before it is left; without that its test is in the head."""


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_the_list_has_every_spelling(backend: str) -> None:
    options = {"lanes": 1} if backend == "opencl" else {}
    programs = [(alone(s), limit) for s in SPELLINGS for limit in (None, 50)] + [(alone(known(for_of_input, 20)), None)]
    texts = "\n".join(p.compile(backend, loop_limit=limit, **options).source for p, limit in programs)
    missing = {name for name, pattern in C_SPELLINGS.items() if not re.search(pattern, texts)}
    assert missing == LACKING[backend]


def test_a_loop_of_known_and_small_length_has_no_flag() -> None:
    N.value = 0
    for spelling in (for_with_continue, for_of_input, for_downwards_with_break):
        source = alone(known(spelling, 30_000)).compile("glsl").source
        assert not re.search("ended|sh_running|status", source)
