"""Programs of derivatives, `sh.jvp` and `sh.jacobian`, precisions, streams and chains, immediate mode, and errors."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import SH_ELIF, SH_FOR, SH_IF, SH_RETURN, SH_WHILE
from tests.backends.running import TARGETS, differs, run

GAIN = sh.Param(sh.Attrib1f, 2.0, name="gain")
SQUARE = GAIN * GAIN
LIGHT = sh.Param(sh.Vector3f, (0, 0.6, 0.8), name="light")
TURN = sh.Param(sh.Matrix3f, np.eye(3), name="turn")


@sh.subroutine
def lit(n: sh.Normal3f) -> sh.Attrib1f:
    return sh.max(sh.dot(TURN @ sh.Vector3f(n), LIGHT), 0) * SQUARE


@sh.program
def shade(p: sh.Point3f, n: sh.Normal3f, k: sh.Attrib1f = 3.0) -> sh.Attrib1f:
    return lit(n) * p.x + k


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


def test_a_program_by_inputs_and_params() -> None:
    """A Param, one that others follow, and a matrix, read in a subroutine; their values can change between runs."""
    slopes = shade.gradient("p", GAIN, "light", TURN, value=True)
    assert list(slopes.inputs) == ["p", "n", "k"]
    assert list(slopes.outputs) == ["value", "d_p", "d_gain", "d_light", "d_turn[0]", "d_turn[1]", "d_turn[2]"]
    assert slopes.outputs["d_p"] is sh.Normal3f
    try:
        for gain in (2.0, 3.0):
            GAIN.value = gain
            for target in TARGETS:
                value, d_p, d_gain, d_light, d_turn = run(slopes, target, [2, 0, 0], [0, 0, 1]).outputs
                dot = np.float32(0.8)
                assert value == shade.compile("numpy")([2, 0, 0], [0, 0, 1])
                assert d_p.tolist() == [dot * np.float32(gain * gain), 0, 0]
                assert d_gain == dot * np.float32(4 * gain)
                assert d_light.tolist() == [0, 0, 2 * gain * gain]
                assert np.allclose(d_turn, np.outer([0, 0.6, 0.8], [0, 0, 1]) * 2 * gain * gain)
    finally:
        GAIN.value = 2.0
    assert list(shade.gradient().outputs) == ["d_p"]


def test_a_program_along_a_direction() -> None:
    along = shade.jvp("p", GAIN)
    assert list(along.inputs) == ["p", "n", "k", "d_p", "d_gain"]
    value, change = along([2, 0, 0], [0, 0, 1], d_p=[1, 0, 0], d_gain=0.5)
    assert value == shade([2, 0, 0], [0, 0, 1])
    assert np.isclose(change, 0.8 * 4 + 0.8 * 2 * 4 * 0.5)

    @sh.program
    def moved(r: Ray, t: sh.Attrib1f):
        return {"end": r.o + r.d * t, "ray": Ray(r.o, r.d * t)}

    along = moved.jvp("r")
    result = along({"o": (0, 0, 0), "d": (0, 0, 1)}, 2, d_r={"o": (1, 0, 0), "d": (0, 1, 0)})
    assert result._fields == ("end", "ray", "d_end", "d_ray")
    assert result.d_end.tolist() == [1, 2, 0]
    assert result.d_ray.d.tolist() == [0, 2, 0]


def test_types_of_derivatives() -> None:
    @sh.program
    def types(p: sh.Point3f, x: sh.Attrib1f, r: Ray):
        g = sh.gradient(sh.length)(p)
        ray = sh.gradient(lambda r: sh.dot(r.o, r.d))(r)
        v, dv = sh.jvp(lambda q: q * x, [p], [sh.Vector3f(1, 0, 0)])
        j = sh.jacobian(lambda t: p * t)(x)
        columns = sh.jacobian(lambda q: sh.vec2(q.x * q.y, q.z))(p)
        square = sh.jacobian(lambda q: q * q)(p)
        assert (type(g), type(ray), type(ray.o)) == (sh.Normal3f, Ray, sh.Point3f)
        assert (type(v), type(dv), type(j), type(square)) == (sh.Point3f, sh.Vector3f, sh.Attrib3f, sh.Matrix3f)
        return *columns, square, j, ray

    first, second, third, square, j, ray = types([1, 2, 3], 4, {"o": (1, 2, 3), "d": (4, 5, 6)})
    assert [first.tolist(), second.tolist(), third.tolist()] == [[2, 0], [1, 0], [0, 1]]
    assert square.tolist() == [[2, 0, 0], [0, 4, 0], [0, 0, 6]]
    assert j.tolist() == [1, 2, 3]
    assert (ray.o.tolist(), ray.d.tolist()) == ([4, 5, 6], [1, 2, 3])


def test_precisions() -> None:
    """Values of f16 and f64 inside of a program, and a program compiled at these precisions."""

    def f(x: Any, y: Any) -> Any:
        return sh.sin(x * y) * y + sh.hypot(x, y)

    @sh.program
    def mixed(x: sh.Attrib1h, y: sh.Attrib1d):
        inner = (sh.gradient(lambda h: f(sh.Attrib1d(h), y), mode=m)(x) for m in ("forward", "reverse"))
        return sh.gradient(f, (0, 1))(sh.Attrib1d(x), y), sh.gradient(lambda h: h * h * sh.exp(h))(x), *inner

    x, y = np.float16([0.5, 1.25]), np.float64([0.7, 2.1])
    (d_x, d_y), half, *inner = mixed.compile("numpy")(x, y)
    assert (d_x.dtype, half.dtype) == (np.float64, np.float16)
    assert [c.tolist() for c in inner] == [d_x.astype(np.float16).tolist()] * 2
    wide, root = x.astype(float), np.hypot(x.astype(float), y)
    assert np.allclose(d_x, np.cos(wide * y) * y * y + wide / root, rtol=1e-14)
    assert np.allclose(d_y, np.cos(wide * y) * wide * y + np.sin(wide * y) + y / root, rtol=1e-14)
    assert np.allclose(half, (2 * wide + wide * wide) * np.exp(wide), rtol=4e-3)

    @sh.program
    def slopes(x: sh.Attrib1f, y: sh.Attrib1f):
        return sh.gradient(f, (0, 1))(x, y)

    expected = run(slopes, "numpy", x, y.astype(np.float16), precision="f16").outputs
    for a, b in zip(run(slopes, "opencl", x, y.astype(np.float16), precision="f16").outputs, expected, strict=True):
        assert not differs(a, b).any()
    assert np.allclose(expected[0], d_x, rtol=2e-2)


@pytest.mark.parametrize("target", TARGETS)
def test_streams_and_chains(target: str) -> None:
    """Gradient descent as a chain, on the device: x goes to the minimum of (x - 3)² + y²."""

    @sh.program
    def step(p: sh.Attrib2f):
        return {"p": p - 0.25 * sh.gradient(lambda q: (q.x - 3) * (q.x - 3) + q.y * q.y)(p)}

    start = sh.Stream(np.float32([[0, 1], [5, -2]]), sh.Attrib2f, target)
    ends = sh.repeat(step, 30).run(p=start).streams["p"].numpy()
    assert np.allclose(ends, [3, 0], atol=1e-6)


def test_immediate_mode_computes_what_a_program_does() -> None:
    f = lambda p, s: sh.length(p * s) + sh.noise(p)  # noqa: E731
    p = sh.Point3f(0.3, 0.4, 0.5)

    @sh.program
    def slopes(p: sh.Point3f) -> sh.Normal3f:
        return sh.gradient(f)(p, 2.0)

    at_once = sh.gradient(f)(p, 2.0)
    assert type(at_once) is sh.Normal3f
    assert np.array_equal(np.asarray(at_once), slopes([0.3, 0.4, 0.5]))
    value, slope = sh.gradient(lambda x: x * x, value=True)(3.0)
    assert (float(value), float(slope)) == (9, 6)


def test_names_of_traces() -> None:
    def f(x: Any) -> Any:
        total = sh.Attrib1f(0)
        with SH_FOR(0, 2):
            total += x * x
        return total

    @sh.program
    def traced(x: sh.Attrib1f) -> sh.Attrib1f:
        slope = sh.gradient(f)(x)
        return slope

    steps = {(step.name, float(step.value)) for step in traced.trace(3.0) if step.name}
    assert {("total_dx", 6.0), ("total_dx", 12.0), ("slope", 12.0)} <= steps
    assert "f_gradient(" in traced.compile("glsl").source


def doubled(x: Any) -> Any:
    return x * 2


def stepped(x: Any) -> Any:
    return sh.Attrib1i(x)


MISTAKES = {
    "sh.gradient(lambda q: doubled(x))(x)": (
        "sh.gradient by q: the function does not depend on q",
        "use the argument q in the function, not a value from around it; or wrt= another one",
    ),
    "sh.gradient(doubled)(sh.Attrib1i(x))": (
        "sh.gradient by x: an Attrib1i has no derivative, it moves in steps",
        "sh.Attrib1f(x) as the argument, or wrt= another one",
    ),
    "sh.gradient(stepped)(x)": ("stepped gives an Attrib1i, which has no derivative", "a float"),
    "sh.gradient(doubled)(sh.vec2(x, x))": (
        "sh.gradient takes a function that gives one float, and doubled gives an Attrib2f",
        "sh.jacobian for a vector, sh.jvp for a derivative along a direction",
    ),
    "sh.gradient(doubled, wrt='y')(x)": ("wrt='y' names no argument of this call of doubled", "wrt= one of 'x'"),
    "sh.gradient(3)": ("sh.gradient takes a function, not int", "sh.gradient(f)(x)"),
    "sh.jacobian('f')": ("sh.jacobian takes a function, not str", "sh.jacobian(f)(x)"),
    "sh.jvp(None, [x], [x])": ("sh.jvp takes a function, not NoneType", "sh.jvp(f, [x], [dx])"),
    "sh.gradient(doubled, wrt=1)(x)": ("wrt=1 names no argument of this call of doubled", "wrt= one of 'x'"),
    "sh.jvp(doubled, [x], [None])": (
        "sh.jvp takes a tangent for each of 1 arguments, None for one that stays, and not all None",
        "sh.jvp(f, [x, y], [dx, None])",
    ),
    "sh.jvp(doubled, [x], [sh.vec2(1, 2)])": ("the tangent of x takes one component, not 2", "pick one, as in v.x"),
    "sh.jvp(doubled, x, x)": ("sh.jvp takes a list of arguments and a list of their tangents", "sh.jvp(f, [x], [dx])"),
    "sh.detach(x)": ("shpy has no 'detach'", "x computed outside of f, where it stays"),
    "sh.grad(doubled)(x)": ("shpy has no 'grad'", 'sh.gradient(f)(x), or program.gradient("x")'),
    "sh.fwd_diff(doubled)(x)": ("shpy has no 'fwd_diff'", 'sh.jvp(f, [x], [dx]), or program.jvp("x")'),
}


@pytest.mark.parametrize("text", MISTAKES)
def test_mistakes(text: str) -> None:
    space: dict[str, Any] = {"sh": sh, "doubled": doubled, "stepped": stepped}
    with pytest.raises(sh.ShpyError) as caught:
        exec(compile(f"@sh.program\ndef wrong(x: sh.Attrib1f):\n    return {text}\n", "wrong.py", "exec"), space)
    message, cure = MISTAKES[text]
    assert (caught.value.message, caught.value.cure) == (message, cure)
    assert str(caught.value.loc).endswith("wrong.py:3")


def test_mistakes_of_programs() -> None:
    with pytest.raises(sh.ShpyTypeError) as caught:
        shade.gradient("q")
    assert caught.value.message == "'q' is no input or Param of shade"

    @sh.program
    def other(p: sh.Attrib1f, k: sh.Attrib1f) -> sh.Attrib1f:
        return p * p

    with pytest.raises(sh.RecordError, match="does not depend on k"):
        other.gradient("k")
    with pytest.raises(sh.RecordError, match="does not follow the Param gain"):
        sh.gradient(lambda x: x * GAIN)(1.0)
    for f in (np.sin, lambda x: np.sin(x)):
        with pytest.raises(sh.RecordError) as numpys:
            sh.gradient(f)(1.0)
        assert str(numpys.value.cure).endswith(("sh.sin(x) for np.sin(x)", "sh.sin(x)"))


def test_a_block_that_the_derivative_is_in() -> None:
    """A gradient in a branch of a loop reads what the loop changes."""

    @sh.program
    def descent(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        with SH_FOR(0, 20), SH_IF(y > 1.5):
            y -= 0.1 * sh.gradient(lambda q: q * q - x * q * 0.0)(y)
        return y

    x = np.float32([1, 2, 4])
    expected = run(descent, "numpy", x).outputs
    assert ((expected <= 1.5) & (expected >= 1)).all()
    assert not differs(run(descent, "opencl", x).outputs, expected).any()


def test_meetings_of_derivatives_with_the_language() -> None:
    """A derivative in a subroutine, in conditions, and of an element of an array; a derivative of a derived program."""
    cube = lambda q: q * q * q  # noqa: E731

    @sh.subroutine
    def steep(x: sh.Attrib1f) -> sh.Attrib1f:
        slope = sh.gradient(cube)(x)
        with SH_IF(slope > 3):
            SH_RETURN(slope)
        return slope * 2

    @sh.program
    def meeting(x: sh.Attrib1f) -> sh.Attrib1f:
        y, parts = sh.Attrib1f(x), sh.Array(sh.Attrib1f, [1, 2, 3])
        with SH_WHILE(lambda: sh.gradient(cube)(y) < 10):
            y += 0.5
        with SH_IF(y > 5):
            y += 1
        with SH_ELIF(sh.gradient(cube)(y) > 12):
            y += 2
        with SH_FOR(0, 3) as i:
            parts[i] = sh.gradient(lambda q: q * parts[i])(y)
        return y + steep(x) + parts[2]

    x = np.float32([0.1, 1, 6])
    for target in TARGETS:
        assert np.allclose(run(meeting, target, x).outputs, [4.1 + 0.06 + 3, 2 + 6 + 3, 7 + 108 + 3])
    mixed = shade.gradient("k", "p").gradient
    with pytest.raises(sh.ShpyTypeError, match="gives one float, and shade_gradient gives several values"):
        mixed("p")
    twice = lit_alone.gradient("s").gradient("t")
    assert list(twice.outputs) == ["d_t"]
    assert twice(3, 4).d_t == 2 * 4


@sh.program
def lit_alone(s: sh.Attrib1f, t: sh.Attrib1f) -> sh.Attrib1f:
    return s * t * t


def test_values_that_leave_the_function_are_refused() -> None:
    kept = []

    def keeping(q: Any) -> Any:
        kept.append(q * 2)
        return q * q

    with pytest.raises(sh.RecordError, match=r"was made inside the sh.gradient block at .* and is used after it"):

        @sh.program
        def leaving(x: sh.Attrib1f) -> sh.Attrib1f:
            return sh.gradient(keeping)(x) + kept[0]

    with pytest.raises(sh.ShpyTypeError, match="k is named twice"):
        shade.gradient("k", "k")


@sh.program
def wave(p: sh.Attrib3f) -> sh.Attrib1f:
    return sh.sin(p.x * p.y + p.z) * sh.expm1(p.z) * p.x + sh.length(p)


@sh.program
def curved(p: sh.Attrib3f) -> sh.Attrib1f:
    """Compute functions of one argument, some of them in branches of a loop."""
    total = sh.log1p(p.x) * sh.erf(p.y) + sh.exp10(p.z * 0.3) * sh.cbrt(p.x + p.y)
    with SH_FOR(0, 2) as k:
        with SH_IF(p.x > p.y):
            total += sh.erfc(p.z + k) * sh.sinpi(p.x)
        with SH_ELIF(p.z > 0.5):
            total *= sh.expm1(p.y) + sh.cospi(p.z)
    return total


@pytest.mark.slow
@pytest.mark.parametrize(("program", "mode"), [(curved, "forward"), (curved, "reverse"), (wave, "reverse")])
def test_derivatives_in_other_modes_of_arithmetic(program: sh.Program, mode: Any) -> None:
    """Portable and fused derivatives have the same bits everywhere; relaxed and fast ones are near to those at f64."""
    p = np.random.default_rng(4).uniform(0.1, 1, (70, 3)).astype(np.float32)
    derived = program.gradient("p", mode=mode)
    exact = derived.compile("numpy", precision="f64")(p)[0]
    for options in ({"math": "portable"}, {"fuse": True}):
        expected = derived.compile("numpy", **options)(p)[0]
        assert not differs(run(derived, "opencl-8", p, **options).outputs[0], expected).any(), options
    size = np.abs(exact).max(axis=-1, keepdims=True)
    for math in ("relaxed", "fast"):
        for target in TARGETS:
            slopes = run(derived, target, p, math=math).outputs[0]
            assert (np.abs(slopes - exact) < 2e-5 * size).all(), (math, target)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_fused_derivatives_have_the_same_bits_everywhere(mode: Any) -> None:
    """Also in wide packets, of a program that was pickled."""
    p = np.random.default_rng(3).normal(size=(500, 3)).astype(np.float32)
    derived = pickle.loads(pickle.dumps(wave.gradient("p", mode=mode)))
    expected = derived.compile("numpy", fuse=True)(p)[0]
    assert differs(derived.compile("numpy")(p)[0], expected).any()
    for target in ("opencl-1", "opencl-32", "glsl"):
        assert not differs(run(derived, target, p, fuse=True).outputs[0], expected).any(), target
