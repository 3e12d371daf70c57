"""Spells an output tree as text of the C family: brackets, literals, indentation, the user's lines as comments.

Stage: emit, last. No decision is made here about what the text does.

    Assign(x, Operator("+", (x, y)))  ->  x += y;          If(c, a, (If(d, b),))  ->  if (c) { a } else if (d) { b }
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Final

import numpy as np

from shpy.backend.dump import dump
from shpy.backend.emit import tree
from shpy.backend.emit.spell_tree import tree_text
from shpy.backend.emit.tree import AnyType, Block, Expr, Literal, Name
from shpy.ir.nodes import Loc
from shpy.ir.types import Base, Type

Line = tuple[str, Loc | None]
"""One line of text, and the line of the user's code that it comes from."""
Spelled = tuple[str, "Level"]

WIDTH: Final = 110
"""Letters of a function's head; a longer head has one parameter a line."""


class Level(IntEnum):
    """The precedence of an operator of C and GLSL: the higher, the tighter it binds."""

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


LEVELS: Final = {
    "||": Level.OR, "&&": Level.AND, "|": Level.BIT_OR, "^": Level.BIT_XOR, "&": Level.BIT_AND,
    "==": Level.EQUAL, "!=": Level.EQUAL, "<": Level.LESS, "<=": Level.LESS, ">": Level.LESS, ">=": Level.LESS,
    "<<": Level.SHIFT, ">>": Level.SHIFT, "+": Level.ADD, "-": Level.ADD, "*": Level.MUL, "/": Level.MUL,
    "%": Level.MUL,
}  # fmt: skip
# Few readers know how these bind: beside another operator they are bracketed although C would not need it.
_OBSCURE: Final = frozenset({Level.BIT_OR, Level.BIT_XOR, Level.BIT_AND, Level.SHIFT})
_COMPARING: Final = frozenset({Level.EQUAL, Level.LESS})
_ABOVE: Final = {level: Level(level + 1) for level in LEVELS.values()}
_UPDATES: Final = frozenset({"+", "-", "*", "/", "%", "&", "|", "^", "<<", ">>"})


