"""The places of SH_RETURN: the body of a program or subroutine, and no function that either calls."""

import functools

import numpy as np
import pytest

import shpy as sh
from shpy import SH_DO, SH_IF, SH_RETURN, SH_UNTIL


def clipped(v):
    with SH_IF(v > 1):
        SH_RETURN(v)
    return sh.Attrib1f(-1)


def test_a_plain_helper_cannot_end_the_program():
    with pytest.raises(sh.RecordError) as caught:

        @sh.program
        def case(a: sh.Attrib1f) -> sh.Attrib1f:
            return 100 + clipped(a)

    assert caught.value.message == (
        "this SH_RETURN stands in `clipped`, a plain function, and would end case, which calls it"
    )
    assert caught.value.cure == "decorate `clipped` with @sh.subroutine: SH_RETURN then ends it alone"
    assert caught.value.loc.line == 14


def test_as_a_subroutine_it_ends_itself():
    helper = sh.subroutine(clipped)

    @sh.program
    def case(a: sh.Attrib1f) -> sh.Attrib1f:
        return 100 + helper(a)

    assert case([2, 0]).tolist() == [102, 99]


def test_functions_inside_the_program_are_plain_functions_too():
    def nested(a: sh.Attrib1f) -> sh.Attrib1f:
        def stop():
            SH_RETURN(a, a > 1)

        stop()
        return a + 1

    def anonymous(a: sh.Attrib1f) -> sh.Attrib1f:
        stop = lambda v: SH_RETURN(v, v > 1)  # noqa: E731
        stop(a)
        return a + 1

    with pytest.raises(sh.RecordError, match=r"stands in `stop`, a plain function, and would end nested"):
        sh.program(nested)
    with pytest.raises(sh.RecordError, match=r"stands in the lambda of line \d+, a plain function") as caught:
        sh.program(anonymous)
    assert caught.value.cure == "a def decorated with @sh.subroutine"


def test_a_helper_of_a_subroutine_and_a_second_call_of_the_body_are_errors():
    @sh.subroutine
    def outer(v):
        return clipped(v) * 2

    def case(a: sh.Attrib1f) -> sh.Attrib1f:
        return outer(a)

    with pytest.raises(sh.RecordError, match="stands in `clipped`, a plain function, and would end outer"):
        sh.program(case)

    def again(a: sh.Attrib1f, depth=0) -> sh.Attrib1f:
        SH_RETURN(a, a > 1)
        return again(a + 1, depth + 1) * 10 if depth < 1 else a

    with pytest.raises(sh.RecordError, match="stands in `again`, a plain function, and would end again"):
        sh.program(again)


def test_every_way_to_give_a_body_is_at_home():
    def body(k, a: sh.Attrib1f) -> sh.Attrib1f:
        with SH_DO():
            a += k
            [SH_RETURN(a + n, a > 5 + n) for n in (2, 1)]
            SH_UNTIL(a > 100)
        return a

    class Scaled:
        def method(self, a: sh.Attrib1f) -> sh.Attrib1f:
            SH_RETURN(a * 2, a > 1)
            return a

        def __call__(self, a: sh.Attrib1f) -> sh.Attrib1f:
            SH_RETURN(a * 3, a > 1)
            return a

    @functools.wraps(body)
    def wrapped(*args, **named):
        return body(*args, **named)

    assert sh.program(functools.partial(body, 3))(0.0) == 11
    assert sh.program(functools.partial(wrapped, 3))(0.0) == 11
    assert sh.program(Scaled().method)([2, 0]).tolist() == [4, 0]
    assert sh.program(Scaled())([2, 0]).tolist() == [6, 0]


def test_a_program_that_is_called_ends_alone():
    @sh.program
    def inner(a: sh.Attrib1f) -> sh.Attrib1f:
        SH_RETURN(a, a > 1)
        return a + 10

    @sh.program
    def outer(a: sh.Attrib1f) -> sh.Attrib1f:
        SH_RETURN(sh.Attrib1f(-1), a > 10)
        return 100 + inner(a)

    np.testing.assert_array_equal(outer([0, 2, 20]), [110, 102, -1])


