"""Rules of tangents that users write, `@f.tangent`: at the solution of a solver, in both modes, and wrong ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_DO, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_UNTIL
from shpy.ir.verifier import VerifyError
from tests.backends.running import TARGETS, differs, run

WHERE = sh.Param(sh.Point3f, (0.2, -0.1, 4), name="where")


@sh.subroutine
def root(c: sh.Attrib1f) -> sh.Attrib1f:
    """Solve x**3 + x = c by Newton's method; no bound of the loop is known."""
    x = sh.Attrib1f(1)
    with SH_DO():
        step = (x * x * x + x - c) / (3 * x * x + 1)
        x -= step
        SH_UNTIL(sh.abs(step) < 1e-5)
    return x


@root.tangent
def root_tangent(x: Any, c: Any, d_c: Any) -> Any:
    return d_c / (3 * x * x + 1)


def surface(p: Any, center: Any) -> Any:
    return sh.length(p - center) - 1 - 0.1 * sh.sin(p.x * 3)


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


@sh.subroutine
def hit(ray: Ray, center: sh.Point3f, most: sh.Attrib1i) -> sh.Point3f:
    """March to the surface."""
    t = sh.Attrib1f(0)
    with SH_FOR(0, most):
        step = surface(ray.o + t * ray.d, center)
        t += step * 0.8
        SH_BREAK(sh.abs(step) < 1e-11)
    return ray.o + t * ray.d


@hit.tangent
def hit_tangent(p: Any, ray: Any, center: Any, most: Any, d_ray: Any, d_center: Any) -> Any:
    """Stay on surface(p, center) = 0 while p moves along the ray."""
    assert isinstance(d_ray, Ray)
    n, by_center = sh.gradient(surface, (0, 1))(p, center)
    t = sh.dot(p - ray.o, ray.d) / sh.dot(ray.d, ray.d)
    across = d_ray.o + t * d_ray.d
    return across - (sh.dot(n, across) + sh.dot(by_center, d_center)) / sh.dot(n, ray.d) * ray.d


def deep(o: Any, d: Any) -> Any:
    p = hit(Ray(o, sh.normalize(d)), WHERE, 200)
    return root(sh.dot(p - o, p - o)) + p.y * root(p.x)


@sh.program
def depth(o: sh.Point3f, d: sh.Vector3f) -> sh.Attrib1f:
    return deep(o, d)


RNG = np.random.default_rng(7)
ORIGINS = RNG.uniform(-0.1, 0.1, (30, 3))
DIRECTIONS = RNG.uniform(-0.1, 0.1, (30, 3)) + (0, 0, 1)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_rules_of_solvers(mode: Any) -> None:
    """The derivative is the difference quotient, has the same bits on every backend, and the text calls the rule."""
    slopes = depth.gradient("o", "d", WHERE, mode=mode)
    whole = depth.compile("numpy", precision="f64")
    derivatives = slopes.compile("numpy", precision="f64").run(ORIGINS, DIRECTIONS).outputs
    for k, x in enumerate((ORIGINS, DIRECTIONS)):
        for axis in range(3):
            h = np.eye(3)[axis] * 1e-4
            ends = [whole(*(y + s * h if y is x else y for y in (ORIGINS, DIRECTIONS))) for s in (1, -1)]
            assert np.allclose(derivatives[k][:, axis], (ends[0] - ends[1]) / 2e-4, atol=1e-4)
    alone = depth.gradient("o", mode=mode).compile("numpy", precision="f64").run(ORIGINS, DIRECTIONS).outputs
    assert np.allclose(alone[0], derivatives[0], rtol=1e-13)
    single = [x.astype(np.float32) for x in (ORIGINS, DIRECTIONS)]
    expected = run(slopes, "numpy", *single).outputs
    for target in TARGETS[1:]:
        for a, b in zip(run(slopes, target, *single).outputs, expected, strict=True):
            assert not differs(a, b).any(), target


