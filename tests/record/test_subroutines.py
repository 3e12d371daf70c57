"""Subroutines: which calls share one recording, and what may be given for two parameters."""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR

GAIN = 1


class Settings:
    gain = 1


@dataclass
class Scaled:
    factor: float

    @sh.subroutine
    def apply(self, x):
        return x * self.factor


@sh.subroutine
def horner(x, coefficients):
    total = sh.Attrib1f(0)
    for c in reversed(coefficients):
        total[:] = total * x + c
    return total


def functions_of(program):
    return [f.name for f in program.ir.functions[:-1]]


@pytest.mark.parametrize("form", [list, tuple, np.array, lambda c: np.array(c, np.float16)])
def test_host_arguments_are_told_apart_by_what_they_hold(form):
    @sh.program
    def case(x: sh.Attrib1f):
        return tuple(horner(x, form(c)) for c in ([1.0, 2.0], [5.0, 7.0, 9.0], [1.0, 2.0]))

    assert [float(y) for y in case(10)] == [21, 975, 21]
    assert functions_of(case) == ["horner", "horner_2"]


def test_dicts_are_told_apart_at_every_depth_and_by_order():
    @sh.subroutine
    def weighted(x, weights):
        total = sh.Attrib1f(0)
        for name, (weight, *_) in weights.items():
            total[:] = total * x + weight * len(name)
        return total

    @sh.program
    def case(x: sh.Attrib1f):
        a, b = {"a": [1.0], "bb": [2.0]}, {"a": [1.0], "bb": [3.0]}
        return weighted(x, a), weighted(x, b), weighted(x, dict(reversed(a.items()))), weighted(x, dict(a))

    assert [float(y) for y in case(10)] == [14, 16, 41, 14]
    assert len(functions_of(case)) == 3


def test_equal_numbers_of_other_types_and_bits_are_other_arguments():
    @sh.subroutine
    def spoken(x, k):
        (held,) = k if isinstance(k, tuple) else (k,)
        return x + len(repr(held)) if isinstance(held, int | float) else x + 100

    @sh.program
    def case(x: sh.Attrib1f):
        return tuple(spoken(x, k) for k in (1, 1.0, True, (1,), (1.0,), (True,), np.int32(1)))

    assert [float(y) for y in case(0)] == [1, 3, 4, 1, 3, 4, 100]


def test_zeros_of_both_signs():
    @sh.subroutine
    def signed(x, zero):
        return sh.Attrib1f(zero) + x

    @sh.program
    def case(x: sh.Attrib1f):
        return signed(x, 0.0), signed(x, -0.0), signed(x, [0.0]), signed(x, np.array([-0.0]))

    assert [np.signbit(y) for y in case(-0.0)] == [False, True, False, True]


class Alike(Scaled):
    def __eq__(self, other):
        return True

    __hash__ = object.__hash__


@pytest.mark.parametrize("cls", [Scaled, Alike])
def test_methods_are_recorded_for_each_instance_whatever_it_equals(cls):
    @sh.program
    def case(x: sh.Attrib1f):
        return tuple(cls(k).apply(x) for k in (1, 2, 3, 2))

    assert [float(y) for y in case(10)] == [10, 20, 30, 20]
    assert functions_of(case) == ["apply", "apply_2", "apply_3"]


def test_an_argument_that_is_gone_is_not_taken_for_the_next_one():
    @sh.program
    def case(x: sh.Attrib1f):
        return tuple(horner(x, [float(k)]) for k in range(50))

    assert [float(y) for y in case(0)] == list(range(50))


def test_a_change_between_two_calls_is_seen():
    listed, settings, instance = [1.0], Settings(), Scaled(1)
    array = np.ones(2)
    local = 1

    @sh.subroutine
    def reads_a_global(x):
        return x * GAIN

    @sh.subroutine
    def reads_a_cell(x):
        return x * local

    @sh.subroutine
    def reads_a_list(x, items):
        return x * items[0]

    @sh.subroutine
    def reads_through_others(x):
        return helper(x) * array[0]

    def helper(x):
        return x * settings.gain

    @sh.subroutine
    def calls_one_that_reads(x):
        return reads_a_cell(x) + 0.5

    def each(x):
        return (
            reads_a_global(x),
            reads_a_cell(x),
            reads_a_list(x, listed),
            reads_through_others(x),
            calls_one_that_reads(x),
            instance.apply(x),
        )

    @sh.program
    def case(x: sh.Attrib1f):
        nonlocal local
        global GAIN
        before = each(x)
        GAIN, local, listed[0], settings.gain, array[0], instance.factor = 2, 3, 4.0, 5, 6, 7
        after = each(x)
        GAIN = 1
        return before, after, each(x)

    found = [[float(y) for y in ys] for ys in case(1)]
    assert found == [[1, 1, 1, 1, 1.5, 1], [2, 3, 4, 30, 3.5, 7], [1, 3, 4, 30, 3.5, 7]]
    assert GAIN == 1


