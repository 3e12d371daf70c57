"""Mistakes that Python would pass in silence, or whose own errors name no line of the user's."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import shpy as sh


@sh.struct
class Pair:
    a: sh.Attrib1f
    b: sh.Attrib1f


@sh.subroutine
def half(x: sh.Attrib1f) -> sh.Attrib1f:
    return x / 2


def structs(x: Pair, y: Pair) -> sh.Attrib1b:
    return x == y


def structs_differ(x: Pair, y: Pair) -> sh.Attrib1b:
    return x != y


def a_value_and_a_struct(x: sh.Attrib1f, y: Pair) -> sh.Attrib1b:
    return x == y


def arrays(x: sh.Attrib1f) -> sh.Attrib1b:
    a = sh.Array(sh.Attrib1f, [x, x])
    return a == a


def a_complex(x: sh.Attrib1f) -> sh.Attrib1b:
    return x == 1j


def two_for_one(x: sh.Attrib1f) -> sh.Attrib1f:
    return half(x, x)


def another_field(x: Pair) -> Pair:
    x.c = 3
    return x


def a_condition_of_else(x: sh.Attrib1f) -> sh.Attrib1f:
    with sh.SH_IF(x > 0):
        x += 1
    with sh.SH_ELSE(x < 0):
        x += 2
    return x


def a_loop_without_an_end(x: sh.Attrib1f) -> sh.Attrib1f:
    with sh.SH_FOR() as i:
        x += i
    return x


def a_modulus(x: sh.Attrib1i) -> sh.Attrib1i:
    return pow(x, 2, 7)


def an_array_as_a_matrix(x: sh.Attrib3f) -> sh.Attrib3f:
    return np.eye(3) @ x


def a_value_and_an_array(x: sh.Attrib3f) -> sh.Attrib3f:
    return x @ np.eye(3)


def a_matrix_and_an_array(x: sh.Attrib3f) -> sh.Attrib3f:
    return sh.Matrix3f() @ np.eye(3) @ x


def a_choice_of_structs(x: Pair, y: Pair) -> Pair:
    return sh.cond(x.a < y.a, x, y)


def a_slice_of_an_array(x: sh.Attrib1f) -> sh.Attrib1f:
    a = sh.Array(sh.Attrib1f, [x, 2, 3])
    return sum(a[0:2])


def an_element_of_numpy(x: sh.Attrib1f) -> sh.Attrib1f:
    a, x = np.zeros(3), x + 1
    a[0] = x
    return x


def a_row_of_numpy(x: sh.Attrib3f) -> sh.Attrib3f:
    a, x = np.zeros((3, 3)), x + 1
    a[1] = x
    return x


MATRIX = (
    "@ cannot take an array of shape (3, 3)\n  write instead: sh.Table(array, type) to look numbers up in, an input "
    "for one number an element, or sh.Matrix3f(array)"
)
STORED = (
    "`a[{}] = …` stores a number while recording, and this value is known only when the program runs\n  write instead: "
    "make `a` a list, or with an index of the language a sh.Array"
)
ARRAYS = "same &= a[i] == b[i] in a loop, with SH_FOR(0, len(a)) as i"
OPERANDS = "a value of the language, a number, or a tuple, list or 1-D array of up to four"
MESSAGES = {
    structs: "== cannot take Pair, a struct\n  write instead: (a.a == b.a) & (a.b == b.b)",
    structs_differ: "!= cannot take Pair, a struct\n  write instead: (a.a != b.a) | (a.b != b.b)",
    a_value_and_a_struct: "== cannot take Pair, a struct\n  write instead: (a.a == b.a) & (a.b == b.b)",
    arrays: f"== compares the elements of no Array\n  write instead: {ARRAYS}",
    a_complex: f"== cannot take complex\n  write instead: {OPERANDS}",
    two_for_one: "half: too many positional arguments\n  write instead: half(x)",
    a_condition_of_else: "SH_ELSE takes nothing\n  write instead: SH_ELSE()",
    a_loop_without_an_end: "SH_FOR takes start, stop, step\n  write instead: SH_FOR(start, stop, step)",
    a_modulus: "pow takes a base and an exponent\n  write instead: (x ** y) % modulus",
    an_array_as_a_matrix: MATRIX,
    a_value_and_an_array: MATRIX,
    a_matrix_and_an_array: MATRIX,
    a_choice_of_structs: "sh.cond cannot take Pair\n  write instead: its rows, fields or elements, one at a time",
    a_slice_of_an_array: "an index cannot take slice\n  write instead: [a[k] for k in range(…)], or SH_FOR for many",
    an_element_of_numpy: STORED.format(0),
    a_row_of_numpy: STORED.format(1),
    another_field: "'Pair' has no field 'c'\n  write instead: one of a, b",
}


@pytest.mark.parametrize("function", MESSAGES)
def test_a_mistake_is_told_at_its_line(function):
    with pytest.raises(sh.ShpyError) as caught:
        sh.program(function)
    code = function.__code__
    lines = range(code.co_firstlineno, max(line for *_, line in code.co_lines() if line) + 1)
    assert caught.value.loc.file == __file__
    assert caught.value.loc.line in lines
    assert str(caught.value).partition(": ")[2] == MESSAGES[function]


def test_a_subroutine_and_a_program_are_no_function_to_record():
    with pytest.raises(sh.ShpyTypeError, match="half is a subroutine already"):
        sh.program(half)
    doubled = sh.program(lambda: sh.Attrib1f(2))
    with pytest.raises(sh.ShpyTypeError, match="is a program already"):
        sh.program(doubled)


def test_a_cached_function_is_no_program():
    with pytest.raises(sh.ShpyTypeError, match="cached is cached by its arguments") as caught:

        @sh.program
        @functools.cache
        def cached(x: sh.Attrib1f) -> sh.Attrib1f:
            return x + 1

    assert caught.value.loc.file == __file__


def test_only_modules_and_texts_make_programs_from_ir():
    with pytest.raises(sh.ShpyTypeError, match=r"from_ir takes a module, not str\n  write instead: sh\.parse\(text\)"):
        sh.Program.from_ir("program f")
    with pytest.raises(sh.ShpyTypeError, match=r"sh\.parse takes a str, not NoneType"):
        sh.parse(None)


def test_a_program_shows_the_type_of_its_tables_and_textures():
    @sh.program
    def looked_up(a: sh.Table[sh.Attrib1f], b: sh.Table[sh.Attrib4f, 2], c: sh.Texture2D[sh.Color3f]) -> sh.Attrib1f:
        return a[0] + b[0, 0].x + c((0, 0)).x

    inputs = "a: Table[Attrib1f], b: Table[Attrib4f, 2], c: Texture2D[Color3f]"
    assert repr(looked_up) == f"<Program looked_up({inputs}) -> Attrib1f>"


def test_a_program_shows_the_types_of_a_tuple_among_its_inputs():
    @sh.program
    def first(pair: tuple[sh.Attrib1f, tuple[sh.Attrib2i, sh.Matrix2f]]) -> sh.Attrib1f:
        return pair[0]

    assert repr(first) == "<Program first(pair: (Attrib1f, (Attrib2i, Matrix2f))) -> Attrib1f>"
    assert first.inputs == {"pair": tuple[sh.Attrib1f, tuple[sh.Attrib2i, sh.Matrix2f]]}


def test_structs_outside_of_a_program_are_objects():
    pair = Pair(1, 2)
    assert pair == pair
    assert pair != Pair(1, 2)
    assert {pair: 3}[pair] == 3


def test_annotations_that_are_strings_know_the_enclosing_function():
    @sh.struct
    class Ray:
        origin: sh.Attrib1f

    @sh.program
    def moved(ray: Ray) -> Ray:
        return Ray(ray.origin + 1)

    assert moved((3,)).origin == 4


def test_an_annotation_of_a_field_that_means_nothing_is_told_at_its_class():
    with pytest.raises(sh.ShpyTypeError) as caught:

        @sh.struct
        class Ray:
            origin: sh.Piont3f

    assert caught.value.loc.file == __file__
    assert (
        caught.value.message == "Ray.origin is annotated 'sh.Piont3f', which cannot be resolved: shpy has no 'Piont3f'"
    )
    assert caught.value.cure == "sh.Point3f"


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"x": "shape"}, "shape is a reserved name for an input"),
        ({"x": "a b"}, "'a b' is no name"),
        ({"x": ""}, "'' is no name"),
        ({"x": 3}, "3 is no name"),
    ],
)
def test_a_program_is_renamed_to_names(names, message):
    @sh.program
    def same(x: sh.Attrib1f) -> sh.Attrib1f:
        return x

    with pytest.raises(sh.ShpyTypeError, match=message):
        same.rename(**names)


def test_returns_of_several_counts_name_the_first_one():
    def both(x: sh.Attrib1f):
        sh.SH_RETURN((x, x), x > 1)
        return x

    with pytest.raises(sh.ShpyTypeError) as caught:
        sh.program(both)
    assert (
        caught.value.message == "both returns one Attrib1f, and its first return gives tuple[sh.Attrib1f, sh.Attrib1f]"
    )


def test_cures_of_shapes_work():
    with pytest.raises(sh.ShpyTypeError) as caught:
        sh.Table([1.0, 2, 3], sh.Attrib3f)
    assert caught.value.cure == "array.reshape(-1, 3)"

    @sh.program
    def moved(p: sh.Point3f) -> sh.Point3f:
        return p

    with pytest.raises(sh.ShpyTypeError) as caught:
        moved([[0.0] * 9] * 3)
    assert caught.value.cure == "p.T"
    with pytest.raises(sh.ShpyTypeError, match=r"do not broadcast: p \(3,\), shape=\(4,\)"):
        moved([[0.0] * 3] * 3, shape=(4,))

    def four(v: sh.Vector4f) -> sh.Attrib3f:
        return sh.Matrix3f() @ v

    with pytest.raises(sh.ShpyTypeError, match=r"Matrix3f @ Vector4f has no meaning: it takes 3 components"):
        sh.program(four)


def test_inputs_may_have_any_name_that_calls_leave_free():
    @sh.program
    def f(self: sh.Attrib1f, arrays: sh.Attrib1f) -> sh.Attrib1f:
        return self - arrays

    kernel = f.compile("numpy")
    assert f(self=3, arrays=1) == kernel(self=3, arrays=1) == kernel.run(self=3, arrays=1).outputs == 2


def test_a_field_may_begin_with_an_underscore():
    @sh.struct
    class Hidden:
        _a: sh.Attrib1f
        b: sh.Attrib1f

    @sh.program
    def f(x: sh.Attrib1f) -> Hidden:
        return Hidden(x, 2 * x)

    found = f([1, 2])
    assert (found._a.tolist(), found.b.tolist()) == ([1, 2], [2, 4])
    sh.testing.assert_equivalent(f, [1, 2])


OPERANDS = {
    "swap of a number": (lambda x, v: sh.swap(x, 1), "sh.swap exchanges two values of one type, not Attrib1f and int"),
    "swap of a struct": (
        lambda x, v: sh.swap(Pair(x, x), x),
        "sh.swap exchanges two values of one type, not Pair and Attrib1f",
    ),
    "an array of floats": (
        lambda x, v: sh.Array(sh.Attrib1f, 2.5),
        "the length of an Array is an int that is known while recording, not 2.5",
    ),
    "an array of a value": (
        lambda x, v: sh.Array(sh.Attrib1f, x),
        "the length of an Array is an int that is known while recording, not <Attrib1f x>",
    ),
    "components of an array": (lambda x, v: v[np.array([0, 1])], "a component is named by an int or a letter"),
    "a ratio of three": (lambda x, v: sh.refract(v, v, v), "eta of sh.refract is one number, not a vector of 3"),
}


@pytest.mark.parametrize("case", OPERANDS)
def test_operands_that_do_not_fit_are_errors_of_shpy(case):
    use, message = OPERANDS[case]

    def f(x: sh.Attrib1f, v: sh.Attrib3f) -> sh.Attrib1f:
        use(x, v)
        return x

    with pytest.raises(sh.ShpyTypeError) as caught:
        sh.program(f)
    assert caught.value.message == message
    assert caught.value.cure


def test_numbers_of_python_and_numpy_fit():
    @sh.program
    def f(n: sh.Attrib1i, v: sh.Attrib3f):
        quotient, rest = divmod(-7, n)
        a = sh.Array(sh.Attrib1f, np.int64(3))
        a[2] = sh.refract(v, v, 1).x
        return quotient, rest, sh.float_from_bits(0xFF800000), v[np.array(1)], a[2]

    assert f(2, (1, 0, 0)) == (-4, 1, -np.inf, 0, -1)
    assert np.asarray(sh.float_from_bits((0, 1))).tolist() == [0, 2.0**-149]


@sh.program
def doubled(x: sh.Attrib1f) -> sh.Attrib1f:
    return 2 * x


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: sh.Matrix2f(None), "Matrix2f takes rows, not one NoneType"),
        (lambda: sh.Matrix3f() @ (), "Matrix3f @ tuple has no meaning"),
        (lambda: sh.Matrix3f() @ (1, 2, 3, 4, 5), "Matrix3f @ tuple has no meaning"),
        (lambda: sh.hash(None), "sh.hash cannot take NoneType"),
        (lambda: doubled.merge(lambda x: x), "is no program"),
        (lambda: sh.Table([1.0], sh.Attrib1f).update([2.0], start="a"), "start='a' is no index of a Table"),
        (lambda: sh.loop(doubled, when=["x"]), r"when=\['x'\] is no dict of members and their shares"),
        (lambda: sh.testing.assert_equivalent(doubled, 1, backends=3), "backends=3 names no backends"),
        (lambda: sh.default_backend(["numpy"]), r"there is no backend \['numpy'\]"),
    ],
)
def test_arguments_of_another_kind_are_refused_in_our_words(call, said):
    with pytest.raises(sh.ShpyError, match=said):
        call()


COUNT, BITS = "int(n)", "sh.Attrib1i(x), which truncates; sh.bits_from_float(x) for the bits of a float"
SHIFTS = {
    "a count with a fraction": (lambda: sh.rotl(1, 1.5), "sh.rotl takes an int as the count of bits, not 1.5", COUNT),
    "counts with fractions": (
        lambda: sh.rotr((1, 2), (1, 0.5)),
        "sh.rotr takes an int as the count of bits, not 1, 0.5",
        COUNT,
    ),
    "a bool as a count": (lambda: sh.Attrib1i(3) << True, "<< takes an int as the count of bits, not True", COUNT),
    "a count of type f": (
        lambda: sh.rotl(1, sh.Attrib1f(2)),
        "sh.rotl takes a count of type i or u, not f",
        "sh.Attrib1i(n)",
    ),
    "bits of a number": (lambda: sh.rotl(1.5, 1), "sh.rotl takes the bits of an int, not 1.5", BITS),
    "bits of a float": (lambda: sh.Attrib1f(2) >> 1, ">> takes the bits of an int, not f", BITS),
}


@pytest.mark.parametrize("case", SHIFTS)
def test_shifts_and_rotations_say_which_operand_does_not_fit(case):
    use, message, cure = SHIFTS[case]
    with pytest.raises(sh.ShpyTypeError) as caught:
        use()
    assert (caught.value.message, caught.value.cure) == (message, cure)
    names = {"sh": sh, "n": 1.5, "x": sh.Attrib1f(3)}
    assert sh.rotl(1, eval(cure, names) if cure == COUNT else 1) == 2
    assert sh.rotl(eval(cure.partition(",")[0], names) if cure == BITS else 3, 1) == 6
