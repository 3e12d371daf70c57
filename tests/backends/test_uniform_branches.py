"""Branches whose condition is one for all elements: both sides do, on every target, what they would do for each."""

import operator

import numpy as np
import pytest
from test_uniforms import assert_same, everywhere

import shpy as sh


@pytest.mark.sampled(12)
@everywhere
@pytest.mark.parametrize("compare", [operator.lt, operator.le, operator.gt, operator.ge])
def test_a_comparison_with_nan_is_false_and_its_opposite_true(options, compare):
    low, high = sh.Param(sh.Attrib1f, float("nan"), name="low"), sh.Param(sh.Attrib1f, 2.5, name="high")

    @sh.program
    def chosen(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        with sh.SH_IF(compare(low, high)):
            pass
        with sh.SH_ELSE():
            y[:] = 3 * x
        return y

    assert chosen.compile(**options)(np.ones(3)).tolist() == [3, 3, 3]


@pytest.mark.sampled(4)
@everywhere
def test_lanes_that_return_one_value_for_all_keep_it_where_the_other_side_returns_by_lane(options):
    always, often = sh.Param(sh.Attrib1b, True, name="always"), sh.Param(sh.Attrib1i, 3, name="often")

    @sh.program
    def chosen(x: sh.Attrib1f, n: sh.Attrib1i):
        found = sh.Attrib3f(3, -1, 0)
        with sh.SH_IF(often > 0):
            sh.SH_RETURN((x, found), x > 1)
            found.xy = 5, 5
        with sh.SH_ELIF(n > 0):
            k = sh.Attrib1i(0)
            with sh.SH_WHILE(lambda: k < n):
                k += 1
                with sh.SH_FOR(often, n & 7):
                    sh.SH_RETURN((2 * x, found), always)
        return x, found

    kernel = chosen.compile(**options)
    x, n = np.linspace(0, 2, 19), np.arange(19, dtype=np.int32) % 8
    _, found = kernel(x, n)
    assert found.tolist() == [[3, -1, 0] if here > 1 else [5, 5, 0] for here in x]
    often.value = 0
    doubled, found = kernel(x, n)
    assert_same(doubled, np.where(n > 0, 2 * x, x).astype(doubled.dtype))
    assert (found == [3, -1, 0]).all()


@pytest.mark.sampled(4)
@everywhere
@pytest.mark.parametrize("most", [0, 1, 3])
def test_a_value_that_varies_at_the_last_of_the_exits_for_all_is_found_behind_each(options, most):
    first, last = sh.Param(sh.Attrib1i, most, name="first"), sh.Param(sh.Attrib1i, 2, name="last")

    @sh.program
    def chosen(x: sh.Attrib1f) -> sh.Attrib1f:
        k, y = sh.Attrib1i(0), sh.Attrib1f(0)
        with sh.SH_DO():
            y[:] = 7
            sh.SH_BREAK(k >= first)
            y[:] = x
            k += 1
            sh.SH_UNTIL(k >= last)
        return y

    @sh.program
    def returned(x: sh.Attrib1f) -> sh.Attrib1f:
        sh.SH_RETURN(sh.Attrib1f(7), first < 2)
        return x

    x = np.linspace(-1, 1, 17)
    for program in (chosen, returned):
        assert (program.compile(**options)(x) == (7 if most < 2 else x)).all()
