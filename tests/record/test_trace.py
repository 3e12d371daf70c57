"""A trace: the steps of one element of a run, each with its line, its value and the iterations of the loops around."""

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DISCARD, SH_DO, SH_FOR, SH_IF, SH_UNTIL, SH_WHILE


@sh.program
def place(x: sh.Attrib1f) -> sh.Attrib1f:
    at = sh.grid_index(2)
    size = sh.grid_shape(2)
    y = x + sh.Attrib1f(at.y * size.x + at.x)
    return y


@sh.program
def pairs(n: sh.Attrib1i) -> sh.Attrib1i:
    count = sh.Attrib1i(0)
    with SH_FOR(0, n) as i:
        with SH_FOR(0, i) as j:
            count += j
    return count


def steps_of(steps, name):
    return [(step.iterations, step.value.item()) for step in steps if step.name == name]


def value_of(steps, name):
    return next(step.value.tolist() for step in steps if step.name == name)


def test_a_program_over_a_grid_is_traced_at_one_element():
    x = np.arange(12.0).reshape(3, 4)
    shape_alone = place.trace(x=1.0, shape=(3, 4), at=(2, 1))
    with_arrays = place.trace(x=x, at=(2, 1))
    assert value_of(with_arrays, "at") == value_of(shape_alone, "at")
    assert value_of(with_arrays, "size") == value_of(shape_alone, "size")
    assert value_of(shape_alone, "y") == place.compile("numpy")(1.0, shape=(3, 4))[2, 1]
    assert value_of(with_arrays, "y") == place.compile("numpy")(x)[2, 1] == 14


def test_at_picks_the_element_of_every_input_as_numpy_broadcasts_them():
    @sh.program
    def f(a: sh.Attrib1f, b: sh.Attrib3f):
        c = a * b
        return c

    a, b = np.arange(4.0), np.arange(36.0).reshape(3, 4, 3)
    assert value_of(f.trace(a=a, b=b, at=(1, 3)), "c") == (a[3] * b[1, 3]).tolist()
    assert value_of(f.trace(a, b, at=np.unravel_index(7, (3, 4))), "c") == (a[3] * b[1, 3]).tolist()
    assert value_of(f.trace(a=a, b=(1, 2, 3), at=2), "c") == [2, 4, 6]
    assert value_of(f.trace(a=2.0, b=np.ones((1, 1, 3))), "c") == [2, 2, 2]
    assert value_of(f.trace(a=2.0, b=(1, 2, 3), shape=(5,), at=4), "c") == [2, 4, 6]


def test_streams_and_structs_are_inputs_of_a_trace_too():
    @sh.struct
    class Pair:
        one: sh.Attrib1f
        two: sh.Attrib2f

    @sh.program
    def f(p: Pair, x: sh.Attrib1f):
        y = p.one * p.two.y + x
        return y

    p = {"one": np.arange(3.0), "two": np.arange(6.0).reshape(3, 2)}
    x = sh.Stream(np.arange(3.0), sh.Attrib1f)
    assert value_of(f.trace(p=p, x=x, at=2), "y") == 2 * 5 + 2
    pair = sh.Stream(p, Pair)
    assert value_of(f.trace(p=pair, x=x, at=(1,)), "y") == 1 * 3 + 1


def test_an_input_named_as_an_option_is_given_by_position():
    @sh.program
    def f(at: sh.Attrib1f, x: sh.Attrib1f):
        y = at - x
        return y

    assert value_of(f.trace(5.0, 2.0), "y") == 3
    assert value_of(f.trace(np.arange(3.0), 2.0, at=1), "y") == -1


def test_each_step_says_the_iterations_of_the_loops_around_it():
    steps = pairs.trace(n=3)
    assert steps_of(steps, "i") == [((1,), 0), ((2,), 1), ((3,), 2)]
    assert steps_of(steps, "j") == [((2, 1), 0), ((3, 1), 0), ((3, 2), 1)]
    assert steps_of(steps, "count") == [((), 0), ((2, 1), 0), ((3, 1), 0), ((3, 2), 1)]
    printed = [str(step) for step in steps if step.name == "count"]
    line = next(step.loc.line for step in steps if step.iterations == (3, 2) and step.name == "count")
    assert printed[0].endswith("count = 0")
    assert "iteration" not in printed[0]
    assert printed[-1] == f"{__file__}:{line} [iteration 3, 2]: count = 1"


