"""`Program.fpcore`: texts that a reader by the standard evaluates to the bits of the kernel, and what FPCore lacks."""

from __future__ import annotations

import random

import numpy as np
import pytest
from fpcore.reader import evaluate, parts, read

import shpy as sh
from shpy import (
    SH_BREAK,
    SH_CONTINUE,
    SH_DISCARD,
    SH_DO,
    SH_ELIF,
    SH_ELSE,
    SH_FOR,
    SH_IF,
    SH_RETURN,
    SH_UNTIL,
    SH_WHILE,
)
from shpy.testing.arrays import flat_leaves

GAIN = sh.Param(sh.Attrib1f, 2.5, range=(1, 3), name="gain")


@sh.subroutine
def doubled(v: sh.Attrib1f, k: sh.Attrib1i) -> sh.Attrib1f:
    with SH_IF(k > 2):
        SH_RETURN(v * 2)
    v += 0.1
    return v


@sh.program
def loops(x: sh.Attrib1f, y: sh.Attrib1f):
    t = sh.Attrib1f(0)
    with SH_FOR(0, 5) as i:
        t += abs(x) * i
        SH_BREAK(t > 10)
    with SH_WHILE(lambda: t > 1):
        t /= 2
    with SH_DO():
        t += 1
        SH_CONTINUE(t > 5)
        t *= GAIN
        SH_UNTIL(lambda: t > 9)
    return doubled(t, sh.Attrib1i(x)), t * y


