r"""Parse the text of a module: `parse(print_module(m)) == m`, including names and locations.

Stage: represent. It takes text and returns a `Module`. It checks the syntax only; the verifier checks the rules of the
IR. It executes nothing. Deep nesting and long text need no recursion.

>>> parse("module empty\nfunction main() -> () {\n}").entry.name
'main'
>>> parse("module empty\nfunction main() -> () {")
Traceback (most recent call last):
shpy.errors.ParseError: line 2, column 24: expected a statement or '}', found the end of the text
  function main() -> () {
                         ^
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import cache
from io import StringIO
from itertools import islice
from typing import Any, Final, NoReturn

from lark import Lark, Token
from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken, VisitError
from lark.lexer import PatternRE, PatternStr, TerminalDef
from lark.visitors import Transformer_NonRecursive, v_args

from shpy.errors import ParseError, ShpyTypeError, shorten
from shpy.ir.constants import encode
from shpy.ir.metadata import About
from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
    Discard,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Module,
    Param,
    Port,
    Region,
    Return,
    Stmt,
    Store,
    Table,
    Value,
    Variable,
)
from shpy.ir.text import LETTERS, unquote
from shpy.ir.types import Base, Type, type_named, vec

_SPOKEN = {
    "WORD": "a name",
    "STRING": "a name in quotes",
    "VALUE": "a value such as %3",
    "VARIABLE": "a variable such as $1",
    "TYPE": "a type such as f or i3",
    "LOC": "a location such as @1:12",
    "COMPONENTS": "components such as xz",
    "INT": "a whole number",
    "NUMBER": "a number",
    "_NL": "the end of the line",
    "$END": "the end of the text",
}
_END = r"(?!\w)"
_STATEMENTS = frozenset({"STORE", "IF", "LOOP", "EXIT"})


_MOST, _MOST_IN_LINE = 2**24, 2**20
"""The most characters of a text and of a line: parsing takes more than a thousand times as much memory."""


def parse(text: str) -> Module:
    """Return the module of a text; raise ParseError with line, column and the expected syntax.

    Raises ShpyTypeError for anything but a str.
    """
    if not isinstance(text, str):
        cure = "the text of a module, as str(program.ir) gives it"
        raise ShpyTypeError(f"sh.parse takes a str, not {type(text).__name__}", cure=cure)
    source = text if text.endswith("\n") else text + "\n"
    _check_size(source)
    try:
        tree = _grammar().parse(source)
        module: Module = _Reader(source).transform(tree)
    except UnexpectedInput as error:
        _explain(source, error)
    except VisitError as error:
        raise error.orig_exc from None
    return module


def _check_size(source: str) -> None:
    if len(source) > _MOST:
        line = source.count("\n", 0, _MOST) + 1
        raise ParseError(f"line {line}: a text has at most {_MOST:,} characters, and this one has {len(source):,}")
    if len(source) > _MOST_IN_LINE:
        for line, row in enumerate(StringIO(source, newline="\n"), 1):
            if len(row) > _MOST_IN_LINE:
                raise ParseError(f"line {line}: a line has at most {_MOST_IN_LINE:,} characters, not {len(row) - 1:,}")


@cache
def _grammar() -> Lark:
    options: dict[str, Any] = {"parser": "lalr", "lexer": "contextual", "maybe_placeholders": True}
    return Lark.open("ir.lark", rel_to=__file__, edit_terminals=_whole_words, **options)


def _whole_words(terminal: TerminalDef) -> None:
    """Change a keyword's pattern to match whole words only, and to have priority over names."""
    word = terminal.pattern.value
    if isinstance(terminal.pattern, PatternStr) and word.isidentifier():
        terminal.pattern = PatternRE(word + _END)
        terminal.priority = 1


