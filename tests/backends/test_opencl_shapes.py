"""Loops, expressions and stores in C-like text: it reads well and keeps the order of operations."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DO, SH_FOR, SH_IF, SH_UNTIL, SH_WHILE
from shpy.backend.base import Options
from shpy.backend.emit.structure import MAX_DEPTH
from shpy.backend.opencl.device.building import backend
from shpy.ir.builder import Builder
from shpy.ir.nodes import Continue, Module, Port, Value
from shpy.ir.types import Type, vec

F, INT, BOOL = vec("f"), vec("i"), vec("b")


def text(program: sh.Program, **options: Any) -> str:
    """The kernel's body, without comments and what every kernel begins with."""
    source = program.compile("opencl", **{"loop_limit": None, "lanes": 1} | options).source
    body = source[source.index("_in[") :] if "_in[" in source else source
    return re.sub(r"  //.*", "", body)


def expression(make: Callable[[Builder, list[Value]], Value], *types: Type) -> str:
    """Return the text of a value computed from inputs a, b, c, d."""
    b = Builder("expression")
    inputs = [b.input(t, name) for t, name in zip(types, "abcd", strict=False)]
    result = make(b, inputs)
    b.store(b.output(result.type, "r"), result)
    ports = tuple(Port(i.name or "", "") for i in inputs), (Port("r", ""),)
    source = backend.compile(Module("expression", *ports, (), (), (b.finish(),)), Options(lanes=1)).source
    found = re.search(r"r_out\[element\] = (.*);", source)
    assert found is not None
    return found[1]


def test_while() -> None:
    @sh.program
    def f(t: sh.Attrib1f, limit: sh.Attrib1f) -> sh.Attrib1f:
        with SH_WHILE(lambda: t < limit):
            t += 0.5
        return t

    assert "    while (t < limit) {\n        t += 0.5f;\n    }\n" in text(f)


def test_until() -> None:
    @sh.program
    def f(t: sh.Attrib1i) -> sh.Attrib1i:
        with SH_DO():
            t += 3
            SH_UNTIL(t > 10)
        return t

    assert "    do {\n        t += 3u;\n    } while (t <= 10);\n" in text(f)


def test_until_that_reads_what_is_declared_in_the_loop() -> None:
    @sh.program
    def f(t: sh.Attrib1f) -> sh.Attrib1f:
        with SH_DO():
            step = sh.sqrt(t)
            t += step
            SH_UNTIL(step > 10)
        return t

    assert "while (true) {\n        float step_ = sqrt(t);" in text(f)
    assert "        if (step_ > 10.0f) {\n            break;\n        }\n    }\n" in text(f)


def test_for_with_continue() -> None:
    @sh.program
    def f(n: sh.Attrib1i) -> sh.Attrib1i:
        total = sh.Attrib1i(0)
        with SH_FOR(2, n, 3) as k:
            SH_CONTINUE(k == 5)
            total += k
        with SH_FOR(n) as k:
            total ^= k
        return total

    assert "for (uint k = 0u; k < t; k += 1u) {\n" in text(f)
    assert "            continue;\n" in text(f)
    assert "for (int k = 0; k < n; k += 1) {\n        total ^= k;\n    }\n" in text(f)
    n = np.arange(12, dtype=np.int32)
    expected = [sum(k for k in range(2, m, 3) if k != 5) ^ int(np.bitwise_xor.reduce(np.arange(m))) for m in n]
    assert f.compile("opencl")(n).tolist() == expected


def test_a_continue_that_goes_to_the_test_of_a_do() -> None:
    @sh.program
    def f(n: sh.Attrib1i) -> sh.Attrib1i:
        k, total = sh.Attrib1i(0), sh.Attrib1i(0)
        with SH_DO():
            k += 1
            SH_CONTINUE(k == 5)
            total += k
            SH_UNTIL(lambda: k >= n)
        return total

    assert "            continue;\n        }\n        total += (uint)k;\n    } while (k < n);\n" in text(f)
    n = np.arange(8, dtype=np.int32)
    assert f.compile("opencl", lanes=1)(n).tolist() == [1, 1, 3, 6, 10, 10, 16, 23]