class Speller:
    """Spells functions into `lines`; a target says how it spells types, numbers, vectors and conversions."""

    def __init__(self) -> None:
        self.lines: list[Line] = []
        self._indent = 0
        self._last: Loc | None = None
        """The user's line that was named last."""

    # What a target gives

    def base_name(self, type: Type) -> str:
        """Spell a type of the IR."""
        raise KeyError(type)

    def number(self, e: Literal) -> Spelled:
        """Spell a number, such as `3`, `4u` or `true`."""
        value, base = e.value, e.type.base
        if base is Base.B:
            return "true" if value else "false", Level.ATOM
        if base is Base.U:
            return f"{value}u", Level.ATOM
        if base is not Base.I:
            return self.float_number(float(value), base)
        if value == -(2**31):  # C reads the sign apart from the number, which is out of range
            return "(-2147483647 - 1)", Level.ATOM
        return str(value), Level.UNARY if value < 0 else Level.ATOM

    def float_number(self, value: float, base: Base) -> Spelled:
        """Spell a float of a base."""
        raise KeyError(value)

    def construct(self, e: tree.Construct) -> Spelled:
        """Spell a vector."""
        raise KeyError(e)

    def cast(self, e: tree.Cast) -> Spelled:
        """Spell a conversion."""
        raise KeyError(e)

    def array(self, s: tree.Declare) -> str:
        """Spell the declaration of an array."""
        raise KeyError(s)

    def declaration(self, type: AnyType, name: str, passed: str = "") -> str:
        """Spell `float x`, and `float *x` of a pointer."""
        if isinstance(type, tree.Pointer):
            return f"{type.space}{self.type_name(type.to)} *{name}"
        return f"{self.type_name(type)} {name}"

    # Expressions

    def type_name(self, type: AnyType) -> str:
        """Spell a type."""
        match type:
            case tree.Own():
                return type.name
            case tree.Pointer():
                return f"{type.space}{self.type_name(type.to)} *"
        return self.base_name(type)

    def text(self, e: Expr) -> str:
        """Spell an expression."""
        return self.spelled(e)[0]

    def listed(self, args: Iterable[Expr]) -> str:
        """Spell arguments."""
        return ", ".join([self.spelled(a)[0] for a in args])

    def at(self, e: Expr, level: Level) -> str:
        """Spell an expression, in brackets unless it binds at least as tightly as `level`."""
        text, own = self.spelled(e)
        return text if own >= level else f"({text})"

    def spelled(self, e: Expr) -> Spelled:
        """Spell an expression; return the text and its level of precedence."""
        match e:
            case Name():
                return e.text, Level.ATOM
            case tree.Operator():
                return self._operator(e)
            case tree.Call():
                return self.called(e), Level.POSTFIX
            case Literal():
                return self.number(e)
            case tree.Member(_, tree.Operator(_, "*", (Name(_, pointer),)), field):
                return f"{pointer}->{field}", Level.POSTFIX
            case tree.Member():
                return f"{self.at(e.of, Level.POSTFIX)}.{e.field}", Level.POSTFIX
            case tree.Construct():
                return self.construct(e)
            case tree.Cast():
                return self.cast(e)
            case tree.Index():
                return f"{self.at(e.of, Level.POSTFIX)}[{self.text(e.at)}]", Level.POSTFIX
        raise TypeError(type(e).__name__)

    def called(self, e: tree.Call) -> str:
        """Spell a call."""
        return f"{e.function}({self.listed(e.args)})"

    def _operator(self, e: tree.Operator) -> Spelled:
        symbol = e.symbol
        match e.args:
            case (a,):
                text = self.at(a, Level.UNARY)
                return f"{symbol}({text})" if _begins_with(a, symbol) else f"{symbol}{text}", Level.UNARY
            case (a, b):
                level = LEVELS[symbol]
                return f"{self._operand(a, level, level)} {symbol} {self._operand(b, _ABOVE[level], level)}", level
        condition, yes, no = [self.at(part, Level.OR) for part in e.args]
        return f"{condition} ? {yes} : {no}", Level.TERNARY

    def _operand(self, e: Expr, at_least: Level, operator: Level) -> str:
        text, level = self.spelled(e)
        if level >= Level.UNARY:
            return text
        obscure = level is not operator and (level in _OBSCURE or operator in _OBSCURE)
        obscure = obscure or (level in _COMPARING and operator in _COMPARING)
        obscure = obscure or (level is Level.AND and operator is Level.OR)
        return f"({text})" if obscure or level < at_least else text

    # Statements

    def line(self, text: str, loc: Loc | None = None) -> None:
        """Append a line; the first of several from one line of the user's code says which."""
        shown = loc if loc is not None and loc != self._last else None
        self._last = loc or self._last
        self.lines.append((f"{'    ' * self._indent}{text}", shown))

    def paragraph(self, text: str) -> None:
        """Append an empty line and lines that are spelled already."""
        self.lines += [("", None), *((line, None) for line in text.splitlines())]

    def block(self, block: Block) -> None:
        """Append indented statements."""
        self._indent += 1
        for s in block:
            self.statement(s)
        self._indent -= 1

    def function(self, f: tree.Function) -> None:
        """Append an empty line and a function, its head on one line if that fits."""
        dump("tree", f.name, lambda: tree_text(f))
        self._last = None
        self.line("")
        result = "void" if f.result is None else self.type_name(f.result)
        head = " ".join([*f.qualifiers, result, f.name])
        parameters = [self.parameter(p) for p in f.parameters]
        line = f"{head}({', '.join(parameters)}) {{"
        if len(line) <= WIDTH:
            self.line(line, f.loc)
        else:
            self.line(f"{head}(", f.loc)
            for at, parameter in enumerate(parameters, 1):
                self.line(f"    {parameter}{',' if at < len(parameters) else ') {'}")
        self.block(f.body)
        self.line("}")

    def parameter(self, p: tree.Parameter) -> str:
        """Spell a parameter."""
        length = "" if p.length is None else f"[{p.length}]"
        return f"{self.declaration(p.type, p.name, p.passed)}{length}"

    def statement(self, s: tree.Stmt) -> None:
        """Append a statement."""
        match s:
            case tree.Declare(length=int()):
                self.line(self.array(s), s.loc)
            case tree.Declare() | tree.Assign():
                self.line(f"{self._simple(s)};", s.loc)
            case tree.Do():
                self.line(f"{self.text(s.value)};", s.loc)
            case tree.Exit():
                self.line(f"{s.word} {self.text(s.value)};" if s.value is not None else f"{s.word};", s.loc)
            case tree.If():
                self._choice(s, "")
            case tree.Loop():
                self._loop(s)

    def _simple(self, s: tree.Declare | tree.Assign) -> str:
        """Spell a declaration or an assignment without its semicolon."""
        if isinstance(s, tree.Declare):
            declared = self.declaration(s.type, s.name)
            return declared if s.value is None else f"{declared} = {self.text(s.value)}"
        match s.value:
            case tree.Operator(_, symbol, (a, b)) if symbol in _UPDATES and a == s.target:
                return f"{self.text(s.target)} {symbol}= {self.text(b)}"
        return f"{self.text(s.target)} = {self.text(s.value)}"

    def _choice(self, s: tree.If, before: str) -> None:
        """Append `if`, `else if` and `else`."""
        self.line(f"{before}if ({self.text(s.condition)}) {{", s.loc)
        self.block(s.then)
        match s.orelse:
            case ():
                self.line("}")
            case (tree.If() as only,):
                self._choice(only, "} else ")
            case _:
                self.line("} else {")
                self.block(s.orelse)
                self.line("}")

    def _loop(self, s: tree.Loop) -> None:
        """Append a `for`, `while` or `do`. After a loop without a step the user's line is named again."""
        test = "" if s.test is None else self.text(s.test)
        if s.step is not None:
            starts = ", ".join([self._simple(start) for start in s.starts])
            self.line(f"for ({starts};{f' {test}' if test else ''}; {self._simple(s.step)}) {{", s.loc)
            self.block(s.body)
            self.line("}")
            return
        note = f"  // {s.note}" if s.note else ""
        self.line("do {" if s.again is not None else f"while ({test or 'true'}) {{{note}", s.loc)
        self._last = s.loc
        self.block(s.body)
        self._last = None
        self.line("}" if s.again is None else f"}} while ({self.text(s.again)});", s.again_loc)