def test_iterations_are_counted_through_every_exit_and_spelling():
    @sh.program
    def f(x: sh.Attrib1i):
        n = sh.Attrib1i(0)
        with SH_FOR(0, 4) as i:
            with SH_IF(i == 1):
                SH_CONTINUE()
            n += 1
            SH_BREAK(i == 2)
        with SH_WHILE(lambda: n < 5):
            n += 2
        with SH_DO():
            n -= 1
            SH_UNTIL(n < 5)
        after = n + x
        return after

    steps = f.trace(x=0)
    assert steps_of(steps, "n") == [
        ((), 0),
        ((1,), 1),
        ((3,), 2),
        ((1,), 4),
        ((2,), 6),
        ((1,), 5),
        ((2,), 4),
    ]
    assert steps_of(steps, "after") == [((), 4)]


def test_a_loop_in_a_subroutine_counts_inside_of_the_callers():
    @sh.subroutine
    def double(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        with SH_FOR(0, 2):
            y += x
        return y

    @sh.program
    def f(x: sh.Attrib1f):
        z = sh.Attrib1f(x)
        with SH_FOR(0, 2):
            z[:] = double(z)
        return z

    steps = f.trace(x=1.0)
    assert [n for n, _ in steps_of(steps, "y")] == [(1,), (1, 1), (1, 2), (2,), (2, 1), (2, 2)]
    assert steps_of(steps, "z") == [((), 1), ((1,), 3), ((2,), 9)]


def test_an_element_that_ends_in_a_loop_leaves_no_trace_behind():
    @sh.program
    def f(x: sh.Attrib1f):
        y = sh.Attrib1f(x)
        with SH_FOR(0, 3) as i:
            with SH_IF(i == 1):
                SH_DISCARD()
            y += 1
        return y

    for _ in range(2):
        assert steps_of(f.trace(x=1.0), "y") == [((), 1), ((1,), 2)]


GRID = "shape=(h, w), at=(y, x)"
INDEX = "at=(0, 0), one index for each axis of the shape"
ERRORS = [
    ({}, "place uses grid_index(2) and is traced over the shape ()", GRID),
    ({"at": (0, 0)}, "place uses grid_index(2) and is traced over the shape ()", GRID),
    ({"shape": (6,), "at": 0}, "place uses grid_index(2) and is traced over the shape (6,)", GRID),
    ({"shape": (3, 4)}, "trace runs one element, and there are 12, of the shape (3, 4)", INDEX),
    ({"shape": (3, 4), "at": 2}, "at=2 has 1 index, and the shape (3, 4) has 2 axes", INDEX),
    ({"shape": (3, 4), "at": (2, 4)}, "at=(2, 4) is not inside the shape (3, 4)", "at=(0, 0) to at=(2, 3)"),
    ({"shape": (3, 4), "at": (-1, 0)}, "at=(-1, 0) is not inside the shape (3, 4)", "at=(0, 0) to at=(2, 3)"),
    ({"shape": (0, 4), "at": (0, 0)}, "there is no element to trace: the shape is (0, 4)", "one element at least"),
    ({"shape": (3, 4), "at": (1.0, 2)}, "at=(1.0, 2) is neither an int nor a tuple of ints", "at=(y, x)"),
    ({"shape": (3, 4), "at": True}, "at=True is neither an int nor a tuple of ints", "at=(y, x)"),
    ({"shape": (3, "a"), "at": 0}, "shape=(3, 'a') is neither an int nor a tuple of ints", "shape=(h, w)"),
]


@pytest.mark.parametrize(("given", "message", "cure"), ERRORS)
def test_errors_name_the_cure(given, message, cure):
    with pytest.raises(sh.ShpyTypeError) as error:
        place.trace(x=1.0, **given)
    assert error.value.message == message
    assert error.value.cure == cure
    assert error.value.loc.file == __file__


def test_arrays_without_an_index_are_refused_with_an_index_to_write():
    with pytest.raises(sh.ShpyTypeError) as error:
        pairs.trace(n=np.arange(5))
    assert error.value.message == "trace runs one element, and there are 5, of the shape (5,)"
    assert error.value.cure == "at=0, one index for each axis of the shape"
