"""Arguments of subroutines: as their parameters are annotated, and elements of arrays that are stored into."""

import numpy as np
import pytest

import shpy as sh


def functions_of(program):
    return [f.name for f in program.ir.functions[:-1]]


@sh.subroutine
def squared(x: sh.Attrib1f):
    return x * x


@sh.subroutine
def product(v: sh.Attrib3f):
    return sh.dot(v, v)


@sh.subroutine
def stretched(v: sh.Normal3f):
    return sh.Matrix4f((2, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)) @ v


@sh.subroutine
def raised(n: sh.Vector3f):
    n += 1


def test_arguments_are_taken_as_their_parameters_are_annotated():
    @sh.program
    def f(n: sh.Attrib1i, v: sh.Vector3f) -> tuple[sh.Attrib1f, sh.Attrib1f, sh.Attrib1f, sh.Normal3f]:
        return squared(n), product(n), product(v), stretched(v)

    square, scalar, vector, normal = f(100_000, (2, 1, 1))
    assert (square, scalar, vector) == (1e10, np.float32(3e10), 6)
    assert normal.tolist() == [1, 1, 1]
    assert functions_of(f) == ["squared", "product", "stretched"]


def test_another_kind_is_passed_by_reference():
    @sh.program
    def f(v: sh.Normal3f) -> sh.Normal3f:
        raised(v)
        return v

    assert f((1, 2, 3)).tolist() == [2, 3, 4]


def narrow(x: sh.Attrib1f) -> sh.Attrib1f:
    return whole(x)


def short(x: sh.Attrib2f) -> sh.Attrib1f:
    return product(x)


def long(v: sh.Attrib2i) -> sh.Attrib1i:
    return whole(v)


def stored(x: sh.Attrib1i) -> sh.Attrib1f:
    grow(x)
    return x


@sh.subroutine
def whole(n: sh.Attrib1i):
    return n + 1


@sh.subroutine
def grow(x: sh.Attrib1f):
    x += 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            narrow,
            "n of whole of type i would narrow f\n  write instead: the conversion written out, sh.Attrib1i(…)",
        ),
        (
            short,
            "v of product takes 3 components or one, not 2\n"
            "  write instead: pick components, as in v.xyz, or build the vector, as in sh.Attrib3f(p.xy, 0)",
        ),
        (long, "n of whole takes one component, not 2\n  write instead: pick one, as in v.x"),
        (
            stored,
            "grow stores into x, which is given a value of another type: it is converted, so the store would be lost\n"
            "  write instead: a value of its own: x = sh.Attrib1f(…), then grow(x)",
        ),
    ],
)
def test_an_argument_that_its_parameter_does_not_take_is_an_error(call, message):
    with pytest.raises(sh.ShpyError) as caught:
        sh.program(call)
    line = call.__code__.co_firstlineno + 1
    assert str(caught.value) == f"{__file__}:{line}: {message}"


@sh.struct
class Ball:
    place: sh.Point2f
    hits: sh.Attrib1i


@sh.subroutine
def pushed(ball):
    ball.place += sh.Vector2f(1, 0)


@sh.subroutine
def scaled_corner(m):
    m[0, 0] = m[0, 0] * 3


def test_an_element_of_an_array_that_is_kept_may_be_given_for_a_written_parameter():
    @sh.program
    def f(k: sh.Attrib1i) -> tuple[sh.Point2f, sh.Attrib1f]:
        balls, matrices = sh.Array(Ball, 3), sh.Array(sh.Matrix2f, 2)
        ball = balls[k]
        pushed(ball)
        balls[k] = ball
        matrices[k] = sh.Matrix2f((2, 0), (0, 2))
        m = matrices[k]
        scaled_corner(m)
        matrices[k] = m
        return balls[k].place, matrices[k][0, 0]

    place, corner = f(1)
    assert (place.tolist(), corner) == ([1, 0], 6)


def test_without_text_an_element_that_an_earlier_line_read_is_one_that_is_kept():
    names = {"sh": sh, "grow": grow}
    exec("def kept(k):\n a = sh.Array(sh.Attrib1f, 3)\n x = a[k]\n grow(x)\n a[k] = x\n return a[k]\n", names)
    exec("def lost(k):\n a = sh.Array(sh.Attrib1f, 3)\n grow(a[k])\n return a[k]\n", names)
    for name in ("kept", "lost"):
        names[name].__annotations__["k"] = sh.Attrib1i
    assert sh.program(names["kept"])(1) == 1
    with pytest.raises(sh.RecordError, match="grow stores into x, which is given "):
        sh.program(names["lost"])


