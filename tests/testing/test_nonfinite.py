"""first_nan: which element, which operation, its operands and iterations, on backends and in generated programs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings

import shpy as sh
from shpy import SH_DISCARD, SH_FOR, SH_IF

X = np.linspace(-3, 3, 7)


@sh.subroutine
def unit(v: sh.Vector3f) -> sh.Vector3f:
    return v / sh.sqrt(sh.dot(v, v))


@sh.program
def steps(x: sh.Attrib1f, y: sh.Attrib1f = 2) -> tuple[sh.Attrib1f, sh.Vector3f]:
    least = sh.Attrib1f(np.inf)
    with SH_FOR(0, 3) as i:
        with SH_IF(x < least):
            least[:] = x
        y += sh.sqrt(x - 2 + sh.Attrib1f(i))
    return least + y, unit(sh.Vector3f(x, 0, 0))


@pytest.mark.sampled(6)
@pytest.mark.parametrize("backend", ["numpy", "opencl-4", "opencl-16", "glsl", "interpreter"])
def test_the_first_nan_has_its_line_operands_and_iteration(backend):
    first = sh.testing.first_nan(steps, X, backend=backend)
    assert (first.kind, first.element, first.inputs["x"]) == ("nan", (0,), -3)
    assert "y += sh.sqrt(x - 2 + sh.Attrib1f(i))" in str(first)
    assert first.text.startswith("sqrt(")
    assert np.isnan(first.value)
    assert list(first.operands.values()) == [-5]
    assert first.iterations == (1,)
    assert "in iteration 1 of the loop at " in str(first)


def test_an_element_of_its_own_and_a_later_iteration():
    first = sh.testing.first_nan(steps, [1.5, 0.5], element=1)
    assert first.element == (1,)
    assert list(first.operands.values()) == [-1.5]
    assert first.iterations == (1,)
    assert sh.testing.first_nan(steps, X, element=5) is None
    with pytest.raises(sh.ShpyIndexError, match="element 7 of a run over 7"):
        sh.testing.first_nan(steps, X, element=7)


def test_nan_of_a_subroutine_is_at_its_line():
    @sh.program
    def direction(v: sh.Vector3f) -> sh.Vector3f:
        return unit(v)

    first = sh.testing.first_nan(direction, np.zeros((2, 3)))
    assert "return v / sh.sqrt(sh.dot(v, v))" in str(first)
    assert first.text.startswith("div(")


def test_infinity_that_reaches_an_output_and_infinity_that_does_not():
    first = sh.testing.first_nan(steps, np.float32([3e38]), 3e38)
    assert first.kind == "infinite"
    assert "return least + y" in str(first)
    assert "add(" in first.text
    assert [f"{v:.0e}" for v in first.operands.values()] == ["3e+38", "3e+38"]
    assert sh.testing.first_nan(steps, [3]) is None  # least begins as infinity


def test_nan_that_an_input_has_is_no_operation():
    first = sh.testing.first_nan(steps, [np.nan, 4])
    assert first.loc is None
    assert "no operation gave first: an input, a Param or a constant has it" in str(first)


def test_discarded_elements_and_integers_do_not_count():
    @sh.program
    def root(x: sh.Attrib1f, n: sh.Attrib1i) -> tuple[sh.Attrib1f, sh.Attrib1i]:
        SH_DISCARD(x < 0)
        return sh.sqrt(x), n

    assert sh.testing.first_nan(root, [-1, 4], 3) is None


def test_overflow_at_a_narrow_precision():
    @sh.program
    def square(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * x

    assert sh.testing.first_nan(square, [300]) is None
    assert sh.testing.first_nan(square, [300], precision="f16").kind == "infinite"


def test_the_entry_of_a_table_and_an_element_of_an_array():
    heights = sh.Table(np.float32([1, np.nan]), sh.Attrib1f, name="heights")

    @sh.program
    def read(n: sh.Attrib1i, x: sh.Attrib1f) -> sh.Attrib2f:
        pair = sh.Array(sh.Attrib1f, 2)
        pair[n] = sh.sqrt(x)
        return sh.Attrib2f(pair[n], heights[n])

    assert sh.testing.first_nan(read, [0, 0], 4) is None
    entry = sh.testing.first_nan(read, [0, 1], 4)
    assert (entry.element, entry.operands) == ((1,), {"n": 1})
    assert "heights" in entry.text
    root = sh.testing.first_nan(read, [0, 0], [4, -4])
    assert root.element == (1,)
    assert root.text.startswith("sqrt(")


@settings(
    max_examples=4,
    deadline=None,
    database=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.generate],  # a program that fails is printed as it is: shrinking takes minutes
)
@given(sh.testing.programs())
def test_generated_programs_have_the_same_first_event_on_numpy_and_in_the_interpreter(program):
    arrays = sh.testing.inputs(program, 6)
    first = sh.testing.first_nan(program, *arrays)
    other = sh.testing.first_nan(program, *arrays, backend="interpreter")
    assert (first is None) == (other is None)
    if first is not None:
        assert (first.kind, first.element, first.loc, first.text) == (other.kind, other.element, other.loc, other.text)
        assert first.iterations == other.iterations


@sh.program
def sharpen(u: sh.Table[sh.Attrib1f], pass_: sh.Attrib1i) -> sh.Attrib1f:
    i = sh.grid_index(1)
    return sh.sqrt(u[i - 1] + u[i + 1] - u[i] + 0 * sh.Attrib1f(pass_))


def passes(times: int) -> sh.Chain:
    return sh.repeat(sharpen, times, index="pass_")


@pytest.mark.parametrize("seed", range(3))
def test_the_run_of_a_chain_is_the_first_after_which_its_streams_have_nan(seed):
    u = np.random.default_rng(seed).uniform(4, 8, 6).astype(np.float32)
    first = sh.testing.first_nan(passes(40), u=u, shape=6)
    states = [passes(times).run(u=u, shape=6).streams["u"].numpy() for times in (first.run - 1, first.run)]
    assert not np.isnan(states[0]).any()
    assert (first.program, first.element) == ("sharpen", (int(np.argmax(np.isnan(states[1]))),))
    assert first.inputs == {"pass_": first.run - 1}
    assert first.text.startswith("sqrt(")
    assert f"sharpen on numpy, run {first.run}, element {first.element[0]}: NaN at " in str(first)


@sh.struct
class Body:
    place: sh.Point2f
    speed: sh.Attrib1f


@sh.program
def move(body: Body, dt: sh.Attrib1f) -> Body:
    return Body(body.place + sh.Vector2f(dt * body.speed, 0), body.speed / (1 - body.place.x))


@sh.program
def halve(x: sh.Attrib1f) -> sh.Attrib1f:
    SH_DISCARD(~(x >= 1))
    return x / 2


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_chains_of_structs_with_conditions_run_on_every_backend(backend):
    @sh.program
    def near(body: Body) -> sh.Attrib1b:
        return body.place.x < 2

    bodies = {"place": [[3, 0], [0, 0], [0.5, 0]], "speed": [1, 0.25, 0.5]}
    chain = sh.sequence(halve, sh.repeat(move, 3, where=near))
    first = sh.testing.first_nan(chain, body=bodies, dt=1, x=[0, 8, 1], backend=backend)
    assert (first.kind, first.program, first.run, first.element) == ("infinite", "move", 2, (2,))
    assert first.text.startswith("div(")
    assert first.inputs["body.speed"] == 1
    assert sh.testing.first_nan(chain, body=bodies, dt=1, x=[0, 8, 1], backend=backend, element=0) is None


def test_a_stream_that_has_nan_before_a_chain_and_one_that_a_kernel_copies():
    first = sh.testing.first_nan(sh.loop(halve), x=[8, np.nan, 3])
    assert (first.run, first.element, first.loc) == (1, (1,), None)
    assert sh.testing.first_nan(sh.loop(halve), x=[8, 2, 3]) is None
    read = sh.testing.first_nan(passes(2), u=[4, 5, np.nan, 5], shape=4)
    assert (read.run, read.element) == (1, (1,))
    assert "table u" in read.text


def test_a_kernel_in_a_chain_is_searched_with_its_options():
    @sh.program
    def square(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * x

    chain = sh.repeat(square.compile("numpy", precision="f16"), 4)
    first = sh.testing.first_nan(chain, x=[1, 3])
    assert (first.kind, first.run, first.element, first.value) == ("infinite", 4, (1,), np.inf)
    assert first.inputs == {"x": np.float16(6561)}
    assert sh.testing.first_nan(sh.repeat(square, 4), x=[1, 3]) is None
    assert sh.testing.first_nan(sh.repeat(square, 4), x=[1, 3], precision="f16").run == 4


def test_what_a_chain_does_not_have_is_an_error():
    with pytest.raises(sh.ShpyTypeError, match="takes its streams by name"):
        sh.testing.first_nan(sh.loop(halve), [1, 2])
    with pytest.raises(sh.ShpyIndexError, match="element 3 of a run over 3"):
        sh.testing.first_nan(sh.loop(halve), x=[1, 2, 3], element=3)
    with pytest.raises(sh.ShpyTypeError, match="y is no stream of loop"):
        sh.testing.first_nan(sh.loop(halve), y=[1, 2])
