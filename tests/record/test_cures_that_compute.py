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
    "math.expm1(x)": "sh.expm1(x)",
    "np.log1p(x + y)": "sh.log1p(x + y)",
    "math.erfc(x)": "sh.erfc(x)",
    "np.cbrt(x)": "sh.cbrt(x)",
    "complex(x).real": "a vector of two, sh.vec2(x, 0)",
    "sh.Attrib1f(math.gamma(x))": "a function of shpy, such as `sh.sqrt`",
}


@pytest.mark.parametrize("expression", OTHERS)
def test_a_function_of_numbers_has_a_cure_at_the_users_line(expression):
    assert cure_of("Attrib1i" if "randint" in expression else "Attrib1f", expression) == OTHERS[expression]
