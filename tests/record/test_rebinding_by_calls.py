"""Contents that a function binds which a block calls: a method, a helper, a list's own function, an inner function."""

import pytest

import shpy as sh
from shpy import SH_FOR, SH_IF


class Best:
    def __init__(self, value):
        self.value = value

    def take(self, value):
        self.value = value


class Slots:
    __slots__ = ("value",)

    def __init__(self, value):
        self.value = value

    def take(self, value):
        self.value = value


def put(holder, value):
    holder[0] = value


def method(x: sh.Attrib1f, y: sh.Attrib1f):
    best = Best(x)
    with SH_IF(x > y):
        best.take(y)
    return best.value


def slots(x: sh.Attrib1f, y: sh.Attrib1f):
    best = Slots(x)
    with SH_IF(x > y):
        best.take(y)
    return best.value


def slots_of_the_block(x: sh.Attrib1f, y: sh.Attrib1f):
    best = Slots(x)
    with SH_IF(x > y):
        best.value = y
    return best.value


def set_by_name(x: sh.Attrib1f, y: sh.Attrib1f):
    best = Best(x)
    with SH_IF(x > y):
        setattr(best, "value", y)  # noqa: B010
    return best.value


def helper(x: sh.Attrib1f, y: sh.Attrib1f):
    values = [x]
    with SH_IF(x > y):
        put(values, y)
    return values[0]


def reversed_list(x: sh.Attrib1f, y: sh.Attrib1f):
    values = [x, y]
    with SH_IF(x > y):
        values.reverse()
    return values[0]


def updated(x: sh.Attrib1f, y: sh.Attrib1f):
    values = {"a": x}
    with SH_IF(x > y):
        values.update(a=y)
    return values["a"]


def inner(x: sh.Attrib1f, y: sh.Attrib1f):
    best = x

    def take():
        nonlocal best
        best = y

    with SH_IF(x > y):
        take()
    return best


def in_the_next_iteration(x: sh.Attrib1f, y: sh.Attrib1f):
    total, last = sh.Attrib1f(0), Best(x)
    with SH_FOR(0, 3):
        total += last.value
        last.take(y)
    return total


WRONG = (method, slots, slots_of_the_block, set_by_name, helper, reversed_list, updated, inner, in_the_next_iteration)


@pytest.mark.parametrize("function", WRONG, ids=lambda f: f.__name__)
def test_it_is_an_error_at_a_line_of_the_block(function):
    """They were [0, 0] for the elements -1 and 1 beside 0: the store of the block, whether or not it runs."""
    with pytest.raises(sh.RecordError, match="is rebound inside `with SH_") as caught:
        sh.program(function)
    assert caught.value.loc.file == __file__
    start = function.__code__.co_firstlineno
    assert start < caught.value.loc.line < start + 12


def in_place(x: sh.Attrib1f, y: sh.Attrib1f):
    best = Best(x.copy())
    with SH_IF(x > y):
        best.value[:] = y
    return best.value


def only_inside(x: sh.Attrib1f, y: sh.Attrib1f):
    best, result = Best(x), x.copy()
    with SH_IF(x > y):
        best.take(y)
        result[:] = 2 * best.value
    best.value = x
    return result + best.value


def longer(x: sh.Attrib1f, y: sh.Attrib1f):
    values, result = [x], x.copy()
    with SH_IF(x > y):
        values.insert(0, y)
        result += values[0]
    return result + values[-1]


def numbers_of_the_host(x: sh.Attrib1f, y: sh.Attrib1f):
    counts, result = {"blocks": 0}, x.copy()
    with SH_IF(x > y):
        counts.update(blocks=counts["blocks"] + 1)
        result += y
    return result * counts["blocks"]


RIGHT = {in_place: [-1.0, 0.0], only_inside: [-2.0, 1.0], longer: [-2.0, 2.0], numbers_of_the_host: [-1.0, 1.0]}


@pytest.mark.parametrize("function", RIGHT, ids=lambda f: f.__name__)
def test_programs_that_are_right_are_recorded(function):
    assert sh.program(function)([-1.0, 1.0], 0.0).tolist() == RIGHT[function]
