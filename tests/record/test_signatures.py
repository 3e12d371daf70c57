"""Functions that can be programs, and their inputs: defaults, methods of classes, partials and lambdas."""

import copy
import dataclasses
import functools
import gc
import weakref

import numpy as np
import pytest

import shpy as sh
from shpy import SH_IF, SH_RETURN


def scaled(x: sh.Attrib1f, by: sh.Attrib1f = 2.0, *, to: sh.Color3f = (1, 0, 0)) -> sh.Color3f:
    return to * (x * by)


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_an_input_with_a_default_may_be_left_out(backend):
    kernel = sh.program(scaled).compile(backend)
    np.testing.assert_array_equal(kernel([1, 2]), [(2, 0, 0), (4, 0, 0)])
    np.testing.assert_array_equal(kernel([1, 2], [3, 4]), [(3, 0, 0), (8, 0, 0)])
    np.testing.assert_array_equal(kernel([1, 2], to=(0, 1, 1)), [(0, 2, 2), (0, 4, 4)])
    np.testing.assert_array_equal(kernel.run(1, by=5).outputs, (5, 0, 0))


def test_defaults_are_seen_and_checked_like_any_input():
    program = sh.program(scaled)
    assert list(program.inputs) == ["x", "by", "to"]
    assert repr(program) == "<Program scaled(x: Attrib1f, by: Attrib1f = 2.0, to: Color3f = (1, 0, 0)) -> Color3f>"
    assert str(program.trace(x=3.0)[-1].value) == "[6. 0. 0.]"
    with pytest.raises(sh.ShpyTypeError, match="scaled lacks its input x"):
        program(by=3)
    again = sh.Program.from_ir(sh.parse(str(program.ir)))  # the text says what runs, not how to call it
    with pytest.raises(sh.ShpyTypeError, match="scaled lacks its input by, to"):
        again(1)
    np.testing.assert_array_equal(again(1, 2, (1, 0, 0)), program(1))


def test_a_param_as_default_is_read_at_each_run():
    gain = sh.Param(sh.Attrib1f, 0.1)

    @sh.program
    def amplified(x: sh.Attrib1f, by: sh.Attrib1f = gain) -> sh.Attrib1f:
        return x * by

    assert amplified.compile("numpy", precision="f64")(1) == 0.1
    gain.value = 3
    assert amplified(2) == 6
    assert amplified(2, 5) == 10

    @sh.program
    def outer(x: sh.Attrib1f) -> sh.Attrib1f:
        return amplified(x) + amplified(x, by=1)

    assert list(outer.params) == ["gain"]
    assert outer(2) == 8
    gain.value = 4
    assert outer(2) == 10


def test_tables_structs_and_constants_as_defaults():
    @sh.struct
    class Ray:
        o: sh.Point3f
        d: sh.Vector3f

    steps = sh.Table([1.0, 2.0, 3.0], sh.Attrib1f)

    @sh.program
    def walk(
        i: sh.Attrib1i,
        ray: Ray = {"o": (0, 0, 0), "d": (0, 1, 0)},  # noqa: B006
        up: sh.Vector3f = sh.Vector3f(0, 0, 2),  # noqa: B008
        table: sh.Table[sh.Attrib1f] = steps,
        m: sh.Matrix2f = ((1, 2), (3, 4)),
    ) -> sh.Point3f:
        return ray.o + table[i] * ray.d + up * m[1, 1]

    assert walk(2).tolist() == [0, 3, 8]
    assert walk(2, table=[7.0]).tolist() == [0, 7, 8]
    steps.update([5, 5, 5])
    assert walk(2).tolist() == [0, 5, 8]
    assert sh.program(lambda: walk(0, up=(1, 1, 1)))().tolist() == [4, 9, 4]


def test_defaults_follow_their_inputs_through_the_algebra():
    @sh.program
    def scale(x: sh.Attrib1f, by: sh.Attrib1f = 3) -> sh.Attrib1f:
        return x * by

    @sh.program
    def shift(y: sh.Attrib1f, by: sh.Attrib1f = 10) -> sh.Attrib1f:
        return y + by

    both = shift << scale
    assert both(2) == 16
    assert both(2, 4, 5) == 13
    assert both(2, by_2=1) == 7
    assert (scale & shift)(2, y=1) == (6, 11)
    assert scale.merge(shift)(2, y=1) == (6, 4)  # an input that both have keeps the first one's default
    assert scale.rename(by="factor")(2) == 6
    assert scale.rename(by="factor")(2, factor=1) == 2
    assert scale.bind(by=7)(2) == scale.specialize(by=7)(2) == 14
    assert list(scale.bind(by=7).inputs) == ["x"]
    assert scale.bind(x=7)() == 21


@pytest.mark.parametrize(
    ("default", "message", "cure"),
    [
        (None, "the default of y is None, and y is annotated as an input", "y=None without an annotation"),
        ("a", "the default of y takes floats, not", ""),
        ((1, 2), r"the default of y is one Attrib1f, and has the shape \(2,\)", "one number"),
        (True, "the default of y takes floats, not bool", ""),
    ],
)
def test_a_default_that_is_no_value_of_its_input(default, message, cure):
    def case(x: sh.Attrib1f, y: sh.Attrib1f = default):
        return x * y

    with pytest.raises(sh.ShpyTypeError, match=message) as caught:
        sh.program(case)
    assert cure in caught.value.cure
    assert caught.value.loc.line == case.__code__.co_firstlineno