@sh.program
def swaps(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    with SH_FOR(0, 3):
        sh.swap(x, y)
        with SH_FOR(0, 2) as k:
            with SH_IF(y > 0.5):
                SH_CONTINUE()
            y += 0.1 * k + x
    return x / 3 - y


@sh.program
def leaves_early(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    with SH_FOR(0, 9) as i:
        with SH_FOR(0, 4) as k:
            SH_RETURN(x * i - y, (x * i + k) > 3)
        x += 0.25
    with SH_IF(x > y):
        x[:] = sh.sqrt(x)
    with SH_ELIF(x > -1):
        with SH_WHILE(lambda: x < 1):
            x += 0.3
    with SH_ELSE():
        SH_RETURN(sh.exp(x))
    return x * y


@sh.program
def vectors(x: sh.Attrib1f, y: sh.Attrib1f, v: sh.Point3f) -> tuple[sh.Attrib1f, sh.Vector3f]:
    w = sh.normalize(v - (x, y, 0.1))
    w.z = sh.length(v)
    w.xy *= sh.mix(x, y, 0.3)
    return sh.dot(v, w), sh.reflect(w, v)


@sh.program
def functions(x: sh.Attrib1f, y: sh.Attrib1f):
    a = abs(x) + 0.1
    return (
        sh.rsqrt(a), sh.exp10(x), sh.sinpi(x), sh.cospi(y), sh.ldexp(x, 3), sh.fma(x, y, a), sh.expm1(x), sh.log1p(a),
        sh.cbrt(x), sh.erf(x), sh.erfc(y), sh.hypot(x, y), sh.atan2(y, x), sh.pow(a, y), sh.min(x, y), sh.sign(y),
        sh.round(x * 3), sh.fract(x), sh.mod(x, a), sh.smoothstep(0, a, y), sh.Attrib1f(sh.Attrib1i(x * 4)),
        sh.cond(sh.isnan(x / y) | ~(x > y), a, -0.0),
    )  # fmt: skip


@sh.program
def mixed(x: sh.Attrib1f, y: sh.Attrib1d, h: sh.Attrib1h, n: sh.Attrib1i):
    return x * y + 0.1, h * 0.1 + x, sh.Attrib1f(y / 3), sh.Attrib1h(x), x * n, sh.Attrib1i(x) * n + 2049


RNG = np.random.default_rng(3)
X, Y = RNG.uniform(-3, 3, (2, 10)).astype(np.float32)
ALSO = {
    "v": RNG.uniform(-2, 2, (10, 3)).astype(np.float32), "h": RNG.uniform(-2, 2, 10).astype(np.float16),
    "n": RNG.integers(-9, 9, 10).astype(np.int32),
}  # fmt: skip


def values_of(program, arrays, k):
    """Return the arguments of one element: numbers, and lists for vectors."""
    values = {name: array[k].tolist() for name, array in arrays.items()}
    return values | {name: float(param.value) for name, param in program.params.items()}


def flat(value):
    return [n for v in value for n in flat(v)] if isinstance(value, list) else [value]


def check(program, arrays, count=10):
    core = read(program.fpcore())
    leaves = [np.asarray(a) for a in flat_leaves(program.compile("numpy")(**arrays))]
    for k in range(count):
        expected = [n for a in leaves for n in np.ravel(a[k]).tolist()]
        results = flat(evaluate(core, values_of(program, arrays, k)))
        np.testing.assert_array_equal(results, expected)
        assert np.signbit(np.float64(results)).tolist() == np.signbit(np.float64(expected)).tolist()


@pytest.mark.parametrize("program", [loops, swaps, leaves_early, vectors, functions, mixed], ids=lambda p: p.name)
def test_the_text_means_what_the_kernel_computes(program):
    arrays = {"x": X, "y": Y, **ALSO}
    arrays = {name: arrays[name] for name in program.inputs}
    if program is mixed:
        arrays["y"] = Y.astype(np.float64)
    check(program, arrays)


def test_another_precision_is_that_of_the_whole_text():
    arrays = {"x": X.astype(np.float64), "y": Y.astype(np.float64)}
    core = read(swaps.fpcore(precision="f64"))
    assert parts(core)[1][":precision"] == "binary64"
    expected = swaps.compile("numpy", precision="f64")(**arrays)
    assert [evaluate(core, values_of(swaps, arrays, k)) for k in range(10)] == expected.tolist()
    half = read(swaps.fpcore(precision="f16"))
    arrays = {name: a.astype(np.float16) for name, a in arrays.items()}
    expected = swaps.compile("numpy", precision="f16")(**arrays)
    assert [evaluate(half, values_of(swaps, arrays, k)) for k in range(10)] == expected.tolist()


class Drawn:
    """A random program of floats and counters: stores, branches and loops nested in each other, with every exit."""

    def __init__(self, number: int) -> None:
        self.random = random.Random(number)

    def __call__(self, x: sh.Attrib1f, y: sh.Attrib1f):
        self.names = [sh.Attrib1f(x), sh.Attrib1f(y), sh.Attrib1f(0.5)]
        self.block(3, in_loop=False)
        return tuple(self.names)

    def number(self, depth=2):
        draw, kind = self.random, self.random.randrange(9 if depth else 2)
        if kind == 0:
            return sh.Attrib1f(round(draw.uniform(-2, 2), 2))
        if kind < 3:
            return draw.choice(self.names)
        a, b = self.number(depth - 1), self.number(depth - 1)
        function = draw.choice([sh.min, sh.hypot, sh.mod, sh.atan2])
        return [a + b, a - b, a * b, sh.cond(a < b, b, a), sh.sin(a), function(a, b)][kind - 3]

    def test(self):
        a, b = self.number(1), self.number(1)
        return self.random.choice([a < b, (a > b) | (b > 1), ~(a <= 0.5) & (b < a)])

    def block(self, depth, *, in_loop):
        for _ in range(self.random.randint(1, 3)):
            self.statement(depth, in_loop)

    def statement(self, depth, in_loop):
        kind = self.random.randrange(7 if depth else 3)
        if kind < 3:
            target = self.random.choice(self.names)
            target[:] = sh.clamp(self.number(), -4, 4)
        elif kind < 5:
            with SH_IF(self.test()):
                self.block(depth - 1, in_loop=in_loop)
                if in_loop:
                    self.random.choice([SH_BREAK, SH_CONTINUE])()
                elif self.random.randrange(4) == 0:
                    SH_RETURN(tuple(self.names), through=True)
            with SH_ELSE():
                self.block(depth - 1, in_loop=in_loop)
        else:
            with SH_FOR(0, self.random.randint(1, 4)) as k:
                self.names[0] += k * 0.25
                self.block(depth - 1, in_loop=True)
                SH_RETURN(tuple(self.names), self.test(), through=True)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("first", range(0, 30, 5))
def test_generated_programs_have_the_value_of_their_text(first):
    for number in range(first, first + 5):
        check(sh.program(Drawn(number)), {"x": X[:3], "y": Y[:3]}, 3)


HYPOTENUSE = """\
(FPCore hypotenuse (x y gain)
  :name "hypotenuse"
  :precision binary32
  :round nearestEven
  :pre (and (<= 1 gain 3) (<= 0.5 x 2))
  (let* ([t (* x x)]) (* gain (sqrt (+ t (* y y))))))
"""


def test_the_text_has_names_of_the_user_and_the_domain():
    @sh.program
    def hypotenuse(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
        t = x * x
        return GAIN * sh.sqrt(t + y * y)

    assert hypotenuse.fpcore({"x": (0.5, 2)}) == HYPOTENUSE
    for domain in ({"z": (0, 1)}, {"x": 3}, {"x": "ab"}):
        with pytest.raises(sh.ShpyTypeError, match="is no domain of an input") as caught:
            hypotenuse.fpcore(domain)
        assert "(-1, 1)" in str(caught.value.cure)


def test_names_that_fpcore_has_or_forbids_are_others():
    @sh.program
    def sqrt(E: sh.Attrib1f, größe: sh.Attrib1f) -> sh.Attrib1f:
        return E * größe

    core = read(sqrt.fpcore())
    assert parts(core)[0] == ["E_2", "gr__e"]
    assert evaluate(core, {"E_2": 3.0, "gr__e": 2.0}) == 6.0


TABLE = sh.Table(np.arange(4, dtype=np.float32), sh.Attrib1f)


def _table(x: sh.Attrib1f) -> sh.Attrib1f:
    return TABLE[sh.Attrib1i(x)]


def _array(x: sh.Attrib1f) -> sh.Attrib1f:
    a = sh.Array(sh.Attrib1f, 4)
    a[sh.Attrib1i(x)] = x
    return a[0]


def _bits(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.float_from_bits(sh.bits_from_float(x) | 1)


def _hash(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + sh.unit_float(sh.hash(sh.Attrib1i(x)))


def _discard(x: sh.Attrib1f) -> sh.Attrib1f:
    SH_DISCARD(x < 0)
    return x


def _place(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + sh.grid_index(1)


def _bool(b: sh.Attrib1b) -> sh.Attrib1f:
    return sh.cond(b, 1.0, 2.0)


LACKING = {
    _table: "no table", _array: "no arrays that change", _bits: "no bits_from_float", _hash: "no unsigned ints",
    _discard: "no results that are not written", _place: "no grid index", _bool: "no arguments of type b",
}  # fmt: skip


@pytest.mark.parametrize("function", LACKING, ids=lambda f: f.__name__)
def test_an_error_names_what_fpcore_lacks_at_its_line(function):
    with pytest.raises(sh.ShpyError, match=f"FPCore has {LACKING[function]}") as caught:
        sh.program(function).fpcore()
    first = function.__code__.co_firstlineno
    assert str(caught.value.loc).startswith(__file__)
    assert first <= caught.value.loc.line <= first + 3
    assert caught.value.cure
