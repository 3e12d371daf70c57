"""Cures for host arrays, and what an index or a hash takes."""

import inspect
import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

import shpy as sh


@sh.program
def tinted(pixel: sh.Color3f) -> sh.Color3f:
    return pixel * 2


@pytest.mark.parametrize(
    ("shape", "cure"),
    [
        ((4, 4, 4), "pixel[..., :3], which drops the alpha channel"),
        ((8, 5), "np.stack([pixel] * 3, axis=-1), a picture of grey"),
        ((8, 5, 1), "np.stack([pixel[..., 0]] * 3, axis=-1), a picture of grey"),
        ((3, 4, 4, 2), "np.moveaxis(pixel, 0, -1)"),
        ((12,), "np.asarray(pixel).reshape(-1, 3)"),
        ((4, 4), "pixel[..., :3], which drops the alpha channel"),
        ((7,), "an array whose last axis has 3 components"),
        ((), "an array whose last axis has 3 components"),
    ],
)
def test_an_array_of_other_components_is_not_told_to_scramble_them(shape, cure):
    with pytest.raises(sh.ShpyTypeError, match="pixel is a Color3f and takes an array") as caught:
        tinted(np.zeros(shape))
    assert caught.value.cure == cure


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_an_array_takes_a_u_as_its_index(backend):
    @sh.program
    def picked(u: sh.Attrib1u) -> sh.Attrib1f:
        a = sh.Array(sh.Attrib1f, [1, 2, 3, 4])
        a[u] = a[u] + 10
        return a[u] + a[sh.Attrib1u(0)]

    # Out of range: a store is dropped, a read gives the last, beyond i's range too.
    expected = [22, 13, 15, 5, 5]
    assert picked.compile(backend)(np.array([0, 1, 3, 4, 2**32 - 1], np.uint32)).tolist() == expected


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_hash_takes_an_i_which_wraps(backend):
    @sh.program
    def both(i: sh.Attrib1i) -> tuple[sh.Attrib1u, sh.Attrib1u, sh.Attrib1u]:
        return sh.hash(i), sh.hash(sh.Attrib1u(i), i), sh.hash(-1, 2)

    i = np.array([0, 5, -1, -(2**31)], np.int32)
    first, second, third = both.compile(backend)(i)
    words = [int(k) % 2**32 for k in i]
    assert first.tolist() == [int(np.asarray(sh.hash(w))) for w in words]
    assert second.tolist() == [int(np.asarray(sh.hash(w, w))) for w in words]
    assert set(third.tolist()) == {int(np.asarray(sh.hash(2**32 - 1, 2)))}


def test_names_of_shpy_and_of_values_can_be_asked_for():
    assert not hasattr(sh, "lerp")
    assert not hasattr(sh.vec3(1), "length")
    assert not hasattr(sh.Matrix3f(), "T")
    assert f"{sh.Attrib1f(0.5):.2f} {sh.vec2(1, 2)}" == "0.50 Attrib2f(1.0, 2.0)"
    assert divmod(sh.Attrib1i(-7), 2)[0].x + 4 == 0
    with pytest.raises(sh.ShpyAttributeError, match=r"shpy has no 'vec5'") as caught:
        sh.vec5  # noqa: B018
    assert caught.value.cure


@pytest.mark.parametrize(
    ("name", "result"),
    [
        ("fmax", "sh.max(2, 3)"),
        ("sqr", "4"),
        ("mad24", "11"),
        ("tanpi", "0"),
        ("pow10", "100"),
        ("ln_1p", "sh.log(3)"),
        ("cot", "1 / sh.tan(2)"),
        ("as_int", "2**30"),
        ("floatBitsToInt", "sh.Attrib1i(2**30)"),
        ("intBitsToFloat", "sh.float_from_bits(7)"),
        ("ilogb", "1"),
        ("dvec2", "sh.Attrib2d"),
        ("half3", "sh.Attrib3h"),
        ("vec4u", "sh.uvec4"),
        ("Point3", "sh.Point3f"),
        ("Color", "sh.Color3f"),
        ("normal", "sh.Normal3f"),
        ("SH_ELSEIF", "sh.SH_ELIF"),
    ],
)
def test_names_of_other_languages_have_cures_of_the_same_meaning(name, result):
    with pytest.raises(sh.ShpyAttributeError) as caught:
        getattr(sh, name)
    names = {"sh": sh, "math": math, "x": sh.Attrib1f(2), "a": 2, "b": 3, "c": 5, "i": sh.Attrib1i(7)}
    cure, wanted = eval(caught.value.cure.removesuffix("(c)"), names), eval(result, names)
    assert cure is wanted or np.asarray(cure) == np.asarray(wanted)


