"""The expressions of a text: which objects they mean in a running frame, and how they are written in the language.

Stage: record. Takes an expression's tree, and the frame that computes it where it is known; runs none of it.

    named: x → the local or global x      self.k → the instance's k      math.sin → the function
    rewritten: a < b < c → (a < b) & (b < c)      x and not y → x & ~y      1 if c else 2 → sh.cond(c, 1, 2)
               with an int n:      not n → n == 0      n or 7 → sh.cond(n != 0, n, 7)
    parenthesized: a < b | c > d, which compares with `b | c` → (a < b) | (c > d)
"""

from __future__ import annotations

import ast
import copy
import inspect
from functools import reduce
from itertools import pairwise
from types import FrameType, ModuleType
from typing import Any, NamedTuple, TypeAlias

from shpy.errors import Loc
from shpy.ir.types import Base
from shpy.lang.recording.symbolic import Symbolic
from shpy.parsing import parse

_LONGEST = 96
_BITS: TypeAlias = ast.BitAnd | ast.BitOr | ast.BitXor
_OF_BOOLS = ("any", "all")
_TO_BOOLS = ("isnan", "isinf")


def is_vector(thing: object) -> bool:
    """Return whether this is a scalar or vector of the language, or the class of one."""
    cls = thing if isinstance(thing, type) else type(thing)
    return issubclass(cls, Symbolic) and hasattr(cls, "base")


def named(node: ast.expr, frame: FrameType | None) -> Any:
    """Return the object that a name, or a path of attributes, means in `frame`; None without a frame."""
    if frame is None:
        return None
    if isinstance(node, ast.Name):
        for names in (frame.f_locals, frame.f_globals, frame.f_builtins):
            if node.id in names:
                return names[node.id]
        return None
    if isinstance(node, ast.Attribute):
        owner = named(node.value, frame)
        return None if owner is None or is_vector(owner) else _attribute(owner, node.attr)
    return None


def _attribute(owner: object, name: str) -> Any:
    """Return an attribute that is stored, not computed."""
    value = inspect.getattr_static(owner, name, None)
    if isinstance(value, staticmethod):
        return value.__func__
    return None if inspect.isdatadescriptor(value) else value


def prefix_of(frame: FrameType | None) -> str:
    """Return the user's prefix of shpy's names: `sh.` after `import shpy as sh`."""
    for name, thing in frame.f_globals.items() if frame is not None else ():
        if isinstance(thing, ModuleType) and thing.__name__ == "shpy":
            return f"{name}."
    return "sh."


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


class _Form(NamedTuple):
    """The form of a value: bools or numbers, and the number of components."""

    bools: bool
    size: int


_BOOL = _Form(True, 1)