def test_what_is_known_while_recording_is_no_input():
    def power(x: sh.Attrib1f, k: sh.Attrib1f = 2.0, n=3, mode: str = "plain", up: sh.Attrib1f | None = None):
        assert (n, mode, up) in ((3, "plain", None), (4, "plain", None))
        return x**n * k

    assert list(sh.program(power).inputs) == ["x", "k"]
    assert list(sh.program(functools.partial(power, n=4, k=1.0)).inputs) == ["x"]
    assert sh.program(functools.partial(power, n=4, k=1.0))(2) == 16
    assert sh.program(lambda: sh.Attrib1f(3))() == 3


class Shader:
    """An object with a program, made anew for each."""

    def __init__(self, gain):
        self.gain = gain
        self.recorded = 0

    @sh.program
    def shade(self, x: sh.Attrib1f, bias: sh.Attrib1f = 1) -> sh.Attrib1f:
        """Shade x."""
        self.recorded += 1
        with SH_IF(x < 0):
            SH_RETURN(0)
        return self.gain * x + bias

    @sh.program
    def twice(self, x: sh.Attrib1f) -> sh.Attrib1f:
        return self.shade(self.shade(x))

    @staticmethod
    @sh.program
    def half(x: sh.Attrib1f) -> sh.Attrib1f:
        return x / 2

    @classmethod
    @sh.program
    def named(cls, x: sh.Attrib1f) -> sh.Attrib1f:
        return x * len(cls.__name__)

    @sh.program
    @staticmethod
    def third(x: sh.Attrib1f) -> sh.Attrib1f:
        return x / 3

    @sh.program
    @classmethod
    def spelled(cls, x: sh.Attrib1f) -> sh.Attrib1f:
        return x * len(cls.__name__)


def test_a_method_is_a_program_of_its_instance():
    one, three = Shader(1), Shader(3)
    assert three.shade([1, 2, -1]).tolist() == [4, 7, 0]
    assert one.shade([1, 2, -1]).tolist() == [2, 3, 0]
    assert three.shade is three.shade
    assert (one.recorded, three.recorded) == (1, 1)
    assert isinstance(three.shade, sh.Program)
    assert three.shade.compile("numpy")(2, bias=0) == 6
    assert (three.shade.name, three.shade.__doc__) == ("shade", "Shade x.")
    assert three.twice(1) == 13
    assert Shader.shade(three, 1) == 4
    assert (Shader.half(3), three.half(3), Shader.named(2)) == (1.5, 1.5, 12)


def test_a_class_method_is_a_program_of_its_class():
    """Python 3.13 and later call what is below `@classmethod` with the class; what is above it stays a Program."""

    class Longer(Shader):
        pass

    assert (Shader.third(3), Shader(1).third(6)) == (1, 2)
    assert (Shader.spelled(2), Shader(1).spelled(2), Longer.spelled(2), Longer.named(2)) == (12, 12, 12, 12)
    assert isinstance(Shader.spelled, sh.Program)
    assert Longer.spelled is Longer.spelled is not Shader.spelled
    assert Shader.spelled.compile("numpy")(2) == 12
    below = Shader.__dict__["named"].__func__
    assert below(Shader, 2) == 12
    with pytest.raises(AttributeError, match=r"recorded for each class: @sh\.program above @classmethod"):
        below.compile  # noqa: B018
    with pytest.raises(sh.RecordError, match="is given none as cls"):
        below(2)


def test_what_is_recorded_for_an_instance_goes_with_it_and_not_to_its_copies():
    three = Shader(3)
    assert three.shade(1) == 4
    assert list(vars(three)) == ["gain", "recorded"]
    other = copy.copy(three)
    other.gain = 5
    assert (three.shade(1), other.shade(1)) == (4, 6)
    gone = weakref.ref(three)
    held = Shader.__dict__["shade"]
    gc.collect()  # instances of other tests
    count = len(held._recordings)
    del three
    gc.collect()
    assert gone() is None
    assert len(held._recordings) == count - 1


def test_equal_and_unhashable_instances_have_their_own_programs():
    @dataclasses.dataclass
    class Gain:
        by: float

        @sh.program
        def apply(self, x: sh.Attrib1f) -> sh.Attrib1f:
            return x * self.by

    first, second = Gain(2), Gain(2)
    assert first == second
    assert first.apply is not second.apply
    second.by = 3
    assert (first.apply(1), second.apply(1), Gain(4).apply(1)) == (2, 2, 4)


def test_an_instance_that_cannot_be_held_is_recorded_anew_with_a_warning():
    class Gain:
        __slots__ = ("by",)

        @sh.program
        def apply(self, x: sh.Attrib1f) -> sh.Attrib1f:
            return x * self.by

    gain = Gain()
    gain.by = 2
    with pytest.warns(sh.ShpyWarning, match="apply is recorded anew each time .* a Gain cannot be referred to weakly"):
        assert gain.apply(3) == 6


def test_mistakes_with_methods():
    class Loop:
        @sh.program
        def again(self, x: sh.Attrib1f) -> sh.Attrib1f:
            return self.again(x)

        @staticmethod
        @sh.program
        def forgotten(x) -> sh.Attrib1f:
            return x

    with pytest.raises(sh.RecordError, match=r"Loop\.again calls itself: recursion cannot be recorded"):
        Loop().again(1)
    with pytest.raises(sh.RecordError, match=r"Loop\.forgotten is a method, .* given none as x") as caught:
        Loop.forgotten(1.0)
    assert "x: sh.Attrib1f, if x is an input" in caught.value.cure
    with pytest.raises(AttributeError, match=r"Loop\.again is recorded for each instance: instance\.again\.compile"):
        Loop.again.compile("numpy")


@pytest.mark.parametrize("thing", [3, None, int, "x", max, ()])
def test_what_is_no_function_with_a_signature_is_refused(thing):
    with pytest.raises(sh.ShpyTypeError, match=r"sh\.program takes a function, not ") as caught:
        sh.program(thing)
    assert caught.value.loc.file == __file__