PICTURE = sh.Texture2D(np.zeros((2, 2, 3)))
NUMBERS = sh.Table([1.0, 2.0, 3.0], sh.Attrib1f)


def set_by_index(x: sh.Attrib1f, i: sh.Attrib1i) -> sh.Attrib1f:
    both = {1.0, 2.0}
    return both[i]  # here


def dict_by_value(x: sh.Attrib1f, i: sh.Attrib1i) -> sh.Attrib1f:
    return {0: 1.0, 1: 2.0}[i]  # here


def called_size(v: sh.Attrib3f) -> sh.Attrib1f:
    return v.x * v.size()  # here


def called_table(i: sh.Attrib1i) -> sh.Attrib1f:
    return NUMBERS(i)  # here


def called_array(i: sh.Attrib1i) -> sh.Attrib1f:
    a = sh.Array(sh.Attrib1f, 4)
    return a(i)  # here


def called_value(v: sh.Attrib3f) -> sh.Attrib3f:
    return v(v + 1)  # here


def called_matrix(m: sh.Matrix3f) -> sh.Attrib1f:
    return m(0, 1)  # here


def summed_array(x: sh.Attrib1f) -> sh.Attrib1f:
    a = sh.Array(sh.Attrib1f, 4)
    a[0] = x
    return a.sum()  # here


def summed_table(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * NUMBERS.sum()  # here


def with_a_fraction(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * Fraction(1, 3)  # here


def decimal_from(x: sh.Attrib1f) -> sh.Attrib1f:
    return Decimal("0.1") - x  # here


def sampled(uv: sh.TexCoord2f) -> sh.Color3f:
    return PICTURE.sample(uv)  # here


def indexed_texture(uv: sh.TexCoord2f, picture: sh.Texture2D[sh.Color3f]) -> sh.Color3f:
    return picture[0, 0]  # here


def with_two_coordinates(x: sh.Attrib1f) -> sh.Color3f:
    return PICTURE(x, 0.5)  # here


def summed_by_numpy(v: sh.Attrib3f) -> sh.Attrib1f:
    return np.sum(v)  # here


@pytest.mark.parametrize(
    ("function", "said", "cure"),
    [
        (set_by_index, "is a set, which has no order", "sh.Array(sh.Attrib1f, [a, b])[i]"),
        (dict_by_value, "this Attrib1i is known only when the program runs", "sh.cond(i == 0, a, b)"),
        (called_size, "v.size is no method", "v.size, or len(v)"),
        (called_table, "this Table is read by an index, not called", "table[i]"),
        (called_array, "this Array is read by an index, not called", "array[i]"),
        (called_value, "this Attrib3f is a value, which nothing can call", "a * (b + c)"),
        (called_matrix, "this Matrix3f is read by an index, not called", "m[r, c]"),
        (summed_array, "'Array' object has no attribute 'sum'", "with SH_FOR(0, len(a)) as i"),
        (summed_table, "'Table' object has no attribute 'sum'", "with SH_FOR(0, NUMBERS.shape[0]) as i"),
        (with_a_fraction, "* cannot take Fraction", "float(…), the nearest number that Python's float has"),
        (decimal_from, "- cannot take Decimal", "float(…), the nearest number that Python's float has"),
        (sampled, "'Texture2D' object has no attribute 'sample'", "PICTURE(uv)"),
        (indexed_texture, "this Texture2D is read at coordinates, not by an index", "texture(uv); sh.Table("),
        (with_two_coordinates, "a texture is read at one place of 2 coordinates", "PICTURE((u, v))"),
        (summed_by_numpy, "numpy's functions cannot take values", "sh.sin(x) for np.sin(x)"),
    ],
)
def test_what_python_raises_is_told_at_the_users_line(function, said, cure):
    with pytest.raises(sh.ShpyError) as caught:
        sh.program(function)
    assert said in caught.value.message
    assert cure in caught.value.cure
    lines = inspect.getsource(function).splitlines()
    line = function.__code__.co_firstlineno + next(n for n, text in enumerate(lines) if text.endswith("# here"))
    assert (caught.value.loc.file, caught.value.loc.line) == (__file__, line)


def test_the_users_own_errors_stay_as_they_are():
    class Thing:
        pass

    def own(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * Thing().weight

    with pytest.raises(AttributeError, match="'Thing' object has no attribute 'weight'") as caught:
        sh.program(own)
    assert not isinstance(caught.value, sh.ShpyError)
