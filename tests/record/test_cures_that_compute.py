"""Cures of Python's logic and of functions of numbers fit the types at hand, and compute what Python would."""

import math
import random

import numpy as np
import pytest
from source_text import made

import shpy as sh

INTS = [-3, -1, 0, 1, 2, 8]
FLOATS = [-3.25, -1.0, -0.0, 0.0, 0.5, 2.0, 7.75]


def cure_of(kind, expression, result=None):
    """Return the cure for an expression of x and y in a program."""
    text = f"import math\ndef f(x: sh.{kind}, y: sh.{kind}) -> sh.{result or kind}:\n    return {expression}\n"
    with pytest.raises(sh.RecordError) as caught:
        sh.program(made(text, sh=sh, math=math, np=np, random=random, sine=math.sin))
    assert caught.value.loc.line == 3
    assert caught.value.loc.file.startswith("<program")
    return caught.value.cure


VALUES = {
    ("Attrib1i", "x or 7"): "sh.cond(x != 0, x, 7)",
    ("Attrib1i", "x and y"): "sh.cond(x != 0, y, x)",
    ("Attrib1i", "x and y and 5"): "sh.cond(x != 0, sh.cond(y != 0, 5, y), x)",
    ("Attrib1i", "sh.Attrib1i(not x)"): "x == 0",
    ("Attrib1i", "y if x else 4"): "sh.cond(x != 0, y, 4)",
    ("Attrib1i", "y if not x and y > 1 else 4"): "sh.cond((x == 0) & (y > 1), y, 4)",
    ("Attrib1i", "y if x in range(2) else x"): "sh.cond((x >= 0) & (x < 2), y, x)",
    ("Attrib1i", "y if x not in range(-1, 2) else x"): "sh.cond((x < -1) | (x >= 2), y, x)",
    ("Attrib1f", "x or y"): "sh.cond(x != 0, x, y)",
    ("Attrib1f", "math.fmod(x, 2)"): "x - 2 * sh.trunc(x / 2)",
    ("Attrib1f", "math.fmod(x + 1, y + 9)"): "(x + 1) - (y + 9) * sh.trunc((x + 1) / (y + 9))",
    ("Attrib1f", "math.copysign(x, y)"): "sh.cond(sh.bits_from_float(y) >= 2**31, -abs(x), abs(x))",
    ("Attrib1f", "round(x, 1)"): "sh.round(x * 10**1) / 10**1",
    ("Attrib1f", "round(x, ndigits=1)"): "sh.round(x * 10**1) / 10**1",
    ("Attrib1f", "np.clip(x, a_min=0, a_max=1)"): "sh.clamp(x, 0, 1)",
    ("Attrib1f", "np.max([x, y, 1])"): "sh.max(x, y, 1)",
    ("Attrib1f", "np.amin((x, y))"): "sh.min(x, y)",
    ("Attrib1f", "np.square(x)"): "x * x",
}


@pytest.mark.parametrize(("kind", "expression"), VALUES)
def test_a_cure_computes_what_python_does(kind, expression):
    cure = cure_of(kind, expression)
    assert cure == VALUES[kind, expression]
    numbers = INTS if kind == "Attrib1i" else FLOATS
    text = f"def f(x: sh.{kind}, y: sh.{kind}) -> sh.{kind}:\n    return sh.{kind}({cure})\n"
    program = sh.program(made(text, sh=sh))
    wanted = expression.replace("sh.Attrib1i", "int")
    for x in numbers:
        for y in numbers:
            assert program(x, y) == pytest.approx(eval(wanted, {"math": math, "np": np}, {"x": x, "y": y}), abs=1e-6)