def _fail(source: str, line: int, column: int, message: str) -> NoReturn:
    row = next(islice(StringIO(source, newline="\n"), max(line - 1, 0), None), "").rstrip("\n")
    start = max(0, column - 100)
    shown = row[start : start + 120].replace("\t", " ")
    pointer = " " * (column - 1 - start) + "^"
    raise ParseError(f"line {line}, column {column}: {message}\n  {shown}\n  {pointer}") from None


def _explain(source: str, error: UnexpectedInput) -> NoReturn:
    """Raise ParseError with a description of the expected and the found syntax."""
    if isinstance(error, UnexpectedToken):
        terminals, text = set(error.accepts or error.expected), _describe_token(error.token)
        at_end = error.token.type == "$END"
    else:
        terminals = set(error.allowed or ()) if isinstance(error, UnexpectedCharacters) else set()
        there = re.compile(r"\w+|.", re.DOTALL).match(source, error.pos_in_stream or 0)
        text, at_end = repr(shorten(there[0]) if there else ""), False
    if at_end:
        body = source.rstrip("\n")
        line, column = body.count("\n") + 1, len(body) - body.rfind("\n")
    else:
        line, column = error.line, error.column
    _fail(source, line, column, f"expected {_describe_terminals(terminals)}, found {text}")


def _describe_token(token: Token) -> str:
    if token.type in ("$END", "_NL"):
        return _SPOKEN[token.type]
    return repr(shorten(token))


def _describe_terminals(terminals: set[str]) -> str:
    if terminals >= _STATEMENTS:
        return "a statement or '}'" if "RBRACE" in terminals else "a statement"
    if {"WORD", "STRING"} <= terminals:
        terminals = terminals - {"STRING"}
    if "WORD" in terminals and "SWIZZLE" in terminals:
        return "an operation"
    if "MODULE" in terminals:
        return "'module'"
    literals = {t.name: t.pattern.value.removesuffix(_END) for t in _grammar().terminals}
    words = sorted(_SPOKEN.get(t) or repr(literals.get(t, t)) for t in terminals)
    if len(words) <= 1:
        return "".join(words) or "something else"
    return f"{', '.join(words[:-1])} or {words[-1]}"


