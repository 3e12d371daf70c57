"""The meaning of the elementary functions of binary32: the exact value rounded, with any numpy."""

from __future__ import annotations

import correctly_rounded
import numpy as np
import pytest

import shpy as sh
from shpy.ir import exact
from shpy.ir.ops import OPS

NAMES = sorted(exact.FUNCTIONS)


@pytest.fixture
def anew():
    """Ask numpy again, now and afterwards."""
    caches = exact.trusted, exact._reliable
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()


def worse(f, error):
    """The function of numpy with a relative error."""

    def wrong(x, out=None):
        return np.multiply(f(x, out=out), 1 + error, out=out)

    return wrong


@pytest.mark.parametrize("name", NAMES)
def test_hard_cases_are_rounded_right(name):
    x, answers = exact.hard_cases(name)
    assert len(x) > 100
    assert exact.FUNCTIONS[name](x).tobytes() == answers.tobytes()
    assert OPS[name].meaning(x).tobytes() == answers.tobytes()


@pytest.mark.sampled(12)
@pytest.mark.parametrize("name", NAMES)
def test_all_numbers_are_rounded_right_in_a_stride(name):
    with np.errstate(all="ignore"):
        for x in correctly_rounded.everything(stride=4_093):
            np.testing.assert_array_equal(exact.FUNCTIONS[name](x), correctly_rounded.rounded(name, x))


def test_a_number_alone_and_any_shape_are_taken():
    [first, *_], [answer, *_] = exact.hard_cases("exp")
    assert exact.exp(first).dtype == np.float32
    assert exact.exp(first) == exact.exp(np.asarray(first)) == answer
    assert exact.exp(np.broadcast_to(first, (2, 3))).tolist() == [[answer] * 3] * 2


def test_nan_stays_and_infinities_are_decided():
    with np.errstate(all="ignore"):
        found = exact.log(np.float32([np.nan, -1, 0, np.inf]))
    np.testing.assert_array_equal(found, [np.nan, np.nan, -np.inf, np.inf])


def test_other_precisions_are_those_of_binary64_rounded():
    assert exact.exp(np.float64([1])) == np.exp(1)
    assert exact.exp(np.float16([1])).dtype == np.float16
    assert exact.exp(np.float16([1])) == np.float16(np.e)


@pytest.mark.parametrize("name", ["exp", "sin", "acos", "log"])
@pytest.mark.usefixtures("anew")
def test_a_function_of_numpy_that_is_less_close_is_found_and_not_used(name, monkeypatch):
    monkeypatch.setattr(exact.FUNCTIONS[name], "__wrapped__", worse(exact.FUNCTIONS[name].__wrapped__, 2.0**-44))
    assert not exact.trusted(name)
    x, answers = exact.hard_cases(name)
    assert exact.FUNCTIONS[name](x).tobytes() == answers.tobytes()
    with np.errstate(all="ignore"):
        edges = exact.FUNCTIONS[name](np.float32([np.inf, -np.inf, np.nan]))
        expected = correctly_rounded.rounded(name, np.float32([np.inf, -np.inf, np.nan]))
    np.testing.assert_array_equal(edges, expected)


@pytest.mark.usefixtures("anew")
def test_errors_within_the_margin_change_nothing(monkeypatch):
    for error in (2.0**-46.1, -(2.0**-46.1)):
        monkeypatch.setattr(exact, "_reliable", lambda name, e=error: worse(np.exp, e))
        x, answers = exact.hard_cases("exp")
        assert exact.exp(x).tobytes() == answers.tobytes()


@pytest.mark.usefixtures("anew")
def test_an_error_that_shows_later_is_told(monkeypatch):
    """An input that the function of numpy does not decide, and that is no hard case."""
    x = np.float32([0.3, 0.5])
    ends = np.float64(np.exp(np.float64(x[1]))).astype(np.float32)
    middle = (np.float64(ends) + np.float64(np.nextafter(ends, np.float32(9)))) / 2

    def wrong(given, out):
        out[...] = [1.5, middle]
        return out

    monkeypatch.setattr(exact, "_reliable", lambda name: wrong)
    with pytest.raises(
        sh.ShpyError, match=r"the exp of binary64 of numpy .* is off by more than 2\*\*-46 at np.float32\(0.5"
    ):
        exact.exp(x)