BOOLS = {
    ("Attrib1b", "x or y", None): "x | y",
    ("Attrib1b", "not x and y", None): "~x & y",
    ("Attrib3f", "y if x == 0 else x", None): "sh.cond(sh.all(x == 0), y, x)",
    ("Attrib3f", "y if x != y else x", None): "sh.cond(sh.any(x != y), y, x)",
    ("Attrib3f", "y if x else x", None): "sh.cond(sh.any(x != 0), y, x)",
    ("Attrib3f", "y if x.y else x", None): "sh.cond(x.y != 0, y, x)",
    ("Attrib3f", "y if x[1] else x", None): "sh.cond(x[1] != 0, y, x)",
    ("Attrib3f", "y if sh.any(x > 1) and x.x else x", None): "sh.cond(sh.any(x > 1) & (x.x != 0), y, x)",
    ("Attrib3b", "x if x else y", None): "sh.cond(sh.all(x), x, y)",
    ("Attrib3f", "y if sh.isnan(x) else x", None): "sh.cond(sh.all(sh.isnan(x)), y, x)",
    ("Attrib1f", "y if (x - 1) * 2 else x", None): "sh.cond((x - 1) * 2 != 0, y, x)",
    ("Attrib1f", "np.logical_and(x > 0, y > 0)", "Attrib1b"): "(x > 0) & (y > 0)",
    ("Attrib3f", "np.concatenate([x.xy, [1]])", None): "sh.vec3(x.xy, 1)",
}


@pytest.mark.parametrize(("kind", "expression", "result"), BOOLS)
def test_a_cure_has_the_form_of_its_operands(kind, expression, result):
    assert cure_of(kind, expression, result) == BOOLS[kind, expression, result]


OTHERS = {
    "sine(x)": "sh.sin(x)",
    "random.randint(0, x)": "the bits of sh.hash(i), the same in every run",
    "math.log(x, 2)": "sh.log(x) / sh.log(2)",
    "math.expm1(x)": "sh.tanh(x / 2) * (sh.exp(x) + 1)",
    "np.expm1(x + y)": "sh.tanh((x + y) / 2) * (sh.exp((x + y)) + 1)",
    "complex(x).real": "a vector of two, sh.vec2(x, 0)",
    "sh.Attrib1f(math.gamma(x))": "a function of shpy, such as `sh.sqrt`",
}


@pytest.mark.parametrize("expression", OTHERS)
def test_a_function_of_numbers_has_a_cure_at_the_users_line(expression):
    assert cure_of("Attrib1i" if "randint" in expression else "Attrib1f", expression) == OTHERS[expression]


SPELLED = {
    "expm1": np.expm1,
    "log1p": np.log1p,
    "cbrt": np.cbrt,
    "sinpi": lambda x: np.where(x == np.rint(x), 0, np.sin(np.pi * (x - 2 * np.rint(x / 2)))),
    "cospi": lambda x: np.where(x - 0.5 == np.rint(x - 0.5), 0, np.cos(np.pi * (x - 2 * np.rint(x / 2)))),
    "tanpi": lambda x: np.tan(np.pi * (x - np.rint(x))),
}


@pytest.mark.parametrize("name", SPELLED)
def test_a_function_that_is_spelled_out_is_accurate_for_all_arguments(name):
    with pytest.raises(sh.ShpyAttributeError) as caught:
        getattr(sh, name)
    program = sh.program(
        made(f"def f(x: sh.Attrib1f) -> sh.Attrib1f:\n    return {caught.value.cure}\n", sh=sh, math=math)
    )
    draw = np.random.default_rng(49)
    near = [1e-8, -1e-8, 1e-40, 0.25, -0.75, 1, -1, 3, 1001, 1e-3, 88, -200, np.nan]
    ends = [np.inf, -np.inf] if not name.endswith("pi") else []
    drawn = draw.normal(size=4000) * 10.0 ** draw.uniform(-38, 6, 4000)
    x = np.concatenate([drawn, draw.uniform(-2, 2, 2000), near, ends]).astype(np.float32)
    if name == "tanpi":  # whose poles numpy's own pi misses
        x = x[np.abs(np.abs(x - np.rint(x)) - 0.5) > 1e-3]
    with np.errstate(all="ignore"):
        wanted = SPELLED[name](x.astype(np.float64)).astype(np.float32)
    found = program.compile("numpy")(x)
    with np.errstate(all="ignore"):
        error = np.abs(found.astype(np.float64) - wanted) / np.spacing(np.abs(wanted)).astype(np.float64)
    agree = (found == wanted) | (np.isnan(found) & np.isnan(wanted))
    assert (agree | (error < (20 if name == "cbrt" else 5))).all()