def test_rules_in_loops_and_branches_over_streams() -> None:
    """The results of the calls go into an array, and back into the next call; a Param is fitted through the rule."""
    gain = sh.Param(sh.Attrib1f, 1.25, name="gain")

    @sh.program
    def chained(x: sh.Attrib1f) -> sh.Attrib1f:
        kept, y = sh.Array(sh.Attrib1f, 3), sh.Attrib1f(x)
        with SH_FOR(0, 5) as k:
            with SH_IF(y > 0.5):
                y[:] = root(y * gain) + kept[k % 3]
            kept[(k + 1) % 3] = y * x
        return y * kept[1]

    x = np.linspace(0.2, 2, 40)
    whole = chained.compile("numpy", precision="f64")
    slopes = {m: chained.gradient("x", mode=m).compile("numpy", precision="f64")(x)[0] for m in ("forward", "reverse")}
    assert np.allclose(slopes["forward"], slopes["reverse"], rtol=1e-13)
    assert np.allclose(slopes["forward"], (whole(x + 1e-6) - whole(x - 1e-6)) / 2e-6, rtol=1e-5)
    by_gain = sh.value_and_gradient(chained, gain)
    expected = by_gain(x, backend="numpy")
    for target in TARGETS[1:]:
        assert by_gain(sh.Stream(x, sh.Attrib1f, target)) == expected
    assert np.isclose(
        by_gain(x, precision="f64")[1], sh.value_and_gradient(chained, gain, mode="forward")(x)[1], rtol=1e-5
    )


def test_second_derivatives_directions_and_immediate_mode() -> None:
    slope = sh.gradient(sh.gradient(root))(3.0)
    x = float(sh.gradient(root, value=True)(3.0)[0])
    assert np.isclose(float(slope), -6 * x / (3 * x * x + 1) ** 3, rtol=1e-5)
    assert np.isclose(float(sh.gradient(root, mode="reverse")(3.0)), 1 / (3 * x * x + 1), rtol=1e-6)
    value, change = sh.jvp(
        hit,
        [Ray(sh.Point3f(0, 0, 0), sh.Vector3f(0, 0, 1)), sh.Point3f(0, 0, 4), sh.Attrib1i(90)],
        [None, sh.Vector3f(0, 0, 1), None],
    )
    assert np.allclose(np.asarray(value), [0, 0, 3], atol=1e-5)
    assert np.allclose(np.asarray(change), [0, 0, 1], atol=1e-5)


def test_the_recorded_text_has_the_rule_and_kernels_lack_it() -> None:
    assert "tangent root_tangent" in str(depth.ir)
    assert sh.parse(str(depth.ir)) == depth.ir
    again = sh.Program.from_ir(sh.parse(str(depth.ir).replace("root", "solve")))
    assert "root_tangent" not in depth.compile("opencl").source
    slopes = again.gradient("o").compile("numpy")(ORIGINS.astype(np.float32), DIRECTIONS.astype(np.float32))
    assert np.array_equal(
        slopes[0], depth.gradient("o").compile("numpy")(ORIGINS.astype(np.float32), DIRECTIONS.astype(np.float32))[0]
    )
    body = sh.accuracy.roundings(depth, {"o": ORIGINS[:4], "d": DIRECTIONS[:4]}, samples=4, most=200)
    assert any(line.loc and "step = (x" in line.text for line in body.lines)  # roundings are those of the body


def nearly(x: Any, c: Any, d_c: Any) -> Any:
    return sh.cond(d_c > 0, d_c, 2 * d_c)


def squared(x: Any, c: Any, d_c: Any) -> Any:
    return d_c * d_c


def decided(x: Any, c: Any, d_c: Any) -> Any:
    slope = sh.Attrib1f(0)
    with SH_IF(d_c > 1):
        slope += d_c
    return slope


def squares(d_c: Any, factor: Any) -> Any:
    return d_c * factor


def called(x: Any, c: Any, d_c: Any) -> Any:
    return sh.subroutine(squares)(d_c, d_c) + d_c


def stepped(x: Any, c: Any, d_c: Any) -> Any:
    return sh.Attrib1f(sh.Attrib1i(d_c))


def added(x: Any, c: Any, d_c: Any) -> Any:
    return d_c + x


def constant(x: Any, c: Any, d_c: Any) -> Any:
    return 2 * x