def at_once(k: sh.Attrib1i):
    balls = sh.Array(Ball, 3)
    pushed(balls[k])


def over_lines(k: sh.Attrib1i):
    balls = sh.Array(Ball, 3)
    pushed(
        balls[k],
    )


@pytest.mark.parametrize("function", [at_once, over_lines])
def test_an_element_that_the_call_reads_is_a_copy(function):
    with pytest.raises(sh.RecordError) as caught:
        sh.program(function)
    assert str(caught.value).partition(": ")[2] == (
        "pushed stores into ball, which is given balls[i], a copy\n"
        "  write instead: x = balls[i] first, and balls[i] = x after the call"
    )


BALLS = sh.Table({"place": [(1, 2)], "hits": [3]}, Ball, name="BALLS")
BALL = sh.Param(Ball, ((1, 2), 3), name="BALL")
CORNER = sh.Matrix2f((2, 0), (0, 2))


def of_a_table():
    x = BALLS[0]
    pushed(x)
    return x.place.x


def of_a_param():
    x = BALL.copy()
    pushed(x)
    return x.place.x


def of_a_constant():
    x = CORNER.copy()
    scaled_corner(x)
    return x[0, 0]


@pytest.mark.parametrize(
    ("call", "cure", "cured", "result"),
    [
        (lambda: pushed(BALLS[0]), "x = BALLS[…]", of_a_table, 2),
        (lambda: pushed(BALL), "a value of its own: x = y.copy(), then pushed(x)", of_a_param, 2),
        (lambda: scaled_corner(CORNER), "a value of its own: x = y.copy(), then scaled_corner(x)", of_a_constant, 6),
    ],
)
def test_a_struct_or_matrix_that_no_store_changes_is_copied_whole(call, cure, cured, result):
    with pytest.raises(sh.RecordError) as caught:
        sh.program(call)
    assert caught.value.cure == cure
    assert sh.program(cured)() == result


def test_a_constant_struct_is_copied_before_a_store():
    ball = Ball((1, 2), 3)

    def stored(made):
        made.place += 1
        return made.place

    with pytest.raises(sh.RecordError, match="a constant cannot be stored into") as caught:
        sh.program(lambda: stored(ball))
    assert caught.value.cure == "a copy inside the program, y = x.copy()"
    assert sh.program(lambda: stored(ball.copy()))().tolist() == [2, 3]


@sh.subroutine
def summed(pair):
    return pair[0] + pair[1]


@sh.struct
class Two:
    a: sh.Attrib1f
    b: sh.Attrib1f

    def __getitem__(self, k):
        return (self.a, self.b)[k]


def test_values_in_a_tuple_are_given_by_themselves_or_in_a_struct():
    with pytest.raises(sh.RecordError, match="was made outside of the subroutine 'summed'") as caught:
        sh.program(lambda: summed((sh.Attrib1f(1), sh.Attrib1f(2))))
    assert caught.value.cure.startswith("pass it as an argument, by itself or in a @sh.struct; ")
    assert sh.program(lambda: summed(Two(1, 2)))() == 3


@sh.subroutine
def doubled(y: sh.Attrib1f = None):
    return sh.Attrib1f(1) if y is None else y * 2


@pytest.mark.parametrize("given", ["abc", Two, sh.Array], ids=["text", "struct", "array"])
def test_an_annotated_parameter_takes_its_type_and_its_own_default(given):
    @sh.subroutine
    def halved(y: sh.Attrib1f):
        return y / 2

    made = {Two: lambda: Two(1, 2), sh.Array: lambda: sh.Array(sh.Attrib1f, 3)}.get(given, lambda: given)
    with pytest.raises(sh.ShpyTypeError, match="y of halved takes Attrib1f, not ") as caught:
        sh.program(lambda: halved(made()))
    assert caught.value.loc.file == __file__
    with pytest.raises(sh.ShpyTypeError, match="y of halved takes Attrib1f, not NoneType"):
        sh.program(lambda: halved(None))
    assert sh.program(lambda: doubled() + doubled(None) + doubled(3))() == 8