def test_what_a_decorator_computes_afterwards_is_not_skipped_in_silence():
    def doubled(function):
        @functools.wraps(function)
        def wrapper(*args, **named):
            result = function(*args, **named)
            return result * 2

        return wrapper

    def checked(function):
        @functools.wraps(function)
        def wrapper(a):
            SH_RETURN(sh.Attrib1f(0), a < 0)
            print("recording")
            return function(a * 2)

        return wrapper

    def case(a: sh.Attrib1f) -> sh.Attrib1f:
        SH_RETURN(a, a > 1)
        return a + 1

    with pytest.raises(sh.RecordError, match="a decorator of case goes on computing here") as caught:
        sh.program(doubled(case))
    assert caught.value.cure == "decorate case with @sh.subroutine first, below the other decorators"
    assert sh.program(doubled(sh.subroutine(case)))([0, 2]).tolist() == [2, 4]
    assert sh.program(checked(case))([-1, 0.25, 2]).tolist() == [0, 1.5, 4]


def statements_of(front_end, x):
    """Record the statements of a small language, as a front end does."""
    for statement, *parts in front_end:
        match statement:
            case "return":
                SH_RETURN(parts[0](x), through=True)
            case "return if":
                SH_RETURN(parts[0](x), parts[1](x), through=True)
            case "if":
                with SH_IF(parts[0](x)):
                    statements_of(parts[1], x)


def test_a_front_end_ends_a_program_from_its_own_functions():
    listing = [
        ("if", lambda x: x > 5, [("return if", lambda x: x * 2, lambda x: x > 7), ("return", lambda x: x)]),
        ("return if", lambda x: -x, lambda x: x > 2),
    ]

    @sh.program
    def case(x: sh.Attrib1f) -> sh.Attrib1f:
        statements_of(listing, x)
        return x + 100

    assert case([1, 3, 6, 8]).tolist() == [101, -3, 6, 16]

    @sh.subroutine
    def routine(x: sh.Attrib1f) -> sh.Attrib1f:
        statements_of(listing, x)
        return x + 100

    @sh.program
    def around(x: sh.Attrib1f) -> sh.Attrib1f:
        return routine(x) + 1000

    assert around([1, 3, 6, 8]).tolist() == [1101, 997, 1006, 1016]
    assert [f.name for f in around.ir.functions] == ["routine", "around"]


def test_through_helpers_is_said_in_so_many_words_and_decorators_stay_checked():
    def doubled(function):
        @functools.wraps(function)
        def wrapper(x):
            return function(x) * 2

        return wrapper

    def case(x: sh.Attrib1f) -> sh.Attrib1f:
        statements_of([("return if", lambda v: v, lambda v: v > 1)], x)
        return x + 1

    def answered(x: sh.Attrib1f) -> sh.Attrib1f:
        SH_RETURN(x, through="yes")

    with pytest.raises(sh.RecordError, match="a decorator of case goes on computing here"):
        sh.program(doubled(case))
    with pytest.raises(sh.ShpyTypeError, match="through='yes' is neither True nor False"):
        sh.program(answered)


def one(x: sh.Attrib1f) -> sh.Attrib1f:
    return x, x


def one_vector(x: sh.Attrib1f) -> sh.Attrib3f:
    return [x, x]


def two(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Color3f]:
    return x


def two_of_three(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Color3f]:
    return x, sh.Color3f(x), x


def rows(x: sh.Attrib1f) -> sh.Matrix2f:
    return x, x


@pytest.mark.parametrize(
    ("function", "message", "cure"),
    [
        (one, "one returns a tuple of 2, and is annotated with -> sh.Attrib1f", "-> tuple[sh.Attrib1f, sh.Attrib1f]"),
        (one_vector, "one_vector returns a list of 2, and is annotated with -> sh.Attrib3f", "-> tuple[sh.Attrib1f, "),
        (two, "two returns one Attrib1f, and is annotated with -> tuple[sh.Attrib1f, sh.Color3f]", "-> sh.Attrib1f, "),
        (two_of_three, "two_of_three returns a tuple of 3, and is annotated with -> tuple[sh.Attrib1f, sh", "-> tuple"),
        (rows, "rows returns a tuple of 2, and is annotated with -> sh.Matrix2f", "-> tuple[sh.Attrib1f, sh.Attrib1f]"),
    ],
)
def test_another_number_of_values_than_the_annotation_names(function, message, cure):
    with pytest.raises(sh.ShpyTypeError) as caught:
        sh.program(function)
    assert caught.value.message.startswith(message)
    assert caught.value.cure.startswith(cure)
    assert caught.value.loc.file == __file__


