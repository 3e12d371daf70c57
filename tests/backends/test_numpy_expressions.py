"""Python's precedence in the numpy printer: brackets stand where another reading were possible."""

import ast

import numpy as np
import pytest

import shpy as sh
from shpy.backend.emit.spell_python import PythonSpeller
from shpy.backend.emit.tree import BOOL, Expr, Index, Method, Name, call, choice, infix, negation, number, prefix

a, b, c = (Name(BOOL, n) for n in "abc")
COMBINED = {
    **{symbol: lambda x, y, symbol=symbol: infix(symbol, x, y) for symbol in "+ - * / // % & | ^ << >> < ==".split()},
    "-x": lambda x, y: prefix("-", x),
    "~x": lambda x, y: prefix("~", x),
    "negation": lambda x, y: negation(x),
    "if": lambda x, y: choice(x, y, y),
    "then": lambda x, y: choice(y, x, y),
    "else": lambda x, y: choice(y, y, x),
    "call": lambda x, y: call("f", BOOL, x, y),
    "method": lambda x, y: Method(BOOL, x, "sum", (number(0),)),
    "item": lambda x, y: Index(BOOL, x, number(0)),
}
"""Every way in which the tree puts an expression into another."""


def read(e: Expr, *, condition: bool = False) -> ast.expr:
    """Return how Python reads the text of an expression; `condition`: as it stands after `if`."""
    speller = PythonSpeller()
    return ast.parse(speller.condition(e)[0] if condition else speller.text(e), mode="eval").body


class _Put(ast.NodeTransformer):
    """Puts an expression in the place of the name x."""

    def __init__(self, operand: ast.expr) -> None:
        self.operand = operand

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self.operand if node.id == "x" else node


@pytest.mark.parametrize("condition", [False, True])
@pytest.mark.parametrize("outer", COMBINED)
def test_an_expression_in_another_is_read_as_one_operand(outer: str, condition: bool) -> None:
    for inner, made in COMBINED.items():
        if outer == "negation" and inner in ("<", "==", "negation"):
            continue  # the opposite is another comparison
        operand = made(a, b)
        found = read(COMBINED[outer](operand, c), condition=condition)
        wanted = _Put(read(operand)).visit(read(COMBINED[outer](Name(BOOL, "x"), c), condition=condition))
        if outer == "if" and inner == "negation":
            wanted.test = ast.UnaryOp(ast.Not(), ast.Name("a", ast.Load()))  # a choice has a condition
        assert ast.dump(found) == ast.dump(wanted), f"{inner} in {outer}"
        read(COMBINED[outer](c, operand), condition=condition)


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