def _begins_with(e: Expr, symbol: str) -> bool:
    """Return whether the text of an operand begins with a prefix: `--x` is not `-(-x)`."""
    match e:
        case tree.Operator(_, own, (_,)):
            return own == symbol
        case Literal():
            return symbol == "-" and is_negative(e.value)
    return False


def is_negative(value: float | int | bool) -> bool:
    """Return whether a number is written with a minus."""
    return value == value and bool(np.signbit(value)) if isinstance(value, float) else value < 0


def row_major(at: Sequence[str], size: str) -> str:
    """Spell the place of an element in memory, in C order, from its index on each axis."""
    place, *others = at
    for axis, index in zip("yzw", others, strict=False):
        first = place if axis == "y" else f"({place})"
        place = f"{first} * {size}.{axis} + {index}"
    return place


def comment(loc: Loc) -> str:
    """Spell `// file.py:12`, whatever the file is called."""
    file = re.sub(r"[^A-Za-z0-9_. -]", "_", loc.file.replace("\\", "/").rsplit("/", 1)[-1])[:60]
    return f"// {file}:{loc.line}"


def text_of(lines: Sequence[Line]) -> str:
    """Return the lines as text, with their comments."""
    return "".join([f"{text}  {comment(loc)}\n" if loc else f"{text}\n" for text, loc in lines])
