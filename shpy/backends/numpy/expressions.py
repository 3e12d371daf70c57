"""Expressions of Python: text that knows how tightly it binds, what it reads and what it becomes when stored.

Stage: emit. Part of the numpy printer. Brackets stand only where Python's precedence, or a reader, needs them.

>>> a, b, c = (name(n) for n in "abc")
>>> infix("-", a, infix("+", b, c)).text
'a - (b + c)'
>>> infix("|", infix(">", a, b), infix("==", b, c)).text
'(a > b) | (b == c)'
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

__all__ = [
    "Expr",
    "Level",
    "call",
    "comparison",
    "condition",
    "infix",
    "item",
    "method",
    "name",
    "negation",
    "prefix",
    "ternary",
]


class Level(IntEnum):
    """How tightly an operator of Python binds (Language Reference 6.17)."""

    TERNARY = 1
    NOT = 2
    COMPARE = 3
    BIT_OR = 4
    BIT_XOR = 5
    BIT_AND = 6
    SHIFT = 7
    ADD = 8
    MUL = 9
    UNARY = 10
    POSTFIX = 11


_LEVELS: Final = {
    **dict.fromkeys(("==", "!=", "<", "<=", ">", ">="), Level.COMPARE),
    "|": Level.BIT_OR,
    "^": Level.BIT_XOR,
    "&": Level.BIT_AND,
    "<<": Level.SHIFT,
    ">>": Level.SHIFT,
    "+": Level.ADD,
    "-": Level.ADD,
    "*": Level.MUL,
    "/": Level.MUL,
    "//": Level.MUL,
    "%": Level.MUL,
}
_UFUNCS: Final = {"+": "add", "-": "subtract", "*": "multiply", "/": "divide"}
_INVERSE: Final = {"==": "!=", "!=": "==", "<": ">=", "<=": ">", ">": "<=", ">=": "<"}
# How these bind beside + and * few readers know.
_OBSCURE: Final = frozenset({Level.BIT_OR, Level.BIT_XOR, Level.BIT_AND, Level.SHIFT})


@dataclass(frozen=True, slots=True)
class Expr:
    """Text of an expression.

    `reads`: the slots in it; `depth`: how deeply it nests; `shared`: it may be a view of what a name holds, not a new
    array. `literal`: it is a number that takes its type from the other operand, and `typed` is the same with a type of
    its own. `splat`: the scalar whose broadcast it is. `negated`: what it is the negation of, if it is a uniform bool.
    `inverse`: the comparison that holds where this one does not. `into`: a call that gives the same, but for its end:
    there it may be told the array to write to.
    """

    text: str
    level: Level = Level.POSTFIX
    reads: frozenset[int] = frozenset()
    depth: int = 0
    shared: bool = False
    literal: bool = False
    typed: str = ""
    splat: Expr | None = None
    negated: Expr | None = None
    inverse: Expr | None = None
    into: str = ""

    def own(self) -> Expr:
        """The same with a type of its own, where it is a literal."""
        return replace(self, text=self.typed, level=Level.POSTFIX, literal=False) if self.literal else self

    def at(self, level: Level) -> str:
        """The text, in brackets unless it binds at least as tightly as `level`."""
        return self.text if self.level >= level else f"({self.text})"


def name(text: str, reads: Iterable[int] = ()) -> Expr:
    """A name."""
    return Expr(text, reads=frozenset(reads), shared=True)


def _made(text: str, level: Level, parts: Iterable[Expr]) -> Expr:
    parts = list(parts)
    return Expr(text, level, frozenset().union(*(p.reads for p in parts)), 1 + max((p.depth for p in parts), default=0))


def _operand(e: Expr, level: Level, operator: Level) -> str:
    obscure = operator in _OBSCURE and e.level in (Level.ADD, Level.MUL, Level.SHIFT, *_OBSCURE)
    if obscure and e.level is not operator:
        return f"({e.text})"
    return e.at(level)


def infix(symbol: str, left: Expr, right: Expr) -> Expr:
    """`left symbol right`, grouping to the left; a comparison brackets comparisons, which Python would chain."""
    level = _LEVELS[symbol]
    a = _operand(left, Level(level + 1) if level is Level.COMPARE else level, level)
    made = _made(f"{a} {symbol} {_operand(right, Level(level + 1), level)}", level, (left, right))
    if symbol in _UFUNCS:
        return replace(made, into=f"np.{_UFUNCS[symbol]}({left.text}, {right.text}")
    return made


def prefix(symbol: str, e: Expr) -> Expr:
    """`symbol e`."""
    text = e.at(Level.POSTFIX) if e.text.startswith(symbol) else e.at(Level.UNARY)
    return _made(f"{symbol}{text}", Level.UNARY, (e,))


def negation(e: Expr) -> Expr:
    """The opposite of a uniform bool."""
    if e.inverse is not None:
        return e.inverse
    return e.negated if e.negated is not None else replace(prefix("~", e), negated=e)


def condition(e: Expr) -> Expr:
    """A uniform bool after `if` or `while`."""
    return e if e.negated is None else replace(e, text=f"not {e.negated.at(Level.COMPARE)}", level=Level.NOT)


def call(function: str, *args: Expr | str) -> Expr:
    """`function(args)`."""
    text = ", ".join(a if isinstance(a, str) else a.text for a in args)
    return _made(f"{function}({text})", Level.POSTFIX, [a for a in args if isinstance(a, Expr)])


def comparison(symbol: str, left: Expr, right: Expr, *, ordered: bool) -> Expr:
    """`left symbol right`; `ordered` if there can be no NaN, so that `not a < b` is `a >= b`."""
    made = infix(symbol, left, right)
    if ordered or symbol in ("==", "!="):
        return replace(made, inverse=infix(_INVERSE[symbol], left, right))
    return made


def method(e: Expr, function: str, *args: str) -> Expr:
    """`e.function(args)`."""
    return _made(f"{e.at(Level.POSTFIX)}.{function}({', '.join(args)})", Level.POSTFIX, (e,))


def item(e: Expr, index: str, *parts: Expr) -> Expr:
    """`e[index]`, a view; `parts` are the expressions in the index."""
    made = _made(f"{e.at(Level.POSTFIX)}[{index}]", Level.POSTFIX, (e, *parts))
    return replace(made, depth=e.depth, shared=True)


def ternary(test: Expr, a: Expr, b: Expr) -> Expr:
    """`a if test else b`, one of the two."""
    text = f"{a.at(Level.NOT)} if {condition(test).at(Level.NOT)} else {b.at(Level.NOT)}"
    return replace(_made(text, Level.TERNARY, (test, a, b)), shared=True)
