"""Gradients in kernels: the whole language against difference quotients at f64, with the same bits on every backend."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DISCARD, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_WHILE
from tests.backends.running import TARGETS, differs, run


def box(p: Any, b: Any) -> Any:
    q = sh.abs(p) - b
    return sh.length(sh.max(q, 0)) + sh.min(sh.max(q.x, sh.max(q.y, q.z)), 0)


def marched(d: Any, r: Any) -> Any:
    d = sh.normalize(d * sh.Vector3f(0.3, 0.3, 0) + sh.Vector3f(0, 0, 1))
    t = sh.Attrib1f(0)
    with SH_FOR(0, 60):
        s = sh.min(sh.length(d * t - sh.Vector3f(0, 0, 3)) - r, d.y * t + 1.5)
        t += s
        SH_BREAK((s < 1e-7) | (t > 20))
    return t


@sh.subroutine
def piece(x: sh.Attrib1f, y: sh.Attrib1f):
    with SH_IF(x < 0):
        SH_RETURN(sh.exp(x) * y)
    y *= x
    return sh.sin(x * y)


def early(x: Any, y: Any) -> Any:
    z = y * y
    a = piece(x, z)
    return a * z + piece(y, a)


def nested(p: Any) -> Any:
    s, y = sh.Attrib1f(0), sh.Attrib2f(p)
    with SH_FOR(0, 5) as i:
        with SH_FOR(0, 4) as j:
            SH_CONTINUE(j == 2)
            y[:] = sh.Attrib2f(sh.sin(y.y + sh.Attrib1f(j)), y.x * 0.5 + p.y)
            with SH_IF(y.x > 0.3):
                y.x += s * 0.1
            with SH_ELSE():
                SH_DISCARD(y.x < -50)
        s += sh.dot(y, p) + sh.Attrib1f(i)
        SH_BREAK(s > 5)
    return s


def doubled(x: Any) -> Any:
    s, n = sh.Attrib1f(x), sh.Attrib1f(0)
    with SH_WHILE(lambda: s < 10):
        s *= 1.5
        n += s * s * x
    return n + s


def long(p: Any) -> Any:
    """Loop 1,100 times: reverse mode splits a loop of more than 1,024 iterations into two nested loops."""
    s, n = sh.Attrib1f(p.x), sh.Attrib1f(0)
    with SH_FOR(0, 1100) as i:
        s += sh.sin(s * p.y) * 0.01
        SH_CONTINUE(s > 1.4)
        n += s * 0.001
        SH_BREAK(i > 900 + sh.Attrib1i(p.x * 100))
    return s + n


def curvature(p: Any) -> Any:
    f = lambda q: sh.length(sh.Attrib2f(sh.length(q.xy) - 1, q.z)) - 0.3 * sh.sin(q.x)  # noqa: E731
    j = sh.jacobian(lambda q: sh.normalize(sh.gradient(f)(q)))(p)
    return j[0, 0] + j[1, 1] + j[2, 2]


def arrays(p: Any) -> Any:
    a = sh.Array(sh.Attrib2f, 6)
    with SH_FOR(0, 6) as i:
        a[i] = p * sh.Attrib1f(i) + sh.sin(p.yx)
    with SH_FOR(1, 6) as i:
        a[i] += a[i - 1] * a[i].yx
    k = sh.Attrib1i(p.x * 4)
    return sh.dot(a[k], a[5]) + p[k % 2] * p.x


@sh.subroutine
def swap_down(a: Any, i: sh.Attrib1i):
    """Exchange neighbours of an array up to the first pair in order, as insertion sort does."""
    j = sh.Attrib1i(i)
    with SH_WHILE(lambda: j > 0):
        SH_RETURN(c=a[j - 1] <= a[j])
        kept = sh.Attrib1f(a[j])
        a[j] = a[j - 1]
        a[j - 1] = kept * 1.01
        j -= 1


def sorting(p: Any) -> Any:
    """An array that nested loops read and change, after a loop without a bound that ends early, and with another."""
    a, order = sh.Array(sh.Attrib1f, 5), sh.Array(sh.Attrib1i, 5)
    with SH_FOR(0, 5) as i:
        a[i] = sh.sin(p.x * sh.Attrib1f(i * i)) + p.y
    with SH_FOR(1, 5) as i:
        swap_down(a, i)
        order[i] = order[i - 1] + sh.Attrib1i(a[i] > p.x)
    total = sh.Attrib1f(0)
    with SH_FOR(0, 5) as i:
        total += a[order[i]] * a[i] * sh.Attrib1f(i + 1)
        with SH_IF(total > 1):
            a[i + 1] = total
            a[0] *= p.x
        order[4 - i] = i
    a[2] = p.x
    return total + a[1] * a[2] + a[4]


def matrices(p: Any, s: Any) -> Any:
    m = sh.Matrix3f((p.x, 1, 0), (0, p.y, s), (s, 0, 2))
    return sh.determinant(m) + sh.length(sh.inverse(m) @ sh.Vector3f(p, s) + sh.transpose(m)[1])


@sh.struct
class Ball:
    center: sh.Point3f
    radius: sh.Attrib1f


def structs(c: Any, r: Any) -> Any:
    ball = Ball(c, r)
    ball.center += sh.Vector3f(r, 0, 0)
    g = sh.gradient(lambda b: sh.length(b.center) * b.radius * b.radius)(ball)
    return g.radius + sh.dot(g.center, g.center) + ball.radius


PICTURE = sh.Texture2D(np.random.default_rng(5).random((5, 7, 3)).astype(np.float32), wrap="repeat")
HEIGHTS = sh.Table(np.linspace(0, 1, 9) ** 2, sh.Attrib1f, name="heights")


def sampled(p: Any) -> Any:
    i = sh.Attrib1i(sh.floor(p.x * 4))
    return sh.dot(PICTURE(p), sh.Color3f(1, 2, 3)) + sh.mix(HEIGHTS[i], HEIGHTS[i + 1], sh.fract(p.x * 4)) * p.y


@sh.program
def bent(x: sh.Attrib1f, y: sh.Attrib1f = 2.0) -> sh.Attrib1f:
    with SH_IF(x > 1):
        SH_RETURN(x * x * y)
    return sh.sqrt(x + y)


class Wave:
    def __init__(self, speed: float) -> None:
        self.speed = speed

    def height(self, p: Any) -> Any:
        return sh.sin(p.x * self.speed) * sh.cos(p.y)


def called(p: Any) -> Any:
    g = sh.gradient(bent)(p.x)
    return g * bent(p.y) + bent(p.x, y=p.y) + sh.length(sh.gradient(Wave(3).height)(p))


def stored(p: Any) -> Any:
    """The function stores into values and an array around it, which carry the derivative out, in both modes."""
    total, kept, weights = sh.Attrib1f(p.x), sh.Array(sh.Attrib1f, [1, 2, 3]), sh.Array(sh.Attrib1f, [0.5, 0.25])
    count = sh.Attrib1i(0)

    def add(q: Any) -> Any:
        nonlocal total, count
        total += q.x * q.y
        with SH_FOR(0, 4) as k:
            kept[(k + 1) % 3] = kept[k % 3] * q.y + total * weights[k % 2]
            count += 1
        return total * q.y + kept[0] * kept[1]

    slopes = sh.gradient(add)(p).x + sh.gradient(add, mode="reverse")(p).y
    return slopes + total + kept[1] * kept[2] + sh.Attrib1f(count)


PROGRAMS = {
    "box": (box, (3, 3)),
    "marched": (marched, (3, 1)),
    "early": (early, (1, 1)),
    "nested": (nested, (2,)),
    "doubled": (doubled, (1,)),
    "long": (long, (2,)),
    "curvature": (curvature, (3,)),
    "noise": (lambda p: sh.noise(p) + sh.noise(p * 2), (3,)),
    "arrays": (arrays, (2,)),
    "sorting": (sorting, (2,)),
    "matrices": (matrices, (2, 1)),
    "structs": (structs, (3, 1)),
    "sampled": (sampled, (2,)),
    "called": (called, (2,)),
    "stored": (stored, (2,)),
}


def program_of(f: Any, sizes: tuple[int, ...], mode: Any = None) -> sh.Program:
    inputs = ", ".join(f"x{k}: sh.Attrib{s}f" for k, s in enumerate(sizes))
    xs, wrt = ", ".join(f"x{k}" for k in range(len(sizes))), tuple(range(len(sizes)))
    space: dict[str, Any] = {"sh": sh, "f": f}
    if mode is not None:
        space["f"] = sh.gradient(f, wrt, value=True, mode=mode, most=60)
    exec(f"@sh.program\ndef whole({inputs}):\n    return f({xs})\n", space)
    program: sh.Program = space["whole"]
    return program


@pytest.mark.sampled(24)
@pytest.mark.parametrize("name", PROGRAMS)
def test_gradients_of_programs(name: str) -> None:
    f, sizes = PROGRAMS[name]
    rng = np.random.default_rng(3)
    data = [rng.uniform(0.3, 1.4, (40,) if s == 1 else (40, s)) for s in sizes]
    primal = program_of(f, sizes).compile("numpy", precision="f64")
    derived = program_of(f, sizes, "forward")
    h, e = 1e-6, 0.6
    slope = (primal(*(x + h * e for x in data)) - primal(*(x - h * e for x in data))) / (2 * h)
    value, gradients = derived.compile("numpy", precision="f64").run(*data).outputs
    assert np.array_equal(value, primal(*data))
    along = sum(np.sum(g, axis=-1) if g.ndim > 1 else g for g in gradients) * e
    assert np.quantile(np.abs(along - slope) / (1 + np.abs(slope)), 0.9) < 1e-7  # the rest lies at kinks
    backwards = program_of(f, sizes, "reverse")
    again, bars = backwards.compile("numpy", precision="f64").run(*data).outputs
    assert np.array_equal(value, again)
    for a, b in zip(gradients, bars, strict=True):
        assert np.allclose(a, b, rtol=1e-11, atol=1e-12)
    single = [x.astype(np.float32) for x in data]
    for program, target in zip((derived, backwards), TARGETS[1:], strict=True):  # each kernel takes half a second
        value, gradients = run(program, "numpy", *single).outputs
        other, others = run(program, target, *single).outputs
        for a, b in zip((other, *others), (value, *gradients), strict=True):
            assert not differs(a, b).any(), target


def test_arrays_that_loops_overwrite_too_often() -> None:
    """Loops with bounds are refused, at their line; an element whose loops without bounds store too often gives NaN."""

    def filled(x: Any, count: Any, bound: int | None) -> Any:
        a = sh.Array(sh.Attrib1f, [1, 1])
        with SH_FOR(0, count if bound is None else bound), SH_FOR(0, count if bound is None else bound) as k:
            a[k % 2] = a[(k + 1) % 2] * (1 + x * 1e-3)
        return a[0] * x

    @sh.program
    def slopes(x: sh.Attrib1f, count: sh.Attrib1i):
        reverse = sh.gradient(lambda q: filled(q, count, None), mode="reverse", most=70)(x)
        return sh.gradient(lambda q: filled(q, count, None))(x), reverse

    forward, reverse = slopes.compile("numpy", precision="f64")([0.5, 0.5, 0.5, 0.7], [3, 64, 65, 0])
    assert np.allclose(forward[[0, 1, 3]], reverse[[0, 1, 3]], rtol=1e-13)
    assert np.isnan(reverse[2])
    assert np.isfinite(forward).all()
    with pytest.raises(sh.RecordError, match=r"the elements of a that this loop overwrites, up to 4,900, and an") as e:
        sh.gradient(lambda q: filled(q, 0, 70), mode="reverse")(0.5)
    assert e.value.cure == 'fewer iterations; or mode="forward"'
    assert e.value.loc is not None
    assert e.value.loc.line == filled.__code__.co_firstlineno + 2
