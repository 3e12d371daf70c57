"""Numbers from the host at the edge of what a type holds, or of another kind: kept, or an error with a cure."""

import linecache

import numpy as np
import pytest

import shpy as sh
import shpy_start
from shpy.lang.recording import location

LARGEST = np.finfo(np.float32).max


@sh.program
def same(x: sh.Attrib1f) -> sh.Attrib1f:
    return x


@sh.program
def counted(n: sh.Attrib1i) -> sh.Attrib1i:
    return n


@sh.program
def unsigned(n: sh.Attrib1u) -> sh.Attrib1u:
    return n


@sh.program
def held(c: sh.Attrib1b) -> sh.Attrib1b:
    return c


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_the_shortest_decimal_of_the_largest_float_is_that_float(backend):
    written = float(repr(float(str(LARGEST))))
    assert written == 3.4028235e38

    @sh.program
    def largest(x: sh.Attrib1f):
        return sh.Attrib1f(3.4028235e38) + x, -sh.Attrib1f(written), x * 0 - 3.4028235e38

    found = largest.compile(backend)(0.0)
    assert [np.float32(y) for y in found] == [LARGEST, -LARGEST, -LARGEST]


def test_what_rounds_to_infinity_is_out_of_range():
    half = 2.0**128 - 2.0**103  # halfway to the next power of two, which ties to even
    assert float(sh.Attrib1f(np.nextafter(half, 0))) == LARGEST
    assert float(sh.Attrib1h(65519.99)) == 65504
    assert sh.Param(sh.Attrib1f, 3.4028235e38).value == LARGEST
    for cls, number in ((sh.Attrib1f, half), (sh.Attrib1f, -half), (sh.Attrib1h, 65520.0), (sh.Attrib1d, 2**1024)):
        with pytest.raises(sh.ShpyTypeError, match="is out of the range of"):
            cls(number)


@pytest.mark.parametrize("form", [np.array, list, lambda x: x[0], lambda x: np.array(x, np.longdouble)])
def test_a_number_that_no_float_holds_is_an_error(form):
    with pytest.raises(sh.ShpyTypeError) as caught:
        same(form([1e300]))
    assert caught.value.message == "x holds 1e+300, out of the range of floats of 32 bits"
    assert caught.value.loc.file == __file__
    assert np.asarray(same.compile(precision="f64")(form([1e300]))).item() == 1e300
    with pytest.raises(sh.ShpyTypeError, match=r"x holds 1e\+300, out of the range of floats of 32 bits"):
        same.compile(precision="f16")(form([1e300]))
    assert np.asarray(same.compile(precision="f16")(form([70000.0]))).item() == np.inf  # as f16 rounds its results


@pytest.mark.parametrize("number", [65520.0, -70000.0, np.float32(3e38)])
def test_a_constant_that_f16_does_not_hold_is_an_error_at_its_line(number):
    @sh.program
    def scaled(v: sh.Attrib3f) -> sh.Attrib3f:
        return v * sh.Attrib3f(1, number, 2)

    assert np.isfinite(scaled([1.0, 1.0, 1.0])).all()
    with pytest.raises(sh.CompileError) as caught:
        scaled.compile("numpy", precision="f16")
    assert caught.value.message == f"{float(number)} is out of the range of f at precision f16"
    assert caught.value.cure == "float('inf') if infinity is meant, or precision=\"f32\""
    line = linecache.getline(caught.value.loc.file, caught.value.loc.line)
    assert line == "        return v * sh.Attrib3f(1, number, 2)\n"


def test_f16_takes_constants_that_it_holds_and_infinity():
    sky = sh.Param(sh.Attrib1f, 70000.0)

    @sh.program
    def ends(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f, sh.Attrib1f, sh.Attrib1f]:
        bits = sh.float_from_bits(sh.Attrib1u(0x7F000000))  # a conversion rounds, as data do
        return x + float("inf"), x + 65519.0, x + sky, x + bits

    assert [float(y) for y in ends.compile("numpy", precision="f16")(0.0)] == [np.inf, 65504, np.inf, np.inf]


def test_numbers_are_rounded_to_f16_once():
    above = 1 + 2.0**-11 + 2.0**-40  # the middle between two binary16 numbers, and a little more: binary32 loses it
    table = sh.Table([above], sh.Attrib1f)

    @sh.program
    def looked_up(x: sh.Attrib1f = above) -> tuple[sh.Attrib1f, sh.Attrib1f]:
        return x, table[0]

    for backend in ("numpy", "opencl", "glsl"):
        kernel = looked_up.compile(backend, precision="f16")
        with np.errstate(all="raise"):
            result = kernel([1e-6, 1e-9, 1e6])[0]
        assert result.tolist() == np.float16([1e-6, 0, np.inf]).tolist()
        for found in (*kernel([above]), *kernel(shape=1), *kernel(np.full(3, above)), *kernel(above)):
            assert np.all(found == np.float16(above))
    assert np.float16(above) == 1 + 2.0**-10


