"""Lists that hold one value several times, as `[sh.Attrib1f(0)] * 3`: a store into one item changes all of them.

Stage: record. Takes the expression that a name is bound to; gives how many indices lead to a value, and the list to
write instead.
"""

from __future__ import annotations

import ast

from shpy.lang.mistakes.kinds import Judge, Kind
from shpy.lang.recording.scope import Scope


def depth_of_repeats(node: ast.expr, judge: Judge, scope: Scope) -> int:
    """Return how many indices lead to a value of a list in which one value stands several times; 0 for all else."""
    repeats = any(_repeated(inner) or _from_keys(inner, scope) for inner in ast.walk(node))
    return max(_depth(node, judge, scope), 0) if repeats else 0


def store_depth(target: ast.expr) -> tuple[str | None, int]:
    """Return the name of a store's root, and how many indices and attributes follow it."""
    steps = 0
    while isinstance(target, ast.Attribute | ast.Subscript):
        target, steps = target.value, steps + 1
    return (target.id if isinstance(target, ast.Name) else None), steps


def apart(node: ast.expr) -> str:
    """Return the text that makes each item by itself: `[sh.Attrib1f(0) for _ in range(3)]`."""
    if pair := _repeated(node):
        items, times = pair
        (item,) = items.elts
        return f"[{apart(item)} for _ in range({ast.unparse(times)})]"
    match node:
        case ast.Call(args=[keys, value]) if ast.unparse(node.func) == "dict.fromkeys":
            return f"{{key: {apart(value)} for key in {ast.unparse(keys)}}}"
        case ast.List(elts=parts):
            return f"[{', '.join(apart(part) for part in parts)}]"
        case ast.ListComp():
            return ast.unparse(node).replace(ast.unparse(node.elt), apart(node.elt), 1)
        case ast.Name() | ast.Attribute() | ast.Subscript():
            return f"{ast.unparse(node)}.copy()"
    return ast.unparse(node)


def _repeated(node: ast.AST) -> tuple[ast.List | ast.Tuple, ast.expr] | None:
    """Return the list and the number of `[x] * 3` or `3 * [x]`; None where the list is not of one item."""
    if not isinstance(node, ast.BinOp) or not isinstance(node.op, ast.Mult):
        return None
    for items, times in ((node.left, node.right), (node.right, node.left)):
        if isinstance(items, ast.List | ast.Tuple) and len(items.elts) == 1:
            once = isinstance(times, ast.Constant) and times.value in (0, 1)
            return None if once or isinstance(items.elts[0], ast.Starred) else (items, times)
    return None


def _from_keys(node: ast.AST, scope: Scope) -> ast.expr | None:
    """Return the value of `dict.fromkeys(keys, value)`."""
    match node:
        case ast.Call(func=ast.Attribute(value=base, attr="fromkeys"), args=[_, value]) if scope.resolve(base) is dict:
            return value
    return None


def _depth(node: ast.expr, judge: Judge, scope: Scope) -> int:
    """Return how many indices lead from an expression to a value, -1 where that is not certain."""
    if pair := _repeated(node):
        return _deeper([_depth(item, judge, scope) for item in pair[0].elts])
    if value := _from_keys(node, scope):
        return _deeper([_depth(value, judge, scope)])
    match node:
        case ast.List(elts=items) | ast.Tuple(elts=items):
            return _deeper([_depth(item, judge, scope) for item in items])
        case ast.ListComp():
            return _deeper([_depth(node.elt, judge, scope)])
    return 0 if judge.kind(node).kind is Kind.VALUE else -1


def _deeper(depths: list[int]) -> int:
    return depths[0] + 1 if len(set(depths)) == 1 and depths[0] >= 0 else -1
