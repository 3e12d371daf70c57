"""`g << f`: which output goes to which input; inputs that are places in arrays stay in programs of programs."""

from typing import NamedTuple

import numpy as np
import pytest

import shpy as sh


class Place(NamedTuple):
    position: sh.Point3f
    height: sh.Attrib1f


class Three(NamedTuple):
    b: sh.Attrib1f
    a: sh.Attrib1f
    extra: sh.Attrib1f


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


@sh.program
def three(x: sh.Attrib1f) -> Three:
    return Three(x, x + 1000, x * 0 + 7)


@sh.program
def minus(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a - b


@sh.program
def place(x: sh.Attrib1f) -> Place:
    return Place(sh.Point3f(x, x + 1, x + 2), x * 10)


@sh.program
def ray_of(x: sh.Attrib1f) -> Ray:
    return Ray(sh.Point3f(x, 0, 0), sh.Vector3f(0, x, 0))


@sh.program
def pair(x: sh.Attrib1f):
    return x, x + 10


def error_of(join):
    with pytest.raises(sh.ShpyTypeError) as caught:
        join()
    assert caught.value.loc.file == __file__
    return str(caught.value).partition(": ")[2]


def test_an_output_more_does_not_change_what_names_mean():
    joined = minus << three
    assert list(joined.inputs) == ["x"]
    difference, extra = joined(1)
    assert (difference, extra) == (1000, 7)
    assert list(joined.outputs) == ["0", "1"]


@pytest.mark.parametrize("options", [("numpy", "auto"), ("opencl", 1), ("opencl", 8), ("glsl", "auto")], ids=str)
def test_names_join_alike_on_every_backend(options):
    backend, lanes = options
    difference, extra = (minus << three).compile(backend, lanes=lanes)([1, 2, 5])
    assert difference.tolist() == [1000, 1000, 1000]
    assert extra.tolist() == [7, 7, 7]


def test_outputs_without_names_go_by_position():
    joined = minus << pair
    assert joined(1) == -10

    @sh.program
    def one(a: sh.Attrib1f) -> sh.Attrib1f:
        return a * 2

    assert [float(v) for v in (one << pair)(1)] == [2, 11]
    assert list((minus << one).inputs) == ["a", "b"]
    assert (minus << one)(3, 5) == 1


def test_names_that_all_miss_go_by_position():
    @sh.program
    def scaled(p: sh.Point3f, by: sh.Attrib1f) -> sh.Attrib3f:
        return p * by

    assert (scaled << place)(1).tolist() == [10, 20, 30]


def test_other_inputs_follow_under_free_names():
    @sh.program
    def lit(x: sh.Color3f, position: sh.Point3f) -> sh.Color3f:
        return x + position

    joined = lit << place
    assert joined.inputs == {"x": sh.Attrib1f, "x_2": sh.Color3f}
    color, height = joined(1, (10, 20, 30))
    assert color.tolist() == [11, 22, 33]
    assert height == 10


def test_both_ways_at_once_is_an_error():
    @sh.program
    def lit(position: sh.Point3f, gain: sh.Attrib1f) -> sh.Attrib3f:
        return position * gain

    assert error_of(lambda: lit << place) == (
        "lit << place can be read in two ways: by name, height is no input of lit; by position it could be gain: "
        "place(x: Attrib1f) -> (position: Point3f, height: Attrib1f) goes into "
        "lit(position: Point3f, gain: Attrib1f) -> Attrib3f\n"
        "  write instead: place.rename(height='gain') to join the two, or, to keep them apart, a program that calls "
        "place and lit"
    )
    joined = lit << place.rename(height="gain")
    assert joined(1).tolist() == [10, 20, 30]


def test_an_output_left_over_may_have_another_type_than_the_inputs_left_over():
    @sh.program
    def lit(gain: sh.Attrib2f, position: sh.Point3f) -> sh.Attrib3f:
        return position * gain.x

    joined = lit << place
    assert list(joined.inputs) == ["x", "gain"]
    color, height = joined(1, (2, 0))
    assert (color.tolist(), height) == ([2, 4, 6], 10)


def test_kinds_mix_and_types_widen():
    @sh.program
    def measured(position: sh.Vector3f, height: sh.Attrib1d) -> sh.Attrib1d:
        return position.x + height

    assert (measured << place)(1) == 11

    @sh.program
    def counted(x: sh.Attrib1i) -> sh.Attrib1i:
        return x + 1

    @sh.program
    def grey(c: sh.Color3f) -> sh.Color3f:
        return c / 2

    assert (grey << counted)(3).tolist() == [2, 2, 2]


@pytest.mark.parametrize("name", ["position", "other"])
def test_types_that_do_not_fit_are_named(name):
    @sh.program
    def flat(position: sh.Attrib2f) -> sh.Attrib1f:
        return position.x

    g = flat if name == "position" else flat.rename(position="other")
    assert error_of(lambda: g << place).startswith(
        f"the output position of place is a Point3f and cannot be the input {name} of flat, an Attrib2f: "
        f"place(x: Attrib1f) -> (position: Point3f, height: Attrib1f) goes into flat({name}: Attrib2f) -> Attrib1f\n"
    )

    @sh.program
    def whole(i: sh.Attrib1i) -> sh.Attrib1i:
        return i

    assert "an output of minus is an Attrib1f and cannot be the input i of whole, an Attrib1i" in error_of(
        lambda: whole << minus
    )


def test_a_struct_goes_by_its_fields_or_as_a_whole():
    @sh.program
    def along(d: sh.Vector3f, o: sh.Point3f, t: sh.Attrib1f) -> sh.Point3f:
        return o + d * t

    assert (along << ray_of)(2, 3).tolist() == [2, 6, 0]

    @sh.program
    def turned(ray: Ray, t: sh.Attrib1f) -> Ray:
        return Ray(ray.o + ray.d * t, -ray.d)

    again = along << turned << ray_of
    assert list(again.inputs) == ["x", "t", "t_2"]
    assert again(2, 3, 1).tolist() == [2, 4, 0]

    @sh.program
    def origin(o: sh.Point3f) -> sh.Attrib1f:
        return o.x

    found = (origin << ray_of)(2)
    assert (float(found[0]), found[1].tolist()) == (2, [0, 2, 0])

    @sh.program
    def bent(p: sh.Point3f, q: sh.Vector3f) -> sh.Point3f:
        return p + q

    assert (bent << ray_of)(2).tolist() == [2, 2, 0]


def test_a_struct_that_fits_as_a_whole_and_by_a_field_is_an_error():
    @sh.program
    def mixed(ray: Ray, d: sh.Vector3f) -> sh.Attrib1f:
        return sh.dot(ray.d, d)

    assert error_of(lambda: mixed << ray_of).startswith(
        "mixed << ray_of can be read in two ways: all of it could be ray, and a part of it is named as an input: "
        "ray_of(x: Attrib1f) -> (o: Point3f, d: Vector3f) goes into mixed(ray: Ray, d: Vector3f) -> Attrib1f\n"
    )
    assert list((mixed.rename(d="axis") << ray_of).inputs) == ["x", "axis"]


def test_tables_are_no_inputs_that_outputs_go_to():
    @sh.program
    def looked_up(height: sh.Table[sh.Attrib1f], i: sh.Attrib1i) -> sh.Attrib1f:
        return height[i]

    @sh.program
    def index(x: sh.Attrib1f) -> sh.Attrib1i:
        return sh.Attrib1i(x)

    joined = looked_up << index
    assert list(joined.inputs) == ["x", "height"]
    assert joined(1.5, np.array([5.0, 6.0])) == 6


def test_fields_of_a_struct_can_be_renamed():
    renamed = ray_of.rename(o="position", x="at")
    assert list(renamed.inputs) == ["at"]
    assert list(renamed.outputs) == ["position", "d"]
    assert renamed(2).position.tolist() == [2, 0, 0]
    with pytest.raises(sh.ShpyTypeError, match="two outputs would have one name"):
        ray_of.rename(o="d")


def test_errors_of_a_called_program_name_the_users_line_and_a_type_as_it_is_written():
    @sh.struct
    class Ray:
        o: sh.Attrib1f

    @sh.program
    def first(rays: sh.Table[Ray]) -> sh.Attrib1f:
        return rays[0].o

    def other(rays: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
        return first(rays)

    with pytest.raises(sh.ShpyTypeError, match=r"the input rays is a Table\[Ray, 1\]") as caught:
        sh.program(other)
    assert caught.value.loc is not None
    assert (caught.value.loc.file, caught.value.loc.line) == (__file__, other.__code__.co_firstlineno + 1)
    assert caught.value.cure == "sh.Table(array, Ray)"


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("n", 2.5, "the input n: it takes ints, not 2.5"),
        ("n", True, "the input n: it takes ints, not True"),
        ("v", (1, 2.5), "the input v: it takes ints, not 2.5"),
        ("b", 1, "the input b: it takes bools, not 1"),
        ("x", False, "the input x: it takes numbers, not False"),
    ],
)
def test_a_specialised_input_takes_what_a_run_takes(name, value, message):
    @sh.program
    def given(n: sh.Attrib1i, v: sh.Attrib2u, b: sh.Attrib1b, x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.cond(b, x * n, x + v.x)

    with pytest.raises(sh.ShpyTypeError, match=message) as caught:
        given.specialize(**{name: value})
    assert caught.value.loc.file == __file__
    with pytest.raises(sh.ShpyTypeError):
        given.bind(**{name: value})
    assert given.specialize(n=np.int64(2), b=np.True_, x=1)((3, 4)) == 2


def test_an_input_that_is_a_place_in_an_array_stays_in_joined_programs():
    @sh.program
    def picked(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
        own = sh.Array(sh.Attrib1f, 3)
        own[1] = x
        own[2] = 10
        return own[n]

    @sh.program
    def place(k: sh.Attrib1i) -> sh.Attrib1i:
        return k

    x, n = np.float32([1, 2, 3]), np.int32([0, 1, 2])
    assert picked(x, n).tolist() == [0, 2, 10]
    assert picked.specialize(x=2)(n).tolist() == [0, 2, 10]
    assert picked.bind(x=2)(n).tolist() == [0, 2, 10]
    assert picked.rename(n="m")(x, n).tolist() == [0, 2, 10]
    assert (picked.specialize(x=2) << place)(n).tolist() == [0, 2, 10]
