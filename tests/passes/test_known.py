"""`Known`: between which numbers an int lies, and which floats are never NaN."""

from __future__ import annotations

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR, SH_IF, SH_WHILE
from shpy.ir.nodes import Let
from shpy.ir.traverse import walk
from shpy.passes.known import Known
from shpy.passes.pipeline import optimise

ROWS = sh.Table(np.arange(40, dtype=np.float32), sh.Attrib1f, "rows")
ANY_INT = (-(2**31), 2**31 - 1)


def index_of(function):
    """What is known of the index of the only read of ROWS."""
    entry = optimise(sh.program(function).ir).entry
    (read,) = [s for s in walk(entry.body) if isinstance(s, Let) and s.op == "table"]
    return Known(entry).span(read.args[0])


def test_what_is_computed_of_bounded_ints_is_bounded():
    def f(i: sh.Attrib1i, u: sh.Attrib1u, c: sh.Attrib1b) -> sh.Attrib1f:
        return ROWS[3 * sh.clamp(i, -2, 9) + sh.Attrib1i(u & 7) - sh.cond(c, 1, sh.min(sh.max(i, 4), 5))]

    assert index_of(f) == (-6 - 5, 27 + 7 - 1)


def test_a_variable_holds_what_is_stored_and_the_zero_before():
    def f(i: sh.Attrib1i, x: sh.Attrib1f) -> sh.Attrib1f:
        at = sh.Attrib1i(3)
        with SH_WHILE(lambda: x > at):
            with SH_IF(x < 0):
                at[:] = sh.clamp(i, 5, 30)
            at[:] = sh.min(at + 1, 20) & 63
        return ROWS[at]

    assert index_of(f) == (0, 63)


def test_what_counts_on_and_on_may_be_anything():
    def f(n: sh.Attrib1i) -> sh.Attrib1f:
        total = sh.Attrib1f(0)
        with SH_FOR(0, n) as i:
            total += ROWS[i]
        return total

    assert index_of(f) == ANY_INT


@pytest.mark.parametrize("factor", [2**16, -(2**16), 2**15])
def test_what_may_wrap_may_be_anything(factor):
    def f(i: sh.Attrib1i) -> sh.Attrib1f:
        return ROWS[sh.clamp(i, 0, 2**16) * factor]

    assert index_of(f) == ANY_INT


def test_an_array_holds_what_is_stored_anywhere_in_it():
    def f(i: sh.Attrib1i, j: sh.Attrib1i) -> sh.Attrib1f:
        held = sh.Array(sh.Attrib1i, 4)
        held[j] = sh.clamp(i, 2, 7)
        return ROWS[held[i]]

    assert index_of(f) == (0, 7)


def test_what_is_handed_on_by_reference_may_be_anything():
    @sh.subroutine
    def move(at: sh.Attrib1i, by: sh.Attrib1i) -> None:
        with SH_WHILE(lambda: at < 30):
            at[:] += by

    def f(i: sh.Attrib1i) -> sh.Attrib1f:
        at = sh.Attrib1i(3)
        move(at, i)
        return ROWS[at]

    assert index_of(f) == ANY_INT


def bits_of(function):
    """Whether the operand of the only `bits_from_float` is known not to be NaN."""
    entry = optimise(sh.program(function).ir).entry
    (taken,) = [s for s in walk(entry.body) if isinstance(s, Let) and s.op == "bits_from_float"]
    return Known(entry).never_nan(taken.args[0])


def least(x, y):
    return sh.cond(y < x, y, x)


@pytest.mark.parametrize(
    ("made", "known"),
    [
        (lambda x, y: least(1.0, x), True),
        (lambda x, y: least(least(1.0, x), y), True),
        (lambda x, y: least(x, 1.0), False),
        (lambda x, y: sh.cond((x == 3.0) & (y > 0.0), x, 1.0), True),
        (lambda x, y: sh.cond((x == 3.0) | (y > 0.0), x, 1.0), False),
        (lambda x, y: sh.cond(x != 3.0, x, 1.0), False),
        (lambda x, y: sh.cond(x > 3.0, y, 1.0), False),
        (lambda x, y: least(1.0, x) + y, False),
        (lambda x, y: least(np.float32(np.nan), x), False),
    ],
)
def test_a_float_that_is_less_than_something_is_not_nan(made, known):
    def f(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1u:
        return sh.bits_from_float(made(sh.Attrib1f(x), sh.Attrib1f(y)))

    assert bits_of(f) is known


def test_vectors_too():
    def f(v: sh.Attrib4f, x: sh.Attrib1f) -> sh.Attrib4u:
        return sh.bits_from_float(least(sh.Attrib4f(least(2.0, x)), v))

    assert bits_of(f)


def test_opencl_leaves_out_what_cannot_come_up():
    @sh.program
    def f(i: sh.Attrib1i, x: sh.Attrib1f) -> sh.Attrib1f:
        return ROWS[sh.clamp(i, 0, 30) + 9] + ROWS[i] + sh.Attrib1f(sh.bits_from_float(least(2.0, x)))

    kernel = f.compile("opencl", lanes=1)
    assert "rows[min(max(i, 0), 30) + 9u] + rows[sh_at(i, rows_size)]" in kernel.source
    assert "sh_bits" not in kernel.source
    i, x = np.array([-5, 3, 99], np.int32), np.array([1, np.nan, 5], np.float32)
    np.testing.assert_array_equal(kernel(i, x), f.compile("numpy")(i, x))


def test_long_chains_are_given_up():
    def f(i: sh.Attrib1i) -> sh.Attrib1f:
        at = sh.Attrib1i(sh.clamp(i, 0, 1))
        for _ in range(3000):
            at = at + sh.clamp(i, 0, 1)
        return ROWS[at]

    assert index_of(f) == ANY_INT
