"""The parentheses that comparisons joined by `&` and `|` lack: `a < b | c > d` compares with `b | c`.

Stage: record, where `&` or `|` got a float. Takes the user's line; gives the comparisons that were meant, or None.

    parenthesized(loc)      # "(a < b) | (c > d)"
"""

from __future__ import annotations

import ast
from functools import reduce
from itertools import pairwise

from shpy.errors import Loc


def parenthesized(loc: Loc | None) -> str | None:
    """Return the text of the first chain of comparisons around an `&` or `|` on a line, with its parentheses."""
    if loc is None or loc.text is None or loc.text.tree is None:
        return None
    for node in ast.walk(loc.text.tree):
        if isinstance(node, ast.Compare) and node.lineno <= loc.line <= (node.end_lineno or node.lineno):
            joined = joined_comparisons(node)
            if joined is not None:
                return ast.unparse(ast.fix_missing_locations(joined))
    return None


def joined_comparisons(node: ast.Compare) -> ast.expr | None:
    """Return the comparisons that a chain around `0 & b`, as in `a > 0 & b < 1`, was meant to be; None without one."""
    operands = [node.left, *node.comparators]
    cuts = [k for k, o in enumerate(operands) if isinstance(o, ast.BinOp) and isinstance(o.op, ast.BitAnd | ast.BitOr)]
    cuts = [k for k in cuts if 0 < k < len(operands) - 1]
    if not cuts:
        return None
    comparisons, signs = list[ast.expr](), list[ast.operator]()
    for start, end in pairwise([0, *cuts, len(operands) - 1]):
        first, last = operands[start], operands[end]
        left = first.right if start in cuts and isinstance(first, ast.BinOp) else first
        right = last.left if end in cuts and isinstance(last, ast.BinOp) else last
        comparisons.append(ast.Compare(left, node.ops[start:end], [*operands[start + 1 : end], right]))
        if end in cuts and isinstance(last, ast.BinOp):
            signs.append(last.op)
    groups = [[comparisons[0]]]  # `&` binds tighter than `|`, as `and` does
    for sign, comparison in zip(signs, comparisons[1:], strict=True):
        if isinstance(sign, ast.BitAnd):
            groups[-1].append(comparison)
        else:
            groups.append([comparison])
    whole = [reduce(lambda a, b: ast.BinOp(a, ast.BitAnd(), b), group) for group in groups]
    return reduce(lambda a, b: ast.BinOp(a, ast.BitOr(), b), whole)
