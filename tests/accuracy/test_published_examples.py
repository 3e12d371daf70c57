"""Roundings of published examples: the named line is that whose roundings alone change the result most.

The formulas are those of Hamming (Numerical Methods for Scientists and Engineers, chapter 3), by way of Herbie's suite
(Panchekha et al. 2015), and of Rosa's and FPTaylor's (Darulova and Kuncak 2014; Solovyev et al. 2015), as FPBench lists
them. Here each line is at most a few operations.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

import shpy as sh

F = sh.Attrib1f


class Example(NamedTuple):
    function: Callable[..., Any]
    domain: dict[str, Any]
    form: str | None = None


def two_sqrt(x: F) -> F:
    upper = sh.sqrt(x + 1)
    lower = sh.sqrt(x)
    return upper - lower


def two_cos(x: F, eps: F) -> F:
    there = x + eps
    moved = sh.cos(there)
    still = sh.cos(x)
    return moved - still


def two_sin(x: F, eps: F) -> F:
    there = x + eps
    moved = sh.sin(there)
    still = sh.sin(x)
    return moved - still


def two_log(n: F) -> F:
    upper = sh.log(n + 1)
    lower = sh.log(n)
    return upper - lower


def two_frac(x: F) -> F:
    more = x + 1
    first = 1 / more
    second = 1 / x
    return first - second


def three_frac(x: F) -> F:
    first = 1 / (x + 1)
    middle = 2 / x
    last = 1 / (x - 1)
    part = first - middle
    return part + last


def exp_less_one(x: F) -> F:
    power = sh.exp(x)
    return power - 1


def exp_ratio(x: F) -> F:
    power = sh.exp(x)
    below = power - 1
    return power / below


def quadratic_plus(a: F, b2: F, c: F) -> F:
    square = b2 * b2
    product = a * c
    under = square - product
    root = sh.sqrt(under)
    above = -b2 + root
    return above / a


def quadratic_minus(a: F, b2: F, c: F) -> F:
    square = b2 * b2
    product = a * c
    under = square - product
    root = sh.sqrt(under)
    above = -b2 - root
    return above / a


def one_less_cos(x: F) -> F:
    c = sh.cos(x)
    above = 1 - c
    square = x * x
    return above / square


def tan_half(x: F) -> F:
    c = sh.cos(x)
    above = 1 - c
    return above / sh.sin(x)


def logs(n: F) -> F:
    more = n + 1
    upper = more * sh.log(more)
    lower = n * sh.log(n)
    step = upper - lower
    return step - 1


def sine_less(x: F) -> F:
    s = sh.sin(x)
    return x - s


def triangle(a: F, b: F, c: F) -> F:
    around = a + b + c
    s = around / 2
    product = s * (s - a) * (s - b) * (s - c)
    return sh.sqrt(product)


def intro(t: F) -> F:
    below = t + 1
    return t / below


def verhulst(x: F) -> F:
    part = x / 1.11
    below = 1 + part
    above = 4.0 * x
    return above / below


def doppler(u: F, v: F, t: F) -> F:
    t1 = 331.4 + 0.6 * t
    below = (t1 + u) * (t1 + u)
    above = -t1 * v
    return above / below


def carbon_gas(v: F) -> F:
    ratio = 1000 / v
    pressure = 3.5e7 + 0.401 * ratio * ratio
    volume = v - 1000 * 42.7e-6
    product = pressure * volume
    return product - 1.3806503e-23 * 1000 * 300


def rigid_body(x1: F, x2: F, x3: F) -> F:
    first = -x1 * x2
    second = 2 * x2 * x3
    part = first - second
    less = part - x1
    return less - x3


def turbine(v: F, w: F, r: F) -> F:
    square = r * r
    part = 3 + 2 / square
    speed = w * w * square
    middle = 0.125 * (3 - 2 * v) * speed
    share = middle / (1 - v)
    rest = part - share
    return rest - 4.5


def jet_engine(x1: F, x2: F) -> F:
    t = 3 * x1 * x1 + 2 * x2 - x1
    square = x1 * x1 + 1
    s = t / square
    first = 2 * x1 * s * (s - 3)
    second = x1 * x1 * (4 * s - 6)
    third = (first + second) * square
    fourth = 3 * x1 * x1 * s
    total = third + fourth + x1 * x1 * x1 + x1 + 3 * s
    return x1 + total


EXAMPLES = [
    Example(two_sqrt, {"x": (1e3, 1e6, "log")}, "1 / (upper + lower)"),
    Example(two_cos, {"x": (0.5, 1.5), "eps": (1e-5, 1e-3, "log")}, "-2 * sh.sin((there + x) / 2) * sh.sin(eps / 2)"),
    Example(two_sin, {"x": (0.2, 1), "eps": (1e-5, 1e-3, "log")}, "2 * sh.cos((there + x) / 2) * sh.sin(eps / 2)"),
    Example(two_log, {"n": (1e2, 1e6, "log")}, "sh.log1p(1 / n)"),
    Example(two_frac, {"x": (1e2, 1e6, "log")}, "-1 / (more * x)"),
    Example(three_frac, {"x": (1e2, 1e4, "log")}),
    Example(exp_less_one, {"x": (1e-6, 1e-2, "log")}, "sh.expm1(x)"),
    Example(exp_ratio, {"x": (1e-4, 0.1, "log")}, "sh.expm1(x)"),
    Example(quadratic_plus, {"a": (0.1, 1), "b2": (10, 100), "c": (0.1, 1)}, "-product / (root + b2)"),
    Example(quadratic_minus, {"a": (0.1, 1), "b2": (-100, -10), "c": (0.1, 1)}, "product / (root - b2)"),
    Example(one_less_cos, {"x": (1e-3, 0.1, "log")}, "2 * sh.sin(x / 2) ** 2"),
    Example(tan_half, {"x": (1e-3, 0.1, "log")}, "2 * sh.sin(x / 2) ** 2"),
    Example(logs, {"n": (10, 1e4, "log")}),
    Example(sine_less, {"x": (1e-2, 1, "log")}),
    Example(triangle, {"a": (1, 1.1), "b": (1, 1.1), "c": (1.9, 2)}),
    Example(intro, {"t": (0, 999)}),
    Example(verhulst, {"x": (0.1, 0.3)}),
    Example(doppler, {"u": (-100, 100), "v": (20, 20000), "t": (-30, 50)}),
    Example(carbon_gas, {"v": (0.1, 0.5)}),
    Example(rigid_body, {"x1": (-15, 15), "x2": (-15, 15), "x3": (-15, 15)}),
    Example(turbine, {"v": (-4.5, -0.3), "w": (0.4, 0.9), "r": (3.8, 7.8)}),
    Example(jet_engine, {"x1": (-5, 5), "x2": (-20, 5)}),
]


class Rounded(np.lib.mixins.NDArrayOperatorsMixin):
    """Numbers in binary64 whose operations, and numbers beside them, are rounded to binary32."""

    def __init__(self, numbers: Any) -> None:
        self.numbers = numbers

    def __array_ufunc__(self, function: np.ufunc, method: str, *operands: Any) -> Rounded:
        return Rounded(once(function(*(x.numbers if isinstance(x, Rounded) else once(x) for x in operands))))


def once(numbers: Any) -> Any:
    return np.float64(np.float32(numbers))


class Numbers:
    """The functions of `sh` that the examples use, as numpy's."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)


