"""Blocks and Python's exceptions and generators: what is recorded where no block is left open or dropped."""

import numpy as np
import pytest

import shpy as sh
from shpy import SH_ELSE, SH_FOR, SH_IF


def both(condition):
    with SH_IF(condition):
        yield 1
    with SH_ELSE():
        yield -1


def test_a_generator_that_is_run_to_its_end_holds_blocks():
    @sh.program
    def apart(x: sh.Attrib1f) -> sh.Attrib1f:
        for step in both(x > 0):
            x += step
        return x

    np.testing.assert_array_equal(apart([1, -1]), [2, -2])


def test_an_exception_that_is_caught_inside_its_block_drops_nothing():
    @sh.program
    def caught(x: sh.Attrib1f) -> sh.Attrib1f:
        with SH_FOR(2), SH_IF(x > 0):
            try:
                x += 1
                raise ValueError
            except ValueError:
                x *= 2
        return x

    np.testing.assert_array_equal(caught([1, -1]), [10, -1])


def test_a_block_whose_condition_is_refused_was_never_there():
    @sh.program
    def tried(x: sh.Attrib1f) -> sh.Attrib1f:
        try:
            with SH_IF(x):
                x += 1
        except sh.ShpyTypeError:
            with SH_IF(x != 0):
                x += 2
        return x

    np.testing.assert_array_equal(tried([1, 0]), [3, 0])


def test_an_exception_that_leaves_a_subroutine_leaves_no_call():
    @sh.subroutine
    def fails(x: sh.Attrib1f):
        with SH_IF(x > 0):
            x += 1
            raise ValueError

    @sh.program
    def goes_on(x: sh.Attrib1f) -> sh.Attrib1f:
        try:
            fails(x)
        except ValueError:
            x += 5
        return x

    np.testing.assert_array_equal(goes_on([1, -1]), [6, 4])


def test_two_generators_that_end_in_the_wrong_order_are_refused():
    def positive(x):
        with SH_IF(x > 0):
            yield

    def crossed(x: sh.Attrib1f) -> sh.Attrib1f:
        first, second = positive(x), positive(x + 1)
        next(first)
        next(second)
        x += 1
        next(first, None)
        next(second, None)
        return x

    with pytest.raises(sh.RecordError, match="ends before a block that was opened inside it"):
        sh.program(crossed)
