"""Control flow on GLSL: loops and the device's own limit, discards, early returns, blocks nested deep, NaN."""

from typing import Any

import numpy as np
import pytest
from loop_stops import stops_loops

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


def glsl(program: Any, **options: Any) -> Any:
    return program.compile("glsl", **options)


def test_all_control_flow_at_once() -> None:
    @sh.program
    def collatz(n: sh.Attrib1i) -> tuple[sh.Attrib1i, sh.Attrib1f]:
        steps = sh.Attrib1i(0)
        kind = sh.Attrib1f(0)
        with SH_WHILE(lambda: n > 1):
            steps += 1
            with SH_IF(n % 2 == 0):
                n[:] = n // 2
                SH_CONTINUE()
            n[:] = 3 * n + 1
            SH_BREAK(steps > 100)
        with SH_FOR(0, 7, 2) as i:
            with SH_IF(steps == i):
                kind[:] = 1
            with SH_ELIF(steps > 50):
                kind += 0.5
            with SH_ELSE():
                with SH_IF(n < 0):
                    SH_RETURN((steps, -kind))
        return steps, kind

    n = np.arange(-5, 3000, dtype=np.int32)
    found = glsl(collatz)(n)
    expected = [_collatz(int(k)) for k in n]
    assert found[0].tolist() == [e[0] for e in expected]
    assert found[1].tolist() == [e[1] for e in expected]


def _collatz(n: int) -> tuple[int, float]:
    steps, kind = 0, 0.0
    while n > 1:
        steps += 1
        if n % 2 == 0:
            n //= 2
            continue
        n = 3 * n + 1
        if steps > 100:
            break
    for i in range(0, 7, 2):
        if steps == i:
            kind = 1.0
        elif steps > 50:
            kind += 0.5
        elif n < 0:
            return steps, -kind
    return steps, kind


def test_a_condition_on_nan_is_false_whatever_the_compiler_makes_of_it() -> None:
    """Mesa negates this one, and `!(a < b)` is not `a >= b` for NaN."""

    @sh.program
    def ends(x: sh.Attrib2f) -> tuple[sh.Attrib1f, sh.Attrib1i]:
        with SH_IF(sh.all(x < 0)):
            with SH_IF(x.x < -1e9):
                SH_RETURN((0.0, 2))
            SH_RETURN((x.x, 1))
        with SH_ELSE():
            SH_RETURN((5.0, 3))

    values = np.array([np.nan, -3, 1, np.inf, -np.inf, 0, 2], np.float32)
    x = np.stack(np.meshgrid(values, values), -1).reshape(-1, 2)
    below = (x < 0).all(-1)
    _, kind = glsl(ends)(x)
    assert np.array_equal(kind, np.where(below, np.where(x[:, 0] < -1e9, 2, 1), 3))


@pytest.mark.parametrize("math", ["strict", "relaxed"])
def test_a_sum_that_is_its_own_summand_is_so_by_rounding_too(math: Any) -> None:
    """Mesa rewrites `x + a == x` as `a == 0` in a condition that is not `precise`."""

    @sh.program
    def absorbed(x: sh.Attrib1f, a: sh.Attrib1f) -> sh.Attrib1i:
        found = sh.Attrib1i(0)
        with SH_IF(x + a == x):
            found += 1
        with SH_IF(x != x + a * a):
            found += 2
        return found

    x = np.array([1e8, 1e8, 1, np.inf, np.inf], np.float32)
    a = np.array([1, 0, 1, 1e30, -np.inf], np.float32)
    assert absorbed.compile("glsl", math=math)(x, a).tolist() == [1, 1, 2, 1, 0]


COMPARED = [
    "x - a < x",
    "x + a > x",
    "x + a == x",
    "x * a != x",
    "x / a >= x",
    "-x - a <= -x",
    "sh.abs(x - a) < x",
    "(x - a < x) & (a != 3)",
    "~(x + a >= x + 1)",
    "sh.all(sh.vec2(x, a) - a < x)",
]


