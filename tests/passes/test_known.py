"""`Ranges`: between which numbers an int lies."""

from __future__ import annotations

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR, SH_IF, SH_WHILE
from shpy.ir.nodes import Let
from shpy.ir.traverse import walk
from shpy.passes.known import Ranges
from shpy.passes.pipeline import optimise

ROWS = sh.Table(np.arange(40, dtype=np.float32), sh.Attrib1f, "rows")
ANY_INT = (-(2**31), 2**31 - 1)


def index_of(function):
    """Return the range of the index of the only read of ROWS."""
    entry = optimise(sh.program(function).ir).entry
    (read,) = [s for s in walk(entry.body) if isinstance(s, Let) and s.op == "table"]
    return Ranges(entry).span(read.args[0])


def test_what_is_computed_of_bounded_ints_is_bounded():
    def f(i: sh.Attrib1i, u: sh.Attrib1u, c: sh.Attrib1b) -> sh.Attrib1f:
        return ROWS[3 * sh.clamp(i, -2, 9) + sh.Attrib1i(u & 7) - sh.cond(c, 1, sh.min(sh.max(i, 4), 5))]

    assert index_of(f) == (-6 - 5, 27 + 7 - 1)


def test_what_is_shifted_right_by_a_bounded_number_is_bounded():
    def f(i: sh.Attrib1i, u: sh.Attrib1u) -> sh.Attrib1f:
        return ROWS[(sh.clamp(i, -9, 9) >> sh.clamp(i, 1, 2)) + sh.Attrib1i(u >> 28)]

    assert index_of(f) == (-5, 4 + 15)


@pytest.mark.parametrize(("least", "most"), [(-1, 4), (3, 32)])
def test_a_shift_that_may_begin_anew_gives_anything(least, most):
    def f(i: sh.Attrib1i) -> sh.Attrib1f:
        return ROWS[sh.clamp(i, -9, 9) >> sh.clamp(i, least, most)]

    assert index_of(f) == ANY_INT


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


@pytest.mark.parametrize(
    ("product", "most", "wraps"),
    [(False, 2**31 - 6, False), (False, 2**31 - 5, True), (True, (2**31 - 1) // 5, False), (True, 2**29, True)],
)
def test_a_sum_or_product_wraps_only_beyond_the_range_of_its_type(product, most, wraps):
    def f(i: sh.Attrib1i) -> sh.Attrib1i:
        a, b = sh.clamp(i, 0, most), sh.clamp(i, -1, 5)
        return a * b if product else a + b

    entry = optimise(sh.program(f).ir).entry
    (made,) = [s for s in walk(entry.body) if isinstance(s, Let) and s.op in ("add", "mul")]
    assert Ranges(entry).may_wrap(made) == wraps


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


def test_opencl_leaves_out_what_cannot_come_up():
    @sh.program
    def f(i: sh.Attrib1i) -> sh.Attrib1f:
        return ROWS[sh.clamp(i, 0, 30) + 9] + ROWS[sh.clamp(i, 0, 31) + 9] + ROWS[i]

    kernel = f.compile("opencl", lanes=1)
    assert "rows[min(t, 30) + 9] + rows[sh_at(min(t, 31) + 9, rows_size)]" in kernel.source
    i = np.array([-5, 3, 30, 99], np.int32)
    np.testing.assert_array_equal(kernel(i), f.compile("numpy")(i))


def test_long_chains_are_given_up():
    def f(i: sh.Attrib1i) -> sh.Attrib1f:
        at = sh.Attrib1i(sh.clamp(i, 0, 1))
        for _ in range(3000):
            at = at + sh.clamp(i, 0, 1)
        return ROWS[at]

    assert index_of(f) == ANY_INT