def test_a_default_and_a_function_that_is_given_are_read_too():
    @sh.subroutine
    def mapped(x, shape, k=(1.0,)):
        return shape(x) * k[0]

    @sh.program
    def case(x: sh.Attrib1f):
        made = [lambda v, n=n: v + n for n in (1, 2, 1)]
        bound = [functools.partial(lambda n, v: v + n, n) for n in (1, 2)]
        return tuple(mapped(x, shape) for shape in (*made, *bound))

    assert [float(y) for y in case(0)] == [1, 2, 1, 1, 2]


def test_what_a_function_takes_from_its_argument_is_taken_at_each_call():
    @sh.subroutine
    def next_of(x, items):
        return x + next(items)

    @sh.subroutine
    def popped(x, items):
        return x + items.pop()

    @sh.program
    def case(x: sh.Attrib1f):
        items, numbers, others = iter([1, 2]), [3, 4], [3, 4]
        return (
            next_of(x, items),
            next_of(x, items),
            popped(x, numbers),
            popped(x, numbers),
            popped(x, others),
            len(others),
        )

    assert [float(y) for y in case(0)] == [1, 2, 4, 3, 4, 1]


def test_calls_that_record_the_same_are_one_function():
    """Also where only recording again can tell: numpy's attributes may change."""

    @sh.subroutine
    def turn(x):
        return x * np.pi

    @sh.subroutine
    def limited(x, settings):
        with SH_FOR(0, settings.gain):
            x += 1

    @sh.program
    def case(x: sh.Attrib1f):
        for _ in range(3):
            limited(x, Settings())
        return turn(x) + turn(x + 1) + turn(x + 2)

    assert functions_of(case) == ["limited", "turn"]
    assert case(0) == np.float32(np.float32(3 * np.float32(np.pi)) + np.float32(4 * np.float32(np.pi))) + np.float32(
        5 * np.float32(np.pi)
    )


def test_a_deep_chain_is_recorded_once_a_level():
    def doubled(below):
        @sh.subroutine
        def level(x):
            return below(x) + below(x * 2)

        return level

    routine = sh.subroutine(lambda x: x + 1)
    for _ in range(24):
        routine = doubled(routine)

    @sh.program
    def case(x: sh.Attrib1f) -> sh.Attrib1f:
        return routine(x)

    assert len(functions_of(case)) == 25  # 2**24 recordings would not end


def test_a_texture_that_is_filtered_otherwise_is_another_function():
    checker = sh.Texture2D(np.eye(2, dtype=np.float32), filter="linear")

    @sh.program
    def case(uv: sh.TexCoord2f):
        before = checker(uv)
        checker.filter = "nearest"
        after = checker(uv)
        checker.filter = "linear"
        return before, after, checker(uv)

    assert [float(y) for y in case((0.5, 0.25))] == [0.5, 0, 0.5]
    assert len(functions_of(case)) == 2


def test_programs_that_are_made_for_one_call_are_not_taken_for_each_other():
    def made(k):
        @sh.subroutine
        def scaled(x):
            return x * k

        @sh.program
        def inner(x: sh.Attrib1f) -> sh.Attrib1f:
            return scaled(x)

        return inner

    @sh.program
    def case(x: sh.Attrib1f):
        return tuple(made(k)(x) for k in range(40))

    assert [float(y) for y in case(1)] == list(range(40))


# One variable for two parameters


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


@sh.subroutine
def steps(a, b):
    a += 1
    a += b


@sh.subroutine
def stepped(b, a):
    a += 1
    a += b


@sh.subroutine
def moved(ray, by):
    ray.o += 1
    ray.o += by


@sh.subroutine
def summed(a, b):
    return a[0] + b[0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda x: steps(x, x), "one variable is given for a and b, and steps stores into a"),
        (lambda x: stepped(x, x), "one variable is given for b and a, and stepped stores into a"),
        (lambda x: _with_a_ray(x), "one variable is given for ray and by, and moved stores into ray"),
        (lambda x: _with_an_array(x), "one variable is given for a and b, which summed takes by reference"),
    ],
)
def test_one_variable_for_a_written_and_a_read_parameter_is_an_error(call, message):
    def case(x: sh.Attrib1f):
        call(x)
        return x

    with pytest.raises(sh.RecordError) as caught:
        sh.program(case)
    assert caught.value.message == message
    assert caught.value.cure == "a copy for one of them: x.copy()"
    assert caught.value.loc.file == __file__


def _with_a_ray(x):
    ray = Ray(sh.Point3f(x), sh.Vector3f(1))
    moved(ray, ray.o)


def _with_an_array(x):
    a = sh.Array(sh.Attrib1f, [x, x])
    summed(a, a)


class Both(NamedTuple):
    first: sh.Attrib1f
    second: sh.Attrib1f


def test_one_variable_may_be_read_twice_and_copies_may_be_written():
    @sh.subroutine
    def product(a, b):
        return a * b

    @sh.program
    def case(x: sh.Attrib1f) -> Both:
        square = product(x, x)
        steps(x, x.copy())
        return Both(x, square)

    assert case(3) == (7, 9)
