"""Distances in units in the last place, by hand."""

import mpmath as mp
import numpy as np
import pytest

import shpy as sh
from shpy.units import Budget, relative, steps, ulps

ONE = np.float32(1)
UP, DOWN = np.nextafter(ONE, np.float32(2)), np.nextafter(ONE, np.float32(0))
TINY, LEAST, LARGEST = np.float32(2**-126), np.float32(2**-149), np.finfo(np.float32).max


@pytest.mark.parametrize(
    ("found", "exact", "expected"),
    [
        (ONE, 1.0, 0),
        (UP, 1.0, 1),
        (DOWN, 1.0, 0.5),
        (ONE, 1 + 2**-24, 0.5),
        (ONE, -1.0, 2**24),
        (np.float32(0), 2.0**-149, 1),
        (TINY, 2.0**-126 + 2.0**-149, 1),
        (np.float32(np.inf), 1e39, 0),
        (LARGEST, 1e39, (1e39 - float(LARGEST)) / 2.0**104),
        (np.float32(np.inf), 1.0, np.inf),
        (np.float32(np.nan), np.nan, 0),
        (np.float32(np.nan), 1.0, np.inf),
        (ONE, np.nan, np.inf),
        (np.float32(np.inf), -np.inf, np.inf),
        (np.float16(1.001), 1.0, 1),
    ],
)
def test_distance_from_the_exact_number(found, exact, expected):
    assert sh.accuracy.ulp(np.asarray(found), np.float64(exact)) == pytest.approx(expected)


def test_what_binary64_leaves_of_the_exact_number_counts():
    assert ulps(np.float64([1]), np.float64([1]), rest=np.float64([2**-54])) == 0.25


def test_an_exact_number_wider_than_binary64_counts_whole():
    with mp.workprec(100):
        exact = [1 + mp.mpf(0.75) * mp.mpf(2) ** -52, mp.mpf("-inf"), mp.mpf("nan"), mp.mpf(10) ** 400]
    found = np.float64([1, -np.inf, np.nan, np.inf])
    assert sh.accuracy.ulp(found, exact).tolist() == [0.75, 0, 0, 0]
    assert sh.accuracy.ulp(found[0], np.longdouble(1) + np.longdouble(2) ** -54) == 0.25


def test_the_unit_may_be_that_of_another_type():
    assert ulps(np.float16([1.001]), np.float64([1]), dtype=np.float32) == 2**13


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (ONE, UP, 1),
        (DOWN, UP, 2),
        (np.float32(0), np.float32(-0.0), 0),
        (LEAST, -LEAST, 2),
        (np.float32(np.nan), -np.float32(np.nan), 0),
        (np.float32(np.nan), ONE, np.inf),
        (LARGEST, np.float32(np.inf), 1),
        (np.float64(1), np.nextafter(1, 2), 1),
        (np.float16(1), np.float16(-1), 2 * 0x3C00),
    ],
)
def test_numbers_between(a, b, expected):
    assert steps(np.asarray(a), np.asarray(b)) == expected
    assert steps(np.asarray(b), np.asarray(a)) == expected


def test_relative_errors():
    found, exact = np.float32([1, 2, 0, 1, np.nan, np.inf]), np.float64([1, 1, 0, 0, np.nan, 1e300])
    assert relative(found, exact).tolist() == [0, 1, 0, np.inf, 0, 0]


def test_budgets():
    assert sh.accuracy.ulp(4) == Budget(4, "ulp")
    assert repr(sh.accuracy.ulp(4)) == "ulp(4)"
    assert Budget.parse("2ulp") == Budget(2, "ulp")
    assert Budget.parse("1e-3") == Budget(1e-3, "relative")
    for wrong in ("-1ulp", "ulp", "2 pixels", "nan"):
        with pytest.raises(ValueError):  # noqa: PT011 - argparse shows it with the words
            Budget.parse(wrong)


def test_lists_of_ints_count_as_binary64():
    assert sh.accuracy.ulp([1, 2, 3], [1, 2, 3 + 2**-50]).tolist() == [0, 0, 2]
