"""Python's precedence in the numpy printer: brackets stand where another reading were possible."""

import ast

import numpy as np
import pytest

import shpy as sh
from shpy.backends.numpy.expressions import Expr, call, condition, infix, item, method, name, negation, prefix, ternary

a, b, c = (name(n) for n in "abc")
COMBINED = {
    **{symbol: lambda x, y, symbol=symbol: infix(symbol, x, y) for symbol in "+ - * / // % & | ^ << >> < ==".split()},
    "-x": lambda x, y: prefix("-", x),
    "~x": lambda x, y: prefix("~", x),
    "negation": lambda x, y: negation(x),
    "condition": lambda x, y: condition(x),
    "condition of a negation": lambda x, y: condition(negation(x)),
    "if": lambda x, y: ternary(x, y, y),
    "then": lambda x, y: ternary(y, x, y),
    "else": lambda x, y: ternary(y, y, x),
    "call": lambda x, y: call("f", x, y),
    "method": lambda x, y: method(x, "sum", "0"),
    "item": lambda x, y: item(x, "0"),
}
"""Every way in which the printer puts an expression into another."""


@pytest.mark.parametrize("outer", COMBINED)
def test_an_expression_in_another_is_read_as_one_operand(outer: str) -> None:
    whole = ast.dump(ast.parse(COMBINED[outer](name("x"), c).text, mode="eval"))
    for inner, made in COMBINED.items():
        if inner.startswith("condition"):
            continue  # stands after `if` and `while` alone
        operand = made(a, b)
        found = COMBINED[outer](Expr(operand.text, operand.level), c)
        bracketed = whole.replace(
            ast.dump(ast.Name("x", ast.Load())), ast.dump(ast.parse(operand.text, mode="eval").body)
        )
        assert ast.dump(ast.parse(found.text, mode="eval")) == bracketed, f"{inner} in {outer}: {found.text}"
        flipped = COMBINED[outer](c, Expr(operand.text, operand.level))
        ast.parse(flipped.text, mode="eval")


def test_a_choice_among_uniform_bools_may_be_a_condition() -> None:
    p, q, r = (sh.Param(sh.Attrib1b, value, name=n) for n, value in (("p", True), ("q", False), ("r", True)))

    @sh.program
    def chosen(x: sh.Attrib1f) -> tuple[sh.Attrib1b, sh.Attrib1f]:
        second = sh.cond(sh.cond(p, q, r), r, sh.cond(q, p, r))
        return second ^ (x > 3), sh.cond(second, 2.0, x)

    kernel = chosen.compile("numpy")
    assert "if (q if p else r)" in kernel.source
    bools, numbers = kernel(np.float32([2, 4]))
    assert bools.tolist() == [True, False]
    assert numbers.tolist() == [2, 2]