class _Rewriter(ast.NodeTransformer):
    """Rewrites Python's own logic as operators that values have."""

    def __init__(self, prefix: str, frame: FrameType | None) -> None:
        self.prefix, self.frame = prefix, frame

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        """Rewrite `and` of bools as `&`, `or` as `|`; of numbers as the choice that Python makes."""
        forms = [self.form(value) for value in node.values]
        if all(form is None or form.bools for form in forms):
            return self.joined(node)
        *first, last = node.values
        chosen: ast.expr = self.visit(last)
        for value in reversed(first):
            test, kept = self.holds(value), self.visit(copy.deepcopy(value))
            chosen = self.call("cond", test, *((chosen, kept) if isinstance(node.op, ast.And) else (kept, chosen)))
        return chosen

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        """Rewrite `not` as `~`, of a number as `== 0`."""
        if not isinstance(node.op, ast.Not):
            self.generic_visit(node)
            return node
        form = self.form(node.operand)
        if form is not None and form == _Form(False, 1):
            return ast.Compare(self.visit(node.operand), [ast.Eq()], [ast.Constant(0)])
        return ast.UnaryOp(ast.Invert(), self.holds(node.operand))

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Rewrite a chain as the `&` of its links; `in` a display compares with each item, `in` a range its ends."""
        self.generic_visit(node)
        if joined := joined_comparisons(node):
            return joined
        links: list[ast.expr] = []
        left = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            positive = isinstance(operator, ast.In)
            if isinstance(operator, ast.In | ast.NotIn) and isinstance(right, ast.Tuple | ast.List | ast.Set):
                links.append(_membership(left, right.elts, positive=positive))
            elif isinstance(operator, ast.In | ast.NotIn) and (ends := ends_of(right)):
                links.append(_between(left, *ends, positive=positive))
            elif isinstance(operator, ast.In | ast.NotIn):
                links.append(_membership(left, [ast.Name("a"), ast.Name("b")], positive=positive))
            else:
                links.append(ast.Compare(left, [operator], [right]))
            left = right
        return reduce(lambda a, b: ast.BinOp(a, ast.BitAnd(), b), links)

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Rewrite `a if c else b` as `cond(c, a, b)`."""
        test = self.holds(node.test)
        self.generic_visit(node)
        return self.call("cond", test, node.body, node.orelse)

    def visit_Lambda(self, node: ast.Lambda) -> ast.expr:
        """Keep a lambda unchanged, since its body belongs to another function."""
        return node

    def call(self, name: str, *arguments: ast.expr) -> ast.expr:
        """Return a call of a function of shpy."""
        return ast.Call(parse(f"{self.prefix}{name}", "eval").body, list(arguments), [])

    def joined(self, node: ast.BoolOp) -> ast.expr:
        """Return the operands as bools, joined by the operator of bools."""
        operator = ast.BitAnd() if isinstance(node.op, ast.And) else ast.BitOr()
        return reduce(lambda left, right: ast.BinOp(left, operator, right), map(self.holds, node.values))

    def holds(self, node: ast.expr) -> ast.expr:
        """Return the scalar bool of the language that tells whether Python takes an expression for true."""
        if isinstance(node, ast.BoolOp):
            return self.joined(node)
        form = self.form(node)
        expression: ast.expr = self.visit(copy.deepcopy(node))
        if form is None or form == _BOOL:
            return expression
        if not form.bools:
            expression = ast.Compare(expression, [ast.NotEq()], [ast.Constant(0)])
        if form.size == 1:
            return expression
        differs = isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.NotEq)
        return self.call("any" if differs or not form.bools else "all", expression)

    def form(self, node: ast.expr) -> _Form | None:
        """Return the form of an expression, None where it is not known."""
        match node:
            case ast.Constant(value=bool()):
                return _BOOL
            case ast.Constant(value=int() | float()):
                return _Form(False, 1)
            case ast.Compare(left=left, ops=[operator], comparators=[right]):
                plain = not isinstance(operator, ast.In | ast.NotIn)
                return _Form(True, self.widest(left, right)) if plain else _BOOL
            case ast.Compare() | ast.UnaryOp(op=ast.Not()):
                return _BOOL
            case ast.UnaryOp(operand=operand):
                return self.form(operand)
            case ast.BinOp(left=left, op=operator, right=right):
                a, b = self.form(left), self.form(right)
                if a is None or b is None:
                    return None
                return _Form(a.bools and b.bools and isinstance(operator, _BITS), max(a.size, b.size))
            case ast.IfExp(body=body):
                return self.form(body)
            case ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name), args=[argument]) if name in _TO_BOOLS:
                return _Form(True, self.widest(argument))
            case ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name), args=[_]) if name in _OF_BOOLS:
                return _BOOL
            case ast.Call(func=function):
                cls = named(function, self.frame)
                return _of_class(cls) if isinstance(cls, type) else None
            case ast.Attribute(value=value, attr=picked) if is_vector(subject := named(value, self.frame)):
                return _Form(subject.base is Base.B, len(picked))
            case ast.Subscript(value=value) if is_vector(subject := named(value, self.frame)):
                return _Form(subject.base is Base.B, 1)
        subject = named(node, self.frame)
        if isinstance(subject, bool):
            return _BOOL
        return _Form(False, 1) if isinstance(subject, int | float) else _of_class(type(subject))

    def widest(self, *nodes: ast.expr) -> int:
        """Return the greatest number of components, 1 for what is not known."""
        return max((form.size for node in nodes if (form := self.form(node))), default=1)


def _of_class(cls: Any) -> _Form | None:
    """Return the form of the values of a class of the language."""
    return _Form(cls.base is Base.B, cls.size) if is_vector(cls) else None


def _membership(left: ast.expr, items: list[ast.expr], *, positive: bool) -> ast.expr:
    """Rewrite `x in (a, b)` as `(x == a) | (x == b)`, `not in` as `(x != a) & (x != b)`."""
    sign: ast.cmpop = ast.Eq() if positive else ast.NotEq()
    join: ast.operator = ast.BitOr() if positive else ast.BitAnd()
    compared: list[ast.expr] = [ast.Compare(left, [sign], [item]) for item in items]
    return reduce(lambda a, b: ast.BinOp(a, join, b), compared) if compared else ast.Constant(not positive)


def ends_of(node: ast.expr) -> tuple[ast.expr, ast.expr] | None:
    """Return the two ends of a call of `range` without a step."""
    match node:
        case ast.Call(func=ast.Name(id="range"), args=[end]):
            return ast.Constant(0), end
        case ast.Call(func=ast.Name(id="range"), args=[begin, end]):
            return begin, end
    return None


def _between(left: ast.expr, begin: ast.expr, end: ast.expr, *, positive: bool) -> ast.expr:
    """Rewrite `n in range(a, b)` as `(n >= a) & (n < b)`, `not in` as `(n < a) | (n >= b)`."""
    join: ast.operator = ast.BitAnd() if positive else ast.BitOr()
    low, high = (ast.GtE(), ast.Lt()) if positive else (ast.Lt(), ast.GtE())
    return ast.BinOp(ast.Compare(left, [low], [begin]), join, ast.Compare(left, [high], [end]))


def rewritten(node: ast.expr, prefix: str, frame: FrameType | None, *, test: bool = False) -> str:
    """Return the expression's text with Python's logic (`and`, `not`, `a < b < c`) replaced; `prefix` is as `sh.`.

    `frame` tells the types of names. With `test` the result is a scalar bool, else the value that Python would give.
    """
    rewriter = _Rewriter(prefix, frame)
    tree = rewriter.holds(node) if test else rewriter.visit(copy.deepcopy(node))
    text = ast.unparse(ast.fix_missing_locations(tree))
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def size_of(node: ast.expr, frame: FrameType | None) -> int:
    """Return the number of components of an expression, 1 where it is not known."""
    return _Rewriter("", frame).widest(node)