def test_infinities_and_what_rounds_down_are_kept():
    given = np.array([np.inf, -np.inf, np.nan, 3.4028235e38, 1e-60, -0.0])
    with np.errstate(all="raise"):
        found = same(given)
    np.testing.assert_array_equal(found, [np.inf, -np.inf, np.nan, LARGEST, 0, 0])
    assert np.signbit(found[-1])


def test_streams_and_tables_hold_no_infinity_that_was_not_given():
    with pytest.raises(sh.ShpyTypeError, match=r"a stream holds 1e\+300, out of the range of floats of 32 bits"):
        sh.Stream(np.array([1.0, 1e300]), sh.Attrib1f, "numpy")
    wide = sh.Table([1.0, 1e300], sh.Attrib1f)

    @sh.program
    def read(i: sh.Attrib1i) -> sh.Attrib1f:
        return wide[i]

    assert read.compile(precision="f64")([1]) == [1e300]
    with pytest.raises(sh.ShpyTypeError, match=r"the Table wide holds 1e\+300, out of the range"):
        read([0])
    wide.update([1.0, 2.0])
    assert read([1]) == [2]


@pytest.mark.parametrize("x", [True, [True, False], np.array([True])])
@pytest.mark.parametrize("program", [same, counted, unsigned])
def test_the_cure_for_a_bool_is_accepted(program, x):
    with pytest.raises(sh.ShpyTypeError, match=r"takes (floats|ints|unsigned ints), not bool") as caught:
        program(x)
    found = program(eval(caught.value.cure, {"np": np, "x": x}))
    np.testing.assert_array_equal(found, np.asarray(x, int))


@pytest.mark.parametrize("x", [2.0, [2.0, 3.4], np.array([2.0], np.float32)])
@pytest.mark.parametrize("program", [counted, unsigned])
def test_the_cure_for_a_float_is_accepted(program, x):
    with pytest.raises(sh.ShpyTypeError, match="not float") as caught:
        program(x)
    np.testing.assert_array_equal(program(eval(caught.value.cure, {"np": np, "x": x})), np.rint(x))


@pytest.mark.parametrize("x", [2, 0.5, [1, 0], np.array([1.5, 0])])
def test_the_cure_for_a_number_given_for_a_bool_is_accepted(x):
    with pytest.raises(sh.ShpyTypeError, match="takes bools, not") as caught:
        held(x)
    np.testing.assert_array_equal(held(eval(caught.value.cure, {"np": np, "x": x})), np.asarray(x) != 0)


def test_a_call_with_an_option_of_compile_names_compile():
    with pytest.raises(sh.ShpyTypeError) as caught:
        same(2.0, backend="numpy")
    assert caught.value.message == "backend is no input of same"
    assert caught.value.cure == "same.compile(backend='numpy')(x)"
    for option in ("device", "precision", "math", "lanes", "loop_limit"):
        with pytest.raises(sh.ShpyTypeError) as caught:
            same(2.0, **{option: 1})
        assert caught.value.cure == f"same.compile({option}=1)(x)"


def test_an_error_of_the_command_line_names_no_line_of_its_own_start(monkeypatch):
    monkeypatch.setattr(location, "main", location.here, raising=False)
    assert location.here().file == __file__
    assert shpy_start.start("shpy", "shpy.lang.recording.location") is None


def test_the_length_of_an_array_is_an_int_of_python_or_numpy():
    @sh.program
    def lengths(x: sh.Attrib1i) -> tuple[sh.Attrib1i, sh.Attrib1i]:
        return len(sh.Array(sh.Attrib1i, np.int64(3))), len(sh.Array(sh.Attrib1i, np.uint8(5)))

    assert lengths(0) == (3, 5)


@pytest.mark.parametrize("length", [3.0, np.float32(3), True, None, np.array(3)])
def test_what_is_no_length_of_an_array_is_refused(length):
    with pytest.raises(sh.ShpyTypeError, match=r"an Array is an int that is known while recording, not"):

        @sh.program
        def wrong(x: sh.Attrib1f) -> sh.Attrib1f:
            return sh.Array(sh.Attrib1f, length)[0] + x


def test_a_length_that_is_computed_is_refused():
    with pytest.raises(sh.ShpyTypeError, match=r"an Array is an int that is known while recording, not"):

        @sh.program
        def wrong(n: sh.Attrib1i) -> sh.Attrib1f:
            return sh.Array(sh.Attrib1f, n)[0]


def test_ints_of_more_than_64_bits_are_floats():
    assert same(2**64) == same([2**64, -(2**100)])[0] == 2.0**64
    assert np.asarray(sh.Stream([2**64], sh.Attrib1f, backend="numpy"))[0] == 2.0**64
    for number, what in ((2**200, "out of the range of floats of 32 bits"), (10**400, "an int out of the range of")):
        with pytest.raises(sh.ShpyTypeError, match=what):
            same(number)


def test_ints_of_more_than_64_bits_are_out_of_the_range_of_ints():
    @sh.program
    def count(n: sh.Attrib1i) -> sh.Attrib1i:
        return n

    with pytest.raises(sh.ShpyTypeError, match=f"n holds {2**64}, out of the range of ints of 32 bits"):
        count([1, 2**64])