def with_rounded_line(function: Callable[..., Any], inputs: dict[str, Any], line: int | None) -> Any:
    """Return the function in binary64, with the operations of one line rounded to binary32."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    assert isinstance(body, ast.FunctionDef)
    names: dict[str, Any] = {n: x.astype(np.float64) for n, x in inputs.items()}
    for k, s in enumerate(body.body):
        assert isinstance(s, ast.Assign | ast.Return)
        assert s.value is not None
        operands = {n: Rounded(x) if k == line else x for n, x in names.items()}
        value = eval(compile(ast.Expression(s.value), "example", "eval"), {"sh": Numbers(), **operands})
        value = value.numbers if isinstance(value, Rounded) else value
        names[ast.unparse(s.targets[0]) if isinstance(s, ast.Assign) else "result"] = value
    return names["result"]


@pytest.mark.sampled(6)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.function.__name__)
def test_the_line_is_named(example: Example) -> None:
    report = sh.accuracy.roundings(sh.program(example.function), example.domain, samples=400)
    texts = [text.strip() for text in inspect.getsource(example.function).splitlines()[1:]]
    exact = with_rounded_line(example.function, report.inputs, None)
    assert np.allclose(exact, report.values, rtol=1e-9)
    worst, most = "", 0.0
    for k, text in enumerate(texts):
        change = np.abs(with_rounded_line(example.function, report.inputs, k) - exact) / report.bounds
        assert (change <= 1.001).all()
        if np.mean(change) > most:
            worst, most = text, float(np.mean(change))
    shares = {line.text: line.share for line in report.lines}
    assert shares[worst] >= 0.6 * report.lines[0].share, report
    forms = [form.new for line in report.lines for form in line.forms]
    if example.form is not None:
        assert forms == [example.form]
        assert report.better is not None
