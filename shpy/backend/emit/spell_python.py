"""Spells an output tree as text of Python: brackets, literals, indentation, the user's lines as comments.

Stage: emit, last. No decision is made here about what the text does.

    Operator("&", (a, Operator("==", (b, c))))  ->  a & (b == c)
    If(c, a, (If(d, b),))                       ->  if c: a  elif d: b
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from pathlib import PurePath
from typing import Any, Final

import numpy as np

from shpy.backend.dump import dump
from shpy.backend.emit import tree
from shpy.backend.emit.spell_c import is_negative
from shpy.backend.emit.spell_tree import tree_text
from shpy.backend.emit.tree import Block, Expr, Literal, Name
from shpy.ir.constants import DTYPES
from shpy.ir.nodes import Loc
from shpy.ir.types import Base, Type


class Strength(IntEnum):
    """The precedence of an operator of Python: the higher, the tighter it binds (Language Reference 6.17)."""

    TUPLE = 0
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
    **dict.fromkeys(("==", "!=", "<", "<=", ">", ">="), Strength.COMPARE),
    "|": Strength.BIT_OR, "^": Strength.BIT_XOR, "&": Strength.BIT_AND, "<<": Strength.SHIFT, ">>": Strength.SHIFT,
    "+": Strength.ADD, "-": Strength.ADD, "*": Strength.MUL, "/": Strength.MUL, "//": Strength.MUL, "%": Strength.MUL,
}  # fmt: skip
_OBSCURE: Final = frozenset({Strength.BIT_OR, Strength.BIT_XOR, Strength.BIT_AND, Strength.SHIFT})
"""Few readers know how these bind beside + and *."""
_BRACKETED: Final = frozenset({Strength.ADD, Strength.MUL, *_OBSCURE})
Spelled = tuple[str, Strength]


class PythonSpeller:
    """Spells functions into `lines`; `called` are the names that occur."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.called: set[str] = set()
        self._indent = 0
        self._last: Loc | None = None

    # Expressions

    def text(self, e: Expr) -> str:
        """Spell an expression."""
        return self.spelled(e)[0]

    def width(self, e: Expr) -> int:
        """Return how many letters an expression is spelled with."""
        return len(self.text(e))

    def listed(self, args: Iterable[Expr]) -> str:
        """Spell arguments; tuples are put in brackets."""
        return ", ".join([self.at(a, Strength.TERNARY) if isinstance(a, tree.Tuple) else self.text(a) for a in args])

    def at(self, e: Expr, level: Strength) -> str:
        """Spell an expression, in brackets unless it binds at least as tightly as `level`."""
        text, own = self.spelled(e)
        return text if own >= level else f"({text})"

    def condition(self, e: Expr) -> Spelled:
        """Spell a uniform bool after `if` or `while`."""
        match e:
            case tree.Operator(_, "!", (a,)):
                return f"not {self.at(a, Strength.COMPARE)}", Strength.NOT
        return self.spelled(e)

    def spelled(self, e: Expr) -> Spelled:
        """Spell an expression, and tell how tightly it binds."""
        match e:
            case Name():
                self.called.add(e.text)
                return e.text, Strength.POSTFIX
            case Literal():
                text = number(e.type, e.value)
                return text, Strength.UNARY if is_negative(e.value) else Strength.POSTFIX
            case tree.Operator():
                return self._operator(e)
            case tree.Method():
                return f"{self.at(e.of, Strength.POSTFIX)}.{e.name}({self.listed(e.args)})", Strength.POSTFIX
            case tree.Call():
                self.called.add(e.function)
                return f"{e.function}({self.listed(e.args)})", Strength.POSTFIX
            case tree.Member():
                return f"{self.at(e.of, Strength.POSTFIX)}.{e.field}", Strength.POSTFIX
            case tree.Construct():
                return self._construct(e), Strength.POSTFIX
            case tree.Index():
                return f"{self.at(e.of, Strength.POSTFIX)}[{self.text(e.at)}]", Strength.POSTFIX
            case tree.Slice():
                return f"{'' if e.start is None else e.start}:{e.stop}", Strength.TUPLE
            case tree.ListDisplay():
                return f"[{self.listed(e.args)}]", Strength.POSTFIX
            case tree.NamedArgument():
                return f"{e.name}={self.text(e.value)}", Strength.TUPLE
            case tree.Tuple():
                return self.listed(e.args), Strength.TUPLE
        raise TypeError(type(e).__name__)

    def _operator(self, e: tree.Operator) -> Spelled:
        match e.args:
            case (a,):
                symbol = "~" if e.symbol == "!" else e.symbol
                at_least = Strength.POSTFIX if _begins_with(a, symbol) else Strength.UNARY
                return f"{symbol}{self.at(a, at_least)}", Strength.UNARY
            case (a, b):
                level = _LEVELS[e.symbol]
                left = Strength(level + 1) if level is Strength.COMPARE else level
                right = Strength(level + 1)
                return f"{self._operand(a, left, level)} {e.symbol} {self._operand(b, right, level)}", level
        test, yes, no = e.args
        text, level = self.condition(test)
        between = text if level >= Strength.NOT else f"({text})"
        return f"{self.at(yes, Strength.NOT)} if {between} else {self.at(no, Strength.NOT)}", Strength.TERNARY

    def _operand(self, e: Expr, at_least: Strength, operator: Strength) -> str:
        text, level = self.spelled(e)
        obscure = operator in _OBSCURE and level in _BRACKETED and level is not operator
        return f"({text})" if obscure or level < at_least else text

    def _construct(self, e: tree.Construct) -> str:
        match e.args:
            case (Literal() as one,):
                return f"np.full(({e.type.size}, 1), {dtype(one.type)}({self.text(one)}))"
            case (one,):
                self.called.add("splat")
                return f"splat({self.text(one)}, {e.type.size})"
        rows = ", ".join([f"[{self.text(a)}]" for a in e.args])
        return f"{dtype(e.type)}([{rows}])"

    # Statements

    def line(self, text: str, loc: Loc | None = None) -> None:
        """Append a line; the first of several from one line of the user's code says which."""
        if loc is not None and loc != self._last:
            self._last = loc
            text = f"{text}  # {_file(loc)}:{loc.line}"
        self.lines.append(f"{'    ' * self._indent}{text}")

    def function(self, f: tree.Function) -> None:
        """Append two empty lines and a function."""
        dump("tree", f.name, lambda: tree_text(f))
        self._last = None
        self.lines += ["", ""]
        self.line(f"def {f.name}({', '.join([p.name for p in f.parameters])}):")
        self.block(f.body)

    def block(self, block: Block) -> None:
        """Append indented statements."""
        self._indent += 1
        for s in block:
            self.statement(s)
        if not block:
            self.line("pass")
        self._indent -= 1

    def statement(self, s: tree.Stmt) -> None:
        """Append a statement."""
        match s:
            case tree.Assign():
                self.line(f"{self.text(s.target)} = {self.text(s.value)}", s.loc)
            case tree.Update():
                self.line(f"{self.text(s.target)} {s.symbol}= {self.text(s.value)}", s.loc)
            case tree.Do():
                self.line(self.text(s.value), s.loc)
            case tree.Exit():
                self.line(f"{s.word} {self.text(s.value)}" if s.value is not None else s.word, s.loc)
            case tree.If():
                self._choice(s, "if")
            case tree.Loop():
                self.line(f"while {'True' if s.test is None else self.condition(s.test)[0]}:", s.loc)
                self.block(s.body)
            case tree.Each():
                self.line(f"for {self.text(s.name)} in {self.text(s.over)}:", s.loc)
                self.block(s.body)
            case tree.Declare():
                raise TypeError("Python declares nothing")

    def _choice(self, s: tree.If, word: str) -> None:
        """Append `if`, `elif` and `else`."""
        self.line(f"{word} {self.condition(s.condition)[0]}:", s.loc)
        self.block(s.then)
        match s.orelse:
            case ():
                pass
            case (tree.If() as only,):
                self._choice(only, "elif")
            case _:
                self.line("else:")
                self.block(s.orelse)


def dtype(type: Type) -> str:
    """Spell the dtype of a type, as `np.float32`."""
    return f"np.{np.dtype(DTYPES[type.base]).name}" if not type.is_bool else "np.bool_"


def number(type: Type, value: Any) -> str:
    """Return the shortest literal that means `value` at the type's precision."""
    if not type.is_float:
        return repr(value)
    if value != value:
        return "np.nan"
    if value in (float("inf"), float("-inf")):
        return "np.inf" if value > 0 else "-np.inf"
    rounded = DTYPES[type.base](value)
    short = repr(rounded.item() if type.base is Base.D else float(str(rounded)))
    return short if DTYPES[type.base](float(short)) == rounded else repr(rounded.item())


def _begins_with(e: Expr, symbol: str) -> bool:
    """Return whether the text of an operand begins with a prefix: `--x` would read as one operator."""
    match e:
        case tree.Operator(_, own, (_,)):
            return ("~" if own == "!" else own) == symbol
        case Literal():
            return symbol == "-" and is_negative(e.value)
    return False


def _file(loc: Loc) -> str:
    return "".join([c if c.isprintable() else "?" for c in PurePath(loc.file).name])