@pytest.mark.parametrize("rule", [nearly, squared, decided, called, stepped, added, constant])
def test_reverse_mode_refuses_rules_that_it_cannot_transpose(rule: Any) -> None:
    @sh.subroutine
    def half(c: sh.Attrib1f) -> sh.Attrib1f:
        return c * 0.5

    half.tangent(rule)
    sh.gradient(half)(1.0)
    with pytest.raises(sh.RecordError) as e:
        sh.gradient(half, mode="reverse")(1.0)
    assert e.value.message.endswith("this rule of a tangent backwards, and sees no sum of products with tangents here")
    cure = "+ and - of tangents, * and / with other values, conditions without tangents; or"
    assert e.value.cure == f'{cure} mode="forward"'
    assert e.value.loc is not None
    lines = [
        "sh.cond(d_c > 0, d_c, 2 * d_c)",
        "d_c * d_c",
        "with SH_IF(d_c > 1):",
        "sh.Attrib1f(sh.Attrib1i(d_c))",
        "d_c * factor",
        "d_c + x",
        "2 * x",
    ]
    assert Path(__file__).read_text().splitlines()[e.value.loc.line - 1].strip().removeprefix("return ") in lines


@sh.subroutine
def longer(t: sh.Attrib1f, c: sh.Attrib1f) -> sh.Attrib1f:
    with SH_IF(c > 0.5):
        SH_RETURN(t * c)
    return t