@v_args(inline=True)
class _Reader(Transformer_NonRecursive[Token, Any]):
    """Builds nodes bottom-up in the order of the text, and records the declarations so far."""

    def __init__(self, source: str) -> None:
        super().__init__()
        for name in _RULES:  # else lark wraps the method anew for each node
            setattr(self, name, getattr(self, name))
        self.source = source
        self.files: dict[str, str] = {}
        self.functions: dict[str, Function] = {}
        self.named: dict[tuple[str, int], tuple[str | None, Token]] = {}
        self.mentions: list[Token] = []

    def fail(self, token: Token, message: str) -> NoReturn:
        _fail(self.source, token.line or 0, token.column or 0, message)

    # Tokens

    def LOC(self, token: Token) -> Loc:
        number, _, line = token[1:].partition(":")
        if number not in self.files:
            self.fail(token, f"file {number} is not declared")
        return Loc(self.files[number], int(line))

    def TYPE(self, token: Token) -> Type | None:
        return type_named(token)

    def INT(self, token: Token) -> int:
        return int(token)

    def COMPONENTS(self, token: Token) -> tuple[int, ...]:
        return tuple(map(int, token[1:]) if token[0] == "s" else map(LETTERS.index, token))

    def text(self, token: Token) -> str:
        try:
            return unquote(str(token))
        except (ValueError, OverflowError):
            self.fail(token, "no character has this number")

    def split(self, token: Token) -> tuple[str | None, int]:
        """Split `%name.id` into name and id."""
        name, dot, number = token[1:].rpartition(".")
        return (self.text(Token.new_borrow_pos("STRING", name, token)) if dot else None), int(number)

    def use(self, token: Token) -> int:
        self.mentions.append(token)
        return self.split(token)[1]

    def name(self, token: Token) -> str:
        return self.text(token)

    # Declarations

    def file(self, number: int, name: Token) -> None:
        self.files[str(number)] = self.text(name)

    def input(self, name: str, kind: str) -> tuple[str, Port]:
        return "input", Port(name, kind)

    def output(self, name: str, kind: str) -> tuple[str, Port]:
        return "output", Port(name, kind)

    def param(self, name: str, kind: str, type: Type, constant: list[Token], *about: Any) -> Param:
        bounds, step, title, description = about
        ends = None if bounds is None else self.bounds(bounds)
        texts = (None if text is None else self.text(text) for text in (title, description))
        return Param(
            name,
            kind,
            type,
            self.components(type, constant),
            About(ends, None if step is None else self.bound(step), *texts),
        )

    def bounds(self, constant: list[Token]) -> tuple[float, float]:
        if len(constant) != 2:
            self.fail(constant[0], f"a range has two ends, found {len(constant)} numbers")
        low, high = map(self.bound, constant)
        return low, high

    def bound(self, token: Token) -> float:
        if token.lstrip("-").isdigit():
            return int(token)
        return self.number(vec(Base.D), token)

    def extent(self, extent: int | Token) -> int | None:
        return extent if isinstance(extent, int) else None

    def table(self, name: str, type: Type, *extents: int | None) -> Table:
        sizes = tuple(e for e in extents if e is not None)
        return Table(name, type, len(extents), sizes if len(sizes) == len(extents) else None)

    # Values, variables, functions

    def value(self, token: Token, type: Type, loc: Loc | None) -> Value:
        name, id = self.split(token)
        self.named["%", id] = name, token
        return Value(id, type, name, loc)

    def slot(self, token: Token, type: Type, length: int | None, loc: Loc | None) -> Variable:
        name, id = self.split(token)
        self.named["$", id] = name, token
        return Variable(id, type, length, name, loc)

    def variable(self, slot: Variable) -> Variable:
        return slot

    def inputs(self, *ports: Value | Variable) -> tuple[Value | Variable, ...]:
        return ports

    def outputs(self, *slots: Variable) -> tuple[Variable, ...]:
        return slots

    def function(
        self, kind: Token | None, name: str, inputs: Any, outputs: Any, tangent: str | None, loc: Loc | None, *rest: Any
    ) -> Function:
        self.check_names()
        *variables, body = rest
        function = Function(
            name, inputs or (), outputs or (), tuple(variables), body, kind == "pure", loc, kind == "alone", tangent
        )
        self.functions[name] = function
        return function

    def check_names(self) -> None:
        """Check that each use has the same name as its definition."""
        for token in self.mentions:
            name, id = self.split(token)
            definition = self.named.get((token[0], id))
            if name is not None and definition is not None and definition[0] != name:
                self.fail(token, f"{token} is called {definition[1]} on line {definition[1].line}")
        self.mentions.clear()
        self.named.clear()

    # Statements

    def region(self, *statements: Stmt) -> Region:
        return statements

    def let(self, token: Token, type: Type, operation: Callable[[Value], Let], loc: Loc | None) -> Let:
        return operation(self.value(token, type, loc))

    def store(
        self, components: tuple[int, ...] | None, variable: Token, index: Token | None, value: Token, loc: Loc | None
    ) -> Store:
        at = None if index is None else self.use(index)
        return Store(self.use(variable), self.use(value), components, at, loc)

    def call(self, name: str, arguments: Any, loc: Loc | None, results: Any) -> Call:
        tokens: Iterable[Token] = arguments or ()
        callee = self.functions.get(name)
        if callee:
            for token, port in zip(tokens, callee.inputs, strict=False):
                if isinstance(port, Variable) != token.startswith("$"):
                    kind = "a variable such as $1" if isinstance(port, Variable) else "a value such as %3"
                    self.fail(token, f"{name} takes {kind} here, found {str(token)!r}")
        return Call(name, tuple(map(self.use, tokens)), results or (), loc)

    def results(self, *values: Value) -> tuple[Value, ...]:
        return values

    def arguments(self, *tokens: Token) -> tuple[Token, ...]:
        return tokens

    def values(self, *tokens: Token) -> tuple[int, ...]:
        return tuple(map(self.use, tokens))

    def branch(self, condition: Token, loc: Loc | None, then: Region, orelse: Region | None) -> If:
        return If(self.use(condition), then, orelse or (), loc)

    def loop(
        self, turns: int | None, loc: Loc | None, body: Region, continuing: Region | None, until: Token | None
    ) -> Loop:
        return Loop(body, continuing or (), None if until is None else self.use(until), turns, loc)

    def exit(self, word: Token, loc: Loc | None) -> Stmt:
        if word == "break":
            return Break(loc)
        return Continue(loc) if word == "continue" else Return(loc)

    def discard(self, status: int | None, loc: Loc | None) -> Discard:
        return Discard(status or 0, loc)

    # Operations: built when the assigned value is known, since its type determines how a constant is read

    def const(self, constant: list[Token]) -> Callable[[Value], Let]:
        return lambda value: Let(value, "const", (), self.components(value.type, constant))

    def constant(self, *numbers: Token) -> list[Token]:
        return list(numbers)

    def load(self, variable: Token, index: Token | None) -> Callable[[Value], Let]:
        id, args = self.use(variable), () if index is None else (self.use(index),)
        return lambda value: Let(value, "load", args, id)

    def swizzle(self, components: tuple[int, ...], vector: Token) -> Callable[[Value], Let]:
        arg = self.use(vector)
        return lambda value: Let(value, "swizzle", (arg,), components)

    def param_read(self, name: str) -> Callable[[Value], Let]:
        return lambda value: Let(value, "param", (), name)

    def table_size(self, name: str) -> Callable[[Value], Let]:
        return lambda value: Let(value, "table_size", (), name)

    def table_read(self, name: str, index: Token) -> Callable[[Value], Let]:
        arg = self.use(index)
        return lambda value: Let(value, "table", (arg,), name)

    def neighbour(self, name: str, offsets: tuple[int, ...]) -> Callable[[Value], Let]:
        return lambda value: Let(value, "neighbour", offsets, name)

    def apply(self, name: str, args: tuple[int, ...] | None) -> Callable[[Value], Let]:
        return lambda value: Let(value, "call", args or (), name)

    def plain(self, op: str, args: tuple[int, ...] | None) -> Callable[[Value], Let]:
        return lambda value: Let(value, op, args or ())

    def components(self, type: Type, constant: list[Token]) -> tuple[int, ...]:
        """Return the `attr` of a constant, checked against its type."""
        if len(constant) != type.size:
            self.fail(constant[0], f"{type!r} has {type.size} components, found {len(constant)}")
        return encode(type, [self.number(type, token) for token in constant])

    def number(self, type: Type, token: Token) -> float | int | bool:
        if (token in ("true", "false")) != type.is_bool:
            self.fail(token, f"expected {'true or false' if type.is_bool else f'a number of {type!r}'}, found {token}")
        if type.is_bool:
            return str(token) == "true"
        if not type.is_float:
            if not token.lstrip("-").isdigit():
                self.fail(token, f"expected a whole number, found {token}")
            return int(token)
        try:
            number = float.fromhex(token) if "x" in token else float(token)
        except OverflowError:
            number = float("inf")
        if number in (float("inf"), float("-inf")) and "inf" not in token:
            self.fail(token, f"{token} is too large")
        return number

    # The module

    def start(self, name: str, *rest: Any) -> Module:
        ports = [r for r in rest if isinstance(r, tuple)]
        return Module(
            name,
            tuple(port for word, port in ports if word == "input"),
            tuple(port for word, port in ports if word == "output"),
            tuple(r for r in rest if isinstance(r, Param)),
            tuple(r for r in rest if isinstance(r, Table)),
            tuple(r for r in rest if isinstance(r, Function)),
        )


_RULES: Final = [name for name in vars(_Reader) if not name.startswith("_")]