def test_the_cure_for_an_unknown_annotation_of_the_result_is_an_annotation():
    def number(x: sh.Attrib1f) -> float:
        return x

    with pytest.raises(sh.ShpyTypeError, match="what it gives back is annotated") as caught:
        sh.program(number)
    assert caught.value.cure == "sh.Attrib1f, or another type of shpy, a @sh.struct, a NamedTuple of types"


def test_the_cure_for_types_in_brackets_is_a_tuple_of_them():
    def pair(x: sh.Attrib1f) -> (sh.Attrib1f, sh.Color3f):
        return x, sh.Color3f(x)

    with pytest.raises(sh.ShpyTypeError, match="what it gives back is annotated") as caught:
        sh.program(pair)
    assert caught.value.cure == "tuple[sh.Attrib1f, sh.Color3f]"


def test_a_tuple_of_as_many_numbers_is_a_vector():
    @sh.program
    def case(x: sh.Attrib1f) -> sh.Attrib2f:
        return x, x + 1

    assert case(1).tolist() == [1, 2]


def test_recursion_is_an_error_at_the_line_that_calls():
    def helper(x):
        return helper(x * 2) + 1

    def even(x):
        return odd(x - 1)

    def odd(x):
        return even(x - 1)

    for called, names in ((helper, ["helper"]), (even, ["even", "odd"])):

        def case(x: sh.Attrib1f) -> sh.Attrib1f:
            return called(x)  # noqa: B023

        with pytest.raises(sh.RecordError) as caught:
            sh.program(case)
        assert caught.value.message.partition(" times")[0].rpartition(" ")[0] in [
            f"{name} calls itself" for name in names
        ]
        assert "sh.Array as the stack" in caught.value.cure
        assert caught.value.loc.file == __file__

    with pytest.raises(sh.RecordError, match="itself calls itself: Python calls it while the program is recorded"):

        @sh.program
        def itself(x: sh.Attrib1f) -> sh.Attrib1f:
            return itself(x - 1)


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (lambda x: {"a": {"b": x}, "a.b": x}, 'case gives back two outputs called "a.b"\n  write instead: another key'),
        (lambda x: {"": x, "0": x}, 'case gives back two outputs called "0"\n  write instead: another key'),
        (
            lambda x: {"a": x, 1: x},
            "case gives back a dict with the key 1, and the keys are the names of outputs\n  write instead: '1': …",
        ),
        (
            lambda x: {"a": x, None: x},
            "case gives back a dict with the key None, and the keys are the names of outputs\n"
            "  write instead: 'None': …",
        ),
    ],
)
def test_the_keys_of_a_dict_name_its_outputs(result, message):
    def case(x: sh.Attrib1f):
        return result(x)

    with pytest.raises(sh.RecordError) as caught:
        sh.program(case)
    assert str(caught.value) == f"{__file__}:{case.__code__.co_firstlineno + 1}: {message}"


def test_a_lambda_cannot_annotate_its_inputs():
    with pytest.raises(sh.RecordError, match="the input x is not annotated") as caught:
        sh.program(lambda x: x)
    assert caught.value.cure == "def f(x: sh.Attrib1f): …"


def bare(x: sh.Attrib1f):
    with SH_IF(x > 0):
        SH_RETURN()
    return x


def bare_under_a_condition(x: sh.Attrib1f):
    SH_RETURN(None, x > 0)
    return x


@pytest.mark.parametrize(("body", "line"), [(bare, 2), (bare_under_a_condition, 1)])
def test_a_return_without_a_value_before_one_with_a_value(body, line):
    def case(x: sh.Attrib1f):
        return sh.subroutine(body)(x)

    for recorded in (body, case):
        with pytest.raises(sh.RecordError, match="gives back a value, and SH_RETURN here has none") as caught:
            sh.program(recorded)
        assert caught.value.loc.line == body.__code__.co_firstlineno + line