def test_a_continue_that_goes_to_a_test_with_statements() -> None:
    b = Builder("skip")
    x = b.input(INT, "x")
    n, odd = b.variable(INT, name="n"), b.variable(INT, name="odd")
    with b.loop(turns=1000) as loop:
        b.store(n, b.let("add", b.load(n), b.const(INT, [1])))
        even = b.let("eq", b.let("and", b.load(n), b.const(INT, [1])), b.const(INT, [0]))
        with b.when(even):
            b.exit(Continue)
        b.store(odd, b.let("add", b.load(odd), b.const(INT, [1])))
        loop.continuing()
        b.store(odd, b.let("mul", b.load(odd), b.const(INT, [3])))
        b.store(n, b.let("add", b.load(n), b.const(INT, [1])))
        loop.until(b.let("ge", b.load(n), x))
    b.store(b.output(INT, "r"), b.load(odd))
    module = Module("skip", (Port("x", "Attrib1i"),), (Port("r", "Attrib1i"),), (), (), (b.finish(),))
    program = sh.Program.from_ir(module)
    assert "    bool again = false;\n    while (true) {\n        if (again) {\n" in text(program)
    data = np.array([-3, 1, 2, 3, 8, 9], np.int32)
    found, expected = program.compile("opencl")(data), program.compile("numpy")(data)
    assert np.asarray(found).tolist() == np.asarray(expected).tolist()


def test_break_in_the_middle() -> None:
    @sh.program
    def f(t: sh.Attrib1f) -> sh.Attrib1f:
        with SH_DO():
            t *= 2
            SH_BREAK(t > 100)
            with SH_IF(t < 0):
                t *= -1
        return t

    assert "while (true) {\n        t *= 2.0f;\n        if (t > 100.0f) {\n            break;\n        }\n" in text(f)


def test_one_element_of_an_array_is_guarded_where_it_is_not_known() -> None:
    @sh.program
    def f(i: sh.Attrib1i) -> sh.Attrib1f:
        a = sh.Array(sh.Attrib1f, 4)
        a[1] = 2
        a[i] = 3
        return a[i] + a[0] + a[1]

    assert (
        "    float a[4] = {0.0f};\n    a[1] = 2.0f;\n    if (i >= 0 && i < 4) {\n        a[i] = 3.0f;\n    }\n"
        in text(f)
    )
    assert "a[sh_at(i, 4)] + a[0] + a[1]" in text(f)