@sh.subroutine
def grown(c: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    return sh.exp(c)


@grown.tangent
def grown_tangent(y: Any, c: Any, n: Any, d_c: Any) -> Any:
    """Sum tangents in loops, branches, an array and a subroutine; the sum is not the derivative of the body."""
    total, kept = sh.Attrib1f(0), sh.Array(sh.Attrib1f, 4)
    with SH_FOR(0, 4) as k:
        kept[k] = d_c * sh.Attrib1f(k + 1)
    with SH_FOR(0, 8) as k:
        SH_BREAK(k > n)
        with SH_IF(c > 0.8):
            total += kept[k % 4] * 0.1
        with SH_ELSE():
            total -= longer(d_c, c)
    return total * c + y * d_c


MODES = ["forward", "reverse"]


@sh.program
def grown_once(c: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    return grown(c * c, n) * c


@sh.program
def grows(c: sh.Attrib1f, n: sh.Attrib1i):
    f = lambda q: grown(q * q, n) * q  # noqa: E731
    twice = [sh.gradient(sh.gradient(f, mode=a), mode=b)(c) for a, b in (MODES, MODES[::-1], ["reverse"] * 2)]
    return sh.gradient(f)(c), sh.gradient(f, mode="reverse")(c), *twice, sh.gradient(sh.gradient(f))(c)


def test_rules_with_blocks() -> None:
    """All modes agree, in second derivatives too, which call the rule and leave the body alone."""
    c = np.linspace(0.2, 1.6, 9)
    first, again, *twice = grows.compile("numpy", precision="f64")(c, 5)
    assert np.allclose(again, first, rtol=1e-13)
    for second in twice:
        assert np.allclose(second, twice[-1], rtol=1e-12)

    def slope(c: float) -> float:
        y, total = np.exp(c), sum((k % 4 + 1) * 0.1 if c > 0.8 else -(c if c > 0.5 else 1) for k in range(6))
        return total * c + y

    assert np.allclose(first, [slope(x * x) * 2 * x * x + np.exp(x * x) for x in c], rtol=1e-12)
    slopes, c = grown_once.gradient("c", mode="reverse"), c.astype(np.float32)
    strict, fused = (slopes.compile("numpy", fuse=fuse)(c, 5)[0] for fuse in (False, True))
    assert differs(strict, fused).any()
    for target, fuse in (("opencl-1", False), ("glsl", True)):
        slopes_there = run(slopes, target, c, 5, fuse=fuse).outputs[0]
        assert not differs(slopes_there, fused if fuse else strict).any(), (target, fuse)
    by_root = [float(sh.gradient(sh.gradient(root, mode=a), mode=b)(3.0)) for a in MODES for b in MODES]
    assert np.allclose(by_root, by_root[0], rtol=1e-5)  # the loop in root has no bound


@sh.struct
class Pair:
    u: sh.Attrib1f
    w: sh.Attrib2f


@sh.subroutine
def paired(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib2f) -> Pair:
    return Pair(sh.sin(a), sh.vec2(b * c.x, c.y * b))


@paired.tangent
def paired_tangent(y: Any, a: Any, b: Any, c: Any, d_a: Any, d_b: Any, d_c: Any) -> Any:
    """Store one component in each iteration."""
    w = sh.Attrib2f(0, 0)
    with SH_FOR(0, 2) as k:
        with SH_IF(k == 0):
            w.x = d_b * c.x + b * d_c.x
        with SH_ELSE():
            w.y = d_c.y * b + c.y * d_b
    return Pair(sh.cos(a) * d_a, w)


@sh.program
def pairs(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib2f) -> sh.Attrib1f:
    p = paired(a, b, c)
    return p.u * p.w.x + p.w.y * p.w.y


@pytest.mark.sampled(3)
@pytest.mark.parametrize("wrt", [("a",), ("c",), ("b", "c")])
def test_rules_of_structs_by_some_of_the_arguments(wrt: tuple[str, ...]) -> None:
    """Not every component of the result moves; the tangents of the other arguments are 0."""
    a = np.linspace(0.1, 1, 5)
    inputs = a, 2 * a[::-1], np.stack([a * 3, 2 * a], -1)
    both = [pairs.gradient(*wrt, mode=m).compile("numpy", precision="f64").run(*inputs).outputs for m in MODES]
    for forward, reverse in zip(*both, strict=True):
        assert np.allclose(forward, reverse, rtol=1e-14)
        assert (forward != 0).any()


class Solver:
    def __init__(self, factor: float) -> None:
        self.factor = factor

    @sh.subroutine
    def solved(self, c: sh.Attrib1f) -> sh.Attrib1f:
        return c * c * self.factor

    @solved.tangent
    def solved_tangent(y: Any, self: Any, c: Any, d_c: Any) -> Any:
        slope = sh.Attrib1f(d_c)
        with SH_IF(c > 1):
            slope *= 3
        return slope * c * self.factor


@pytest.mark.parametrize("mode", MODES)
def test_rules_of_methods(mode: Any) -> None:
    """Each instance has its own; the rule takes the instance as its second argument."""
    one, other = Solver(2.0), Solver(5.0)
    assert float(sh.gradient(one.solved, mode=mode)(3.0)) == 18
    assert float(sh.gradient(lambda x: one.solved(x) + other.solved(x), mode=mode)(3.0)) == 63
    assert float(sh.gradient(lambda x: one.solved(x) + other.solved(x), mode=mode)(0.5)) == 3.5


def test_a_rule_of_zero() -> None:
    @sh.subroutine
    def level(c: sh.Attrib1f) -> sh.Attrib1f:
        return sh.floor(c) * 0.5

    level.tangent(lambda y, c, d_c: sh.Attrib1f(0))
    for mode in ("forward", "reverse"):
        assert float(sh.gradient(lambda c: level(c) + c, mode=mode)(1.5)) == 1


def test_linear_rules_of_every_shape_are_transposed() -> None:
    """Products, quotients, dot and cross products, components, vectors and choices of tangents."""

    @sh.subroutine
    def mixed(v: sh.Attrib3f, s: sh.Attrib1f) -> sh.Attrib3f:
        return sh.cross(v, v.yzx) * s + sh.Attrib3f(sh.dot(v, v), s / v.x, v.y)

    @mixed.tangent
    def mixed_tangent(y: Any, v: Any, s: Any, d_v: Any, d_s: Any) -> Any:
        turned = (sh.cross(d_v, v.yzx) + sh.cross(v, d_v.yzx)) * s + sh.cross(v, v.yzx) * d_s
        third = sh.cond(v.z > 10, 0, sh.abs(1) * d_v.y)
        return turned + sh.Attrib3f(2 * sh.dot(v, d_v), d_s / v.x - s * d_v.x / (v.x * v.x), third)

    @sh.program
    def both(v: sh.Attrib3f, s: sh.Attrib1f):
        f = lambda v, s: sh.dot(mixed(v, s), sh.Attrib3f(1, 2, 3)) * s  # noqa: E731
        return *sh.gradient(f, (0, 1))(v, s), *sh.gradient(f, (0, 1), mode="reverse")(v, s)

    v, s = RNG.uniform(0.5, 1, (9, 3)), RNG.uniform(0.5, 1, 9)
    by_v, by_s, bar_v, bar_s = both.compile("numpy", precision="f64")(v, s)
    assert np.allclose(by_v, bar_v, rtol=1e-13)
    assert np.allclose(by_s, bar_s, rtol=1e-13)

    def value(v: Any, s: Any) -> Any:
        y = np.cross(v, v[:, [1, 2, 0]]) * s[:, None] + np.stack([(v * v).sum(-1), s / v[:, 0], v[:, 1]], -1)
        return y @ (1, 2, 3) * s

    assert np.allclose(by_s, (value(v, s + 1e-6) - value(v, s - 1e-6)) / 2e-6, rtol=1e-6)


def test_mistakes() -> None:
    @sh.subroutine
    def half(c: sh.Attrib1f) -> sh.Attrib1f:
        return c * 0.5

    half.tangent(lambda c, d_c: d_c)
    with pytest.raises(
        sh.ShpyTypeError, match="its arguments, and a tangent of each argument of floats: 3 parameters"
    ) as e:
        sh.gradient(half)(1.0)
    assert e.value.cure == "def <lambda>(result, c, d_c):"
    half.tangent(lambda y, c, d_c: sh.vec2(d_c, 0))
    with pytest.raises(sh.ShpyTypeError, match="whose result consists of f"):
        sh.gradient(half)(1.0)
    with pytest.raises(sh.ShpyTypeError, match=r"half\.tangent takes a function"):
        half.tangent(0.5)  # type: ignore[arg-type]

    @sh.subroutine
    def floored(c: sh.Attrib1f) -> sh.Attrib1i:
        return sh.Attrib1i(c)

    floored.tangent(lambda y, c, d_c: d_c)
    with pytest.raises(sh.ShpyTypeError, match="the result of floored has no tangent"):
        sh.gradient(lambda c: c * floored(c))(1.0)

    @sh.subroutine
    def storing(c: sh.Attrib1f) -> sh.Attrib1f:
        c += 1
        return c * c

    storing.tangent(lambda y, c, d_c: d_c)
    with pytest.raises(sh.ShpyTypeError, match="has a rule of its tangent, and stores into its arguments"):

        @sh.program
        def calls(c: sh.Attrib1f) -> sh.Attrib1f:
            return storing(c)

    gain = sh.Param(sh.Attrib1f, 2.0, name="gain")

    @sh.subroutine
    def scaled(c: sh.Attrib1f) -> sh.Attrib1f:
        return c * gain

    scaled.tangent(lambda y, c, d_c: d_c * gain)

    @sh.program
    def scales(c: sh.Attrib1f) -> sh.Attrib1f:
        return scaled(c) * gain

    assert scales.gradient("c")(3.0) == (4.0,)
    for mode in ("forward", "reverse"):
        with pytest.raises(sh.RecordError, match="one of the two reads a Param or a Table that the"):
            scales.gradient(gain, mode=mode)
    with pytest.raises(sh.ShpyAttributeError) as foreign:
        _ = sh.custom_jvp  # type: ignore[attr-defined]
    assert "@f.tangent" in str(foreign.value)


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("other", "no function other before this one is the rule of its tangent"),
        ("f", "no function f before this one is the rule of its tangent"),
        ("g", "the rule g takes the outputs, the inputs, and a tangent of each input of floats"),
    ],
)
def test_the_verifier_checks_rules(rule: str, message: str) -> None:
    text = f"""module m
input a: Attrib1f
output b: Attrib1f

function g(%x.0: f) -> ($y.0: f) {{
  store $y.0 = %x.0
}}

function f(%x.0: f) -> ($y.0: f) tangent {rule} {{
  store $y.0 = %x.0
}}

function m(%a.0: f) -> ($b.0: f) {{
  call f(%a.0) -> %1: f
  store $b.0 = %1
}}
"""
    with pytest.raises(VerifyError, match=message):
        sh.Program.from_ir(sh.parse(text))
