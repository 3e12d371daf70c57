"""Rewrite the user's expression in the operators of the language, for the texts of cures.

Stage: record. Takes an expression's tree; returns text.

    a < b < c → (a < b) & (b < c)      x and not y → x & ~y      1 if c else 2 → sh.cond(c, 1, 2)
"""

from __future__ import annotations

import ast
import copy
from functools import reduce

from shpy.parsing import parse

_LONGEST = 96


class _Rewriter(ast.NodeTransformer):
    """Rewrites Python's own logic as operators that values have."""

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        """Rewrite `and` as `&`, `or` as `|`."""
        self.generic_visit(node)
        operator = ast.BitAnd() if isinstance(node.op, ast.And) else ast.BitOr()
        return reduce(lambda left, right: ast.BinOp(left, operator, right), node.values)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        """Rewrite `not` as `~`."""
        self.generic_visit(node)
        return ast.UnaryOp(ast.Invert(), node.operand) if isinstance(node.op, ast.Not) else node

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Rewrite a chain as the `&` of its links; `in` a display compares with each item."""
        self.generic_visit(node)
        if joined := _joined(node):
            return joined
        links: list[ast.expr] = []
        left = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            if isinstance(operator, ast.In | ast.NotIn) and isinstance(right, ast.Tuple | ast.List | ast.Set):
                links.append(_membership(left, right.elts, wanted=isinstance(operator, ast.In)))
            else:
                links.append(ast.Compare(left, [operator], [right]))
            left = right
        return reduce(lambda a, b: ast.BinOp(a, ast.BitAnd(), b), links)

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Rewrite `a if c else b` as `cond(c, a, b)`."""
        self.generic_visit(node)
        function = parse(f"{self.prefix}cond", "eval").body
        return ast.Call(function, [node.test, node.body, node.orelse], [])

    def visit_Lambda(self, node: ast.Lambda) -> ast.expr:
        """Keep a lambda unchanged, since its body belongs to another function."""
        return node


def _joined(node: ast.Compare) -> ast.expr | None:
    """Return, for `a > 0 & b < 1`, a chain around `0 & b`, the two comparisons that were meant, in parentheses."""
    for k, middle in enumerate(node.comparators[:-1]):
        if isinstance(middle, ast.BinOp) and isinstance(middle.op, ast.BitAnd | ast.BitOr):
            first = ast.Compare(node.left, node.ops[: k + 1], [*node.comparators[:k], middle.left])
            second = ast.Compare(middle.right, node.ops[k + 1 :], node.comparators[k + 1 :])
            return ast.BinOp(first, middle.op, second)
    return None


def _membership(left: ast.expr, items: list[ast.expr], *, wanted: bool) -> ast.expr:
    """Rewrite `x in (a, b)` as `(x == a) | (x == b)`, `not in` as `(x != a) & (x != b)`."""
    sign: ast.cmpop = ast.Eq() if wanted else ast.NotEq()
    join: ast.operator = ast.BitOr() if wanted else ast.BitAnd()
    compared: list[ast.expr] = [ast.Compare(left, [sign], [item]) for item in items]
    return reduce(lambda a, b: ast.BinOp(a, join, b), compared) if compared else ast.Constant(not wanted)


def rewritten(node: ast.expr, prefix: str) -> str:
    """Return the expression's text with Python's logic (`and`, `not`, `a < b < c`) replaced; `prefix` is as `sh.`."""
    text = ast.unparse(ast.fix_missing_locations(_Rewriter(prefix).visit(copy.deepcopy(node))))
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