def test_a_value_keeps_what_it_read_before_a_store() -> None:
    @sh.program
    def f(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
        before = sh.Attrib1f(x)
        with SH_IF(x > 0):
            x -= 1
        return before * x, x

    a, b = f.compile("opencl")(np.array([3, -3], np.float32))
    assert a.tolist() == [6, 9]
    assert b.tolist() == [2, -3]


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    ("expected", "make"),
    [
        ("-a * b", lambda b, v: b.let("mul", b.let("neg", v[0]), v[1])),
        ("-(a * b)", lambda b, v: b.let("neg", b.let("mul", v[0], v[1]))),
        ("a - b + c", lambda b, v: b.let("add", b.let("sub", v[0], v[1]), v[2])),
        ("a - (b + c)", lambda b, v: b.let("sub", v[0], b.let("add", v[1], v[2]))),
        ("a + (b + c)", lambda b, v: b.let("add", v[0], b.let("add", v[1], v[2]))),
        ("a * (b / c)", lambda b, v: b.let("mul", v[0], b.let("div", v[1], v[2]))),
        ("a / b / c", lambda b, v: b.let("div", b.let("div", v[0], v[1]), v[2])),
        ("a - -1.5f", lambda b, v: b.let("sub", v[0], b.const(F, [-1.5]))),
        ("a * 0.1f", lambda b, v: b.let("mul", v[0], b.const(F, [0.1]))),
        ("a * 1e-05f", lambda b, v: b.let("mul", v[0], b.const(F, [1e-5]))),
        ("a + -INFINITY", lambda b, v: b.let("add", v[0], b.const(F, [-np.inf]))),
        ("a < b ? b : (c < d ? c : d)", lambda b, v: b.let("cond", b.let("lt", v[0], v[1]), v[1],
            b.let("cond", b.let("lt", v[2], v[3]), v[2], v[3]))),
        ("!(a < b)", lambda b, v: b.let("not", b.let("lt", v[0], v[1]))),
        ("a != b", lambda b, v: b.let("not", b.let("eq", v[0], v[1]))),
        ("(a < b && c < d) || a < d", lambda b, v: b.let("or", b.let("and", b.let("lt", v[0], v[1]),
            b.let("lt", v[2], v[3])), b.let("lt", v[0], v[3]))),
        ("(a < b) == (c < d)", lambda b, v: b.let("eq", b.let("lt", v[0], v[1]), b.let("lt", v[2], v[3]))),
        ("(float2)(a, b) * c", lambda b, v: b.let("mul", b.let("construct", v[0], v[1], type=vec("f", 2)),
            b.splat(v[2], 2))),
        ("((float2)(a, b) + c).yx", lambda b, v: b.swizzle(b.let("add",
            b.let("construct", v[0], v[1], type=vec("f", 2)), b.splat(v[2], 2)), (1, 0))),
    ],
)  # fmt: skip
def test_floats_are_written_in_their_order(expected: str, make: Any) -> None:
    assert expression(make, F, F, F, F) == expected


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("expected", "make"),
    [
        ("a + 1u", lambda b, v: b.let("add", v[0], b.const(INT, [1]))),
        ("a - 1u", lambda b, v: b.let("add", v[0], b.const(INT, [-1]))),
        ("a * (uint)b + c", lambda b, v: b.let("add", b.let("mul", v[0], v[1]), v[2])),
        ("(int)(a + 1u) < b", lambda b, v: b.let("lt", b.let("add", v[0], b.const(INT, [1])), v[1])),
        ("a ^ (-2147483647 - 1)", lambda b, v: b.let("xor", v[0], b.const(INT, [-(2**31)]))),
        ("(a & b) | c", lambda b, v: b.let("or", b.let("and", v[0], v[1]), v[2])),
        ("(a << 2) ^ b", lambda b, v: b.let("xor", b.let("shl", v[0], b.const(INT, [2])), v[1])),
        ("~a", lambda b, v: b.let("not", v[0])),
        ("a >= b", lambda b, v: b.let("not", b.let("lt", v[0], v[1]))),
        ("min(max(a, b), c)", lambda b, v: b.let("clamp", v[0], v[1], v[2])),
    ],
)
def test_ints_wrap_and_read_well(expected: str, make: Any) -> None:
    assert expression(make, INT, INT, INT) == expected


def test_deep_expressions_become_temporaries() -> None:
    def make(b: Builder, v: list[Value]) -> Value:
        x = v[0]
        for _ in range(300):
            x = b.let("neg", b.let("sqrt", x))
        return x

    b = Builder("deep")
    a = b.input(F, "a")
    b.store(b.output(F, "r"), make(b, [a]))
    module = Module("deep", (Port("a", ""),), (Port("r", ""),), (), (), (b.finish(),))
    source = backend.compile(module, Options(lanes=1)).source
    for line in source.splitlines():
        depths = np.cumsum([(c == "(") - (c == ")") for c in line])
        assert max(depths, default=0) <= MAX_DEPTH + 2
    assert max(map(len, source.splitlines())) <= 140


def test_else_if_chains() -> None:
    @sh.program
    def f(x: sh.Attrib1i) -> sh.Attrib1i:
        r = sh.Attrib1i(0)
        with SH_IF(x == 0):
            r[:] = 5
        for k in range(1, 5):
            with sh.SH_ELIF(x == k):
                r[:] = k * k
        with sh.SH_ELSE():
            r[:] = -1
        return r

    assert text(f).count("} else if (x == ") == 4
    assert f.compile("opencl")(np.arange(-1, 6, dtype=np.int32)).tolist() == [-1, 5, 1, 4, 9, 16, -1]