@pytest.mark.parametrize("place", ["after an exit", "in a loop", "nested", "converted", "a sum"])
@pytest.mark.parametrize("k", range(len(COMPARED)))
def test_choices_by_rounded_numbers_have_the_bits_of_numpy(k: int, place: str) -> None:
    """Mesa rewrites `x - a < x` as `0 < a` in the condition of a choice, where early exits or loops stand around it.

    A value that has a name in the program has one in the text, too, so the conditions are evaluated from strings.
    """

    @sh.program
    def chosen(x: sh.Attrib1f, a: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
        SH_DISCARD(n == 7)
        r = sh.Attrib1f(1)
        if place == "in a loop":
            with SH_FOR(3):
                r[:] = sh.cond(eval(COMPARED[k], {"x": x, "a": a, "sh": sh}), r + 3, r + 5)
        elif place == "nested":
            r[:] = sh.cond(
                eval(COMPARED[k], {"x": x, "a": a, "sh": sh}),
                sh.cond(eval(COMPARED[k], {"x": a, "a": x, "sh": sh}), 3.0, 4.0),
                5.0,
            )
        elif place == "converted":
            r[:] = sh.Attrib1f(eval(COMPARED[k], {"x": x, "a": a, "sh": sh})) * 2
        elif place == "a sum":
            r[:] = sh.max(a, 0) + sh.cond(eval(COMPARED[k], {"x": x, "a": a, "sh": sh}), x, 5.0)
        return sh.cond(eval(COMPARED[k], {"x": x, "a": a, "sh": sh}), 3.0, 5.0) if place == "after an exit" else r

    numbers = np.array([1e8, -1e8, 1, -1, 0, -0.0, 0.1, 3, 1e30, np.inf, -np.inf, np.nan], np.float32)
    x, a = (v.ravel() for v in np.meshgrid(numbers, numbers))
    n = np.arange(len(x), dtype=np.int32) % 9
    assert np.array_equal(glsl(chosen)(x, a, n), chosen.compile("numpy")(x, a, n), equal_nan=True)


@pytest.mark.parametrize("limit", [None, 100])
@pytest.mark.parametrize("math", ["strict", "portable", "relaxed", "fast"])
def test_elements_that_have_left_a_loop_keep_its_values(math: Any, limit: int | None) -> None:
    """llvmpipe of Mesa 22 went on computing `x`, where the loop had one end, at the end of an iteration."""

    @sh.program
    def squares(x: sh.Attrib1f, v: sh.Attrib1f) -> sh.Attrib1f:
        v = v * v
        j, k = sh.Attrib1i(0), sh.Attrib1i(0)
        with SH_WHILE(lambda: j < 8):
            j += 1
        with SH_DO():
            k += 1
            x[:] = v * v
            v[:] = x + 0.0
            SH_UNTIL(lambda: (k >= 8) | (v < 100))
        return x

    v = np.array([0.5, 1.25, 0.1, 10], np.float32)
    result = glsl(squares, math=math, loop_limit=limit)(v, v)
    assert np.allclose(result, squares.compile("numpy")(v, v), 1e-5)


def test_arrays_and_subroutines_by_reference() -> None:
    @sh.subroutine
    def bump(x: sh.Attrib2f, by: sh.Attrib1f) -> sh.Attrib1f:
        x += by
        return x.x * 2

    @sh.program
    def mix(i: sh.Attrib1i, v: sh.Attrib1f) -> tuple[sh.Attrib2f, sh.Attrib1f]:
        a = sh.Array(sh.Attrib1f, 8)
        a[i] = v
        a[i + 1] = v + 1
        total = sh.Attrib1f(0)
        with SH_FOR(0, 8) as k:
            total += a[k] * sh.Attrib1f(k + 1)
        x = sh.Attrib2f(total, a[i])
        y = bump(x, sh.Attrib1f(10))
        return x, y

    i, v = np.arange(-3, 11, dtype=np.int32), np.float32(4)
    x, y = glsl(mix)(i, v)
    for k, index in enumerate(i):
        a = np.zeros(8)
        if 0 <= index < 8:
            a[index] = 4
        if 0 <= index + 1 < 8:
            a[index + 1] = 5
        expected = (a * np.arange(1, 9)).sum() + 10, a[np.clip(index, 0, 7)] + 10
        assert tuple(x[k]) == expected
        assert y[k] == expected[0] * 2


def test_discarded_elements_keep_what_was_there() -> None:
    @sh.program
    def positive(x: sh.Attrib1f) -> sh.Attrib1f:
        with SH_IF(x < 0):
            SH_DISCARD()
        return sh.sqrt(x)

    x = np.linspace(-1, 1, 101).astype(np.float32)
    out = np.full(101, 9, np.float32)
    result = glsl(positive).run(x, out=out)
    assert np.array_equal(out, np.where(x < 0, np.float32(9), np.sqrt(np.maximum(x, 0))))
    assert result.count == (x >= 0).sum()


def test_a_loop_past_its_limit_is_told_with_its_line() -> None:
    @sh.program
    def forever(x: sh.Attrib1f) -> sh.Attrib1f:
        with SH_WHILE(lambda: x > 0):
            x += 1
        return x

    x = np.array([-1, 1, -2, 3], np.float32)
    with pytest.raises(sh.LoopLimitExceeded) as error:
        glsl(forever, loop_limit=100)(x)
    assert error.value.count == 2
    assert error.value.loc.line == forever_line()


def forever_line() -> int:
    """The line of `with SH_WHILE` above."""
    with open(__file__) as file:
        return next(n for n, line in enumerate(file, 1) if "lambda: x > 0" in line)


@pytest.mark.sampled(9)
@pytest.mark.parametrize("limit", [1 << 20, None])
@pytest.mark.parametrize("shape", ["while", "do", "for", "nested"])
def test_a_loop_that_the_device_stops_is_told_or_right(shape: str, limit: int | None) -> None:
    """llvmpipe stops after 65,535 iterations in all, in silence; other devices go on."""

    @sh.program
    def chaos(n: sh.Attrib1i) -> sh.Attrib1i:
        i, x = sh.Attrib1i(0), sh.Attrib1i(1)

        def step() -> None:
            """Take a step that no compiler has a closed form of: some of them run no loop that only counts."""
            x[:] = x * 1_664_525 + 1_013_904_223
            i[:] = i + 1

        if shape == "while":
            with SH_WHILE(lambda: i < n):
                step()
        elif shape == "do":
            with SH_DO():
                step()
                SH_UNTIL(i >= n)
        elif shape == "for":
            with SH_FOR(0, n):
                step()
        else:
            with SH_FOR(0, 300):
                with SH_FOR(0, 300):
                    with SH_IF(i < n):
                        step()
        return x

    few = np.array([1, 2, 100, 65000], np.int32)
    many = np.array([70_000, 80_000, 90_000], np.int32)
    kernel, expected = glsl(chaos, loop_limit=limit), chaos.compile("numpy")
    if shape != "nested":
        assert np.array_equal(kernel(few), expected(few))
    if not stops_loops():
        assert np.array_equal(kernel(many), expected(many))
        return
    with pytest.raises(sh.LoopLimitExceeded) as error:
        kernel(many)
    assert "device" in str(error.value)
    assert error.value.count == 3


def test_blocks_nested_deep_are_right_or_refused() -> None:
    def deep(levels: int) -> Any:
        def body(x: sh.Attrib1i, k: int, n: sh.Attrib1i) -> None:
            with SH_IF(x > k):
                n += 1
                if k + 1 < levels:
                    body(x, k + 1, n)

        @sh.program
        def nested(x: sh.Attrib1i) -> sh.Attrib1i:
            n = sh.Attrib1i(0)
            body(x, 0, n)
            return n

        return nested

    x = np.random.default_rng(5).integers(-3, 70, 5000).astype(np.int32)
    assert np.array_equal(glsl(deep(60))(x), np.clip(x, 0, 60))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("count", [20, 100, 250])
def test_many_early_returns_do_not_nest_too_deep(count: int) -> None:
    """llvmpipe forgets conditions past 79, and to it what follows a return is nested in it."""

    @sh.program
    def search(x: sh.Attrib1i) -> tuple[sh.Attrib1i, sh.Attrib1f]:
        t = sh.Attrib1i(x)
        for k in range(count):
            SH_RETURN((3 * k, 0.5), x == k)
            t[:] = 3 * t + k
        return t, 1.5

    x = np.random.default_rng(6).integers(-3, 270, 5000).astype(np.int32)
    t = x.copy()
    with np.errstate(over="ignore"):
        for k in range(count):
            t = (3 * t + np.int32(k)).astype(np.int32)
    early = (x >= 0) & (x < count)
    kernel = glsl(search)
    found, kind = kernel(x)
    assert np.array_equal(found, np.where(early, 3 * x, t))
    assert np.array_equal(kind, np.where(early, 0.5, 1.5))
    assert ("while (sh_running)" in kernel.source) == (count > 20)


def test_subroutines_that_nest_too_deep_together_are_refused() -> None:
    def nest(x: sh.Attrib1i, n: sh.Attrib1i, k: int, inside: Any) -> None:
        with SH_IF(x > k):
            n += 1
            if k < 39:
                nest(x, n, k + 1, inside)
            elif inside is not None:
                n += inside(x)

    @sh.subroutine
    def inner(x: sh.Attrib1i) -> sh.Attrib1i:
        n = sh.Attrib1i(0)
        nest(x, n, 0, None)
        return n

    @sh.program
    def outer(x: sh.Attrib1i) -> sh.Attrib1i:
        n = sh.Attrib1i(0)
        nest(x, n, 0, inner)
        return n

    with pytest.raises(
        sh.CompileError, match=r"test_glsl_control.py:\d+: 80 blocks inside each other, subroutines counted in"
    ):
        glsl(outer)


def test_a_long_chain_of_elifs() -> None:
    @sh.program
    def chain(x: sh.Attrib1i) -> sh.Attrib1i:
        n = sh.Attrib1i(-1)
        with SH_IF(x == 0):
            n[:] = 0
        for k in range(1, 55):
            with SH_ELIF(x == k):
                n[:] = k * k
        return n

    x = np.random.default_rng(5).integers(-3, 70, 5000).astype(np.int32)
    assert np.array_equal(glsl(chain)(x), np.where((x >= 0) & (x < 55), x * x, -1))
