"""Expressions of C-like text: a piece of text that knows how tightly it binds and what it reads.

Stage: emit. The printer makes an `Expr` of each operation from those of its operands; brackets are set only where
the language's precedence, or a reader, needs them. Nothing here changes the order of operations: `a - (b + c)` and
`a - b + c` stay apart.

>>> a, b, c = (name(n) for n in "abc")
>>> infix("-", Level.ADD, a, infix("+", Level.ADD, b, c)).text
'a - (b + c)'
>>> infix("-", Level.ADD, infix("*", Level.MUL, prefix("-", a), b), c).text
'-a * b - c'
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final


class Level(IntEnum):
    """How tightly an operator of C and GLSL binds."""

    TERNARY = 2
    OR = 3
    AND = 4
    BIT_OR = 5
    BIT_XOR = 6
    BIT_AND = 7
    EQUAL = 8
    LESS = 9
    SHIFT = 10
    ADD = 11
    MUL = 12
    UNARY = 13
    POSTFIX = 14
    ATOM = 15


# Few readers know how these bind: beside another operator they are bracketed although C would not need it.
_OBSCURE: Final = frozenset({Level.BIT_OR, Level.BIT_XOR, Level.BIT_AND, Level.SHIFT})
_COMPARING: Final = frozenset({Level.EQUAL, Level.LESS})


@dataclass(frozen=True, slots=True)
class Expr:
    """Text of an expression.

    `reads` are the names of the variables and temporaries in it; `depth` how deeply it nests. Some expressions know
    more: `inverse` is the text of a bool's opposite; `scalar` what a splat repeats; `update` an infix expression's
    operator, left and right operand, from which `x = x + e` becomes `x += e`; `unsigned` says that an int was
    computed as a uint and has yet to be converted.
    """

    text: str
    level: Level = Level.ATOM
    reads: frozenset[str] = frozenset()
    depth: int = 0
    inverse: Expr | None = None
    scalar: Expr | None = None
    update: tuple[str, str, str] | None = None
    unsigned: bool = False

    @property
    def is_simple(self) -> bool:
        """Whether it is an identifier, a literal or a component of one: cheap to write twice."""
        return self.depth == 0


def name(text: str) -> Expr:
    """A variable or temporary."""
    return Expr(text, reads=frozenset({text}))


def _made(text: str, level: Level, *parts: Expr) -> Expr:
    reads = parts[0].reads.union(*(p.reads for p in parts[1:])) if parts else frozenset()
    return Expr(text, level, reads, 1 + max((p.depth for p in parts), default=0))


def bracketed(e: Expr, at_least: Level) -> str:
    """The text, in brackets unless it binds at least as tightly as `at_least`."""
    return e.text if e.level >= at_least else f"({e.text})"


def _operand(e: Expr, at_least: Level, operator: Level) -> str:
    obscure = e.level < Level.UNARY and e.level is not operator
    obscure = obscure and (e.level in _OBSCURE or operator in _OBSCURE)
    obscure = obscure or (e.level in _COMPARING and operator in _COMPARING)
    if obscure or (e.level is Level.AND and operator is Level.OR):
        return f"({e.text})"
    return bracketed(e, at_least)


def infix(symbol: str, level: Level, left: Expr, right: Expr) -> Expr:
    """`left symbol right`, which groups to the left."""
    a = _operand(left, level, level)
    b = _operand(right, Level(level + 1), level)
    made = _made(f"{a} {symbol} {b}", level, left, right)
    return replace(made, update=(symbol, left.text, right.text))


def prefix(symbol: str, e: Expr) -> Expr:
    """`symbol e`; `-(-x)` keeps its brackets, for `--x` is something else."""
    text = bracketed(e, Level.UNARY)
    if text.startswith(symbol):
        text = f"({text})"
    return _made(f"{symbol}{text}", Level.UNARY, e)


def ternary(condition: Expr, a: Expr, b: Expr) -> Expr:
    """`condition ? a : b`, nested ones in brackets."""
    parts = [bracketed(e, Level.OR) for e in (condition, a, b)]
    return _made(f"{parts[0]} ? {parts[1]} : {parts[2]}", Level.TERNARY, condition, a, b)


def call(function: str, *args: Expr) -> Expr:
    """`function(args)`."""
    return _made(f"{function}({', '.join(a.text for a in args)})", Level.POSTFIX, *args)


def member(e: Expr, field: str) -> Expr:
    """`e.field`; of what a pointer points to, `e->field`."""
    pointer = e.text[1:] if e.level is Level.UNARY and e.text.startswith("*") else ""
    text = f"{pointer}->{field}" if pointer.isidentifier() else f"{bracketed(e, Level.POSTFIX)}.{field}"
    made = _made(text, Level.POSTFIX, e)
    return replace(made, depth=e.depth)


def element(e: Expr, index: Expr) -> Expr:
    """`e[index]`."""
    return _made(f"{bracketed(e, Level.POSTFIX)}[{index.text}]", Level.POSTFIX, e, index)


def cast(type: str, e: Expr) -> Expr:
    """C's `(type)e`."""
    return _made(f"({type}){bracketed(e, Level.UNARY)}", Level.UNARY, e)


def negation(e: Expr) -> Expr:
    """The opposite of a scalar bool."""
    return e.inverse if e.inverse is not None else replace(prefix("!", e), inverse=e)


_OPPOSITE: Final = {"==": "!=", "!=": "==", "<": ">=", "<=": ">", ">": "<=", ">=": "<"}


def comparison(symbol: str, left: Expr, right: Expr, *, ordered: bool) -> Expr:
    """`left symbol right`; `ordered` if no NaN can be there, so that `!(a < b)` is `a >= b`."""
    level = Level.EQUAL if symbol in ("==", "!=") else Level.LESS
    made = replace(infix(symbol, level, left, right), update=None)
    if ordered or level is Level.EQUAL:
        opposite = replace(infix(_OPPOSITE[symbol], level, left, right), update=None)
        return replace(made, inverse=replace(opposite, inverse=made))
    return made
