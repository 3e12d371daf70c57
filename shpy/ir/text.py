r"""Print a module as text, from which `parser.parse` makes an equal module.

Stage: represent. The text is for readers, for bug reports and, without names and locations, the key of the cache of
compiled programs. Values are written `%name.id`, variables `$name.id`, or `%id` and `$id` without a name. Floats are
hexadecimal and exact. A location `@1:12` is line 12 of the file declared as 1. docs/ir.md describes the whole syntax.

    module double
    input x: Attrib1f
    output y: Attrib1f
    function double(%x.0: f) -> ($y.0: f) {
      %1: f = const 0x1p+1
      %2: f = mul %x.0, %1
      store $y.0 = %2
    }

The printer takes any module, also one that breaks the rules, so that the verifier can show it. A part without a syntax
is printed in angle brackets.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final, NamedTuple

from shpy.ir.constants import decode
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
    Return,
    Stmt,
    Store,
    Table,
    Value,
    Variable,
    bind_printer,
)
from shpy.ir.traverse import defined, variables_of
from shpy.ir.types import SIZES, Type

LETTERS: Final = "xyzw"
"""The names of components in swizzles and stores."""

Anchor = tuple[str, int]
"""The content of a line: ("statement", n), the n-th in program order, ("until", n) for a Loop's last line,
("function", i), ("variable", n), ("input", i), ("output", i), ("param", i), ("table", i), ("module", 0), or ("", 0)."""

_BARE = re.compile(r"[^\W\d]\w*")
_ESCAPED = re.compile(r"\\u\{([0-9a-f]+)\}|\\(.)")
_INDENT = "  "


class Line(NamedTuple):
    """One line of the text, with its depth and the `Anchor` of the printed object."""

    depth: int
    text: str
    anchor: Anchor = ("", 0)

    def __str__(self) -> str:
        return _INDENT * self.depth + self.text


def print_module(module: Module, names: bool = True, locations: bool = True) -> str:
    """Return the module as text; `names` of values and variables and `locations` can be left out."""
    return "\n".join(map(str, lines(module, names, locations))) + "\n"


bind_printer(print_module)


def lines(module: Module, names: bool = True, locations: bool = True) -> list[Line]:
    """Return the lines of `print_module`, each with the object that it prints."""
    return _Printer(names, locations).module(module)


def quote(text: str) -> str:
    """Return a name as printed: unquoted if it is an identifier, else in quotes with escapes."""
    return text if _BARE.fullmatch(text) else _string(text)


def _string(text: str) -> str:
    return '"' + "".join(map(_escape, text)) + '"'


def _escape(character: str) -> str:
    if character in '\\"':
        return "\\" + character
    return character if character.isprintable() else f"\\u{{{ord(character):x}}}"


def unquote(text: str) -> str:
    """Return the name from the text of `quote`; ValueError for an escape of a character that does not exist."""
    if not text.startswith('"'):
        return text
    return _ESCAPED.sub(lambda m: chr(int(m[1], 16)) if m[1] else m[2], text[1:-1])


class _Printer:
    """Prints one module once."""

    def __init__(self, names: bool, locations: bool) -> None:
        self.names = names
        self.locations = locations
        self.files: dict[str, int] = {}
        self.named_values: dict[int, str] = {}
        self.named_variables: dict[int, str] = {}
        self.references: dict[str, Function] = {}
        self.out: list[Line] = []
        self.statements = 0
        self.slots = 0

    def module(self, module: Module) -> list[Line]:
        """Return all lines. The functions are printed first, because they determine the list of files."""
        for i, function in enumerate(module.functions):
            self.function(i, function)
            self.references[function.name] = function
        head = [Line(0, f"module {quote(module.name)}", ("module", 0))]
        head += [Line(0, f"file {n} {_string(file)}") for file, n in self.files.items()]
        for word, ports in (("input", module.inputs), ("output", module.outputs)):
            head += [
                Line(0, f"{word} {quote(port.name)}: {quote(port.kind)}", (word, i)) for i, port in enumerate(ports)
            ]
        head += [Line(0, _param(param), ("param", i)) for i, param in enumerate(module.params)]
        head += [Line(0, _table(table), ("table", i)) for i, table in enumerate(module.tables)]
        return head + self.out

    def function(self, index: int, function: Function) -> None:
        if self.names:
            self.named_values = _named("%", defined(function))
            self.named_variables = _named("$", variables_of(function))
        inputs = ", ".join(map(self.declared, function.inputs))
        outputs = ", ".join(map(self.declared, function.outputs))
        kind = "pure " if function.pure else "alone " if function.alone else ""
        rule = f" tangent {quote(function.tangent)}" if function.tangent else ""
        head = f"{kind}function {quote(function.name)}({inputs}) -> ({outputs}){rule}{self.at(function.loc)} {{"
        self.out += [Line(0, ""), Line(0, head, ("function", index))]
        for slot in function.variables:
            self.out.append(Line(1, f"var {self.declared(slot)}", ("variable", self.slots)))
            self.slots += 1
        self.body(function.body)
        self.out.append(Line(0, "}"))

    def body(self, region: Iterable[Stmt]) -> None:
        """Print every statement, without recursion; a stack holds the statements still to print, the last first."""
        pending: list[tuple[int, Stmt | Line]] = [(1, s) for s in reversed(tuple(region))]
        while pending:
            depth, item = pending.pop()
            if isinstance(item, Line):
                self.out.append(item)
                continue
            number = self.statements
            self.statements += 1
            self.out.append(Line(depth, self.statement(item), ("statement", number)))
            if isinstance(item, Let):
                continue
            nested: list[tuple[int, Stmt | Line]] = []
            match item:
                case If(_, then, orelse):
                    nested += [(depth + 1, s) for s in then]
                    if orelse:
                        nested.append((depth, Line(depth, "} else {")))
                        nested += [(depth + 1, s) for s in orelse]
                    nested.append((depth, Line(depth, "}")))
                case Loop(body, continuing, until):
                    nested += [(depth + 1, s) for s in body]
                    if continuing:
                        nested.append((depth, Line(depth, "} continuing {")))
                        nested += [(depth + 1, s) for s in continuing]
                    end = "}" if until is None else f"}} until {self.value(until)}"
                    nested.append((depth, Line(depth, end, ("until", number))))
            pending.extend(reversed(nested))

    def statement(self, statement: Stmt) -> str:
        """Return the text of the statement's line, or of the first line of an If or Loop."""
        match statement:
            case Let(value):
                return f"{self.declared(value, located=False)} = {self.operation(statement)}{self.at(value.loc)}"
            case Store(variable, value, components, index, loc):
                element = "" if index is None else f"[{self.value(index)}]"
                picked = "" if components is None else f".{components_text(components)}"
                return f"store{picked} {self.variable(variable)}{element} = {self.value(value)}{self.at(loc)}"
            case Call(name, args, results, loc):
                arrow = f" -> {', '.join(map(self.declared, results))}" if results else ""
                return f"call {quote(name)}({', '.join(self.arguments(name, args))}){self.at(loc)}{arrow}"
            case If(condition, loc=loc):
                return f"if {self.value(condition)}{self.at(loc)} {{"
            case Loop(turns=turns, loc=loc):
                bound = "" if turns is None else f" turns {turns}"
                return f"loop{bound}{self.at(loc)} {{"
            case Break(loc):
                return f"break{self.at(loc)}"
            case Continue(loc):
                return f"continue{self.at(loc)}"
            case Return(loc):
                return f"return{self.at(loc)}"
            case Discard(status, loc):
                return f"discard{f' {status}' if status else ''}{self.at(loc)}"

    def operation(self, let: Let) -> str:
        """Return the right side of a Let."""
        args = ", ".join(map(self.value, let.args))
        match let.op, let.attr:
            case "const", _ if not args:
                return f"const {_constant(let.value.type, let.attr)}"
            case "load", int(variable):
                return f"load {self.variable(variable)}" + (f"[{args}]" if args else "")
            case "swizzle", tuple(components):
                return f"swizzle.{components_text(components)} {args}"
            case "param" | "table_size", str(name) if not args:
                return f"{let.op} {quote(name)}"
            case "table", str(name) if args:
                return f"table {quote(name)}[{args}]"
            case "neighbour", str(name) if args:
                return f"neighbour {quote(name)}[{args}]"
            case "call", str(name):
                return f"call {quote(name)}({args})"
            case op, None:
                return f"{quote(op)} {args}" if args else quote(op)
            case op, attr:
                return f"{quote(op)} <{attr!r}> {args}".rstrip()

    def arguments(self, name: str, args: tuple[int, ...]) -> list[str]:
        """Return a Call's arguments; those of an unknown function, or beyond its inputs, are printed as values."""
        callee = self.references.get(name)
        ports = callee.inputs if callee else ()
        return [
            self.variable(arg) if i < len(ports) and isinstance(ports[i], Variable) else self.value(arg)
            for i, arg in enumerate(args)
        ]

    def declared(self, thing: Value | Variable, located: bool = True) -> str:
        """Return the text of a value or variable at its definition."""
        at = self.at(thing.loc) if located else ""
        if isinstance(thing, Value):
            return f"{self.value(thing.id)}: {thing.type!r}{at}"
        length = "" if thing.length is None else f"[{thing.length}]"
        return f"{self.variable(thing.id)}: {thing.type!r}{length}{at}"

    def value(self, id: int) -> str:
        return self.named_values.get(id) or f"%{id}"

    def variable(self, id: int) -> str:
        return self.named_variables.get(id) or f"${id}"

    def at(self, loc: Loc | None) -> str:
        if loc is None or not self.locations:
            return ""
        return f" @{self.files.setdefault(loc.file, len(self.files) + 1)}:{loc.line}"


def _named(sign: str, things: Iterable[Value | Variable]) -> dict[int, str]:
    """Return the texts of the values or variables that have a name, by id."""
    return {thing.id: f"{sign}{quote(thing.name)}.{thing.id}" for thing in things if thing.name is not None}


def components_text(components: tuple[int, ...]) -> str:
    """Return the text of components: `xz`, or `s06` where one lies beyond the fourth."""
    if components and all(0 <= c < len(LETTERS) for c in components):
        return "".join(LETTERS[c] for c in components)
    if components and all(0 <= c < SIZES[-1] for c in components):
        return f"s{''.join(map(str, components))}"
    return f"<{components}>"


def _constant(type: Type, attr: object) -> str:
    try:
        if not isinstance(attr, tuple) or not attr:
            raise TypeError
        words = [_number(c) for c in decode(type, attr)]
    except (TypeError, ValueError, OverflowError, AttributeError):
        return f"<{attr!r}>"
    return words[0] if len(words) == 1 else f"({', '.join(words)})"


def _number(component: object) -> str:
    if isinstance(component, bool):
        return "true" if component else "false"
    if isinstance(component, float):
        return re.sub(r"\.?0*p", "p", component.hex()) if component else component.hex().replace(".0p", "p")
    return str(component)


def _param(param: Param) -> str:
    value = _constant(param.type, param.value)
    return f"param {quote(param.name)}: {quote(param.kind)} {param.type!r} = {value}{_about(param.about)}"


def _about(about: About) -> str:
    ends = "" if about.range is None else f" range ({', '.join(map(_number, about.range))})"
    step = "" if about.step is None else f" step {_number(about.step)}"
    texts = (("title", about.title), ("description", about.description))
    return ends + step + "".join(f" {word} {_string(text)}" for word, text in texts if text is not None)


def _table(table: Table) -> str:
    extents = table.size if table.size is not None else ("?",) * table.rank
    shown = f"{table.type!r}[{', '.join(map(str, extents))}]"
    odd = "" if len(extents) == table.rank else f" <rank {table.rank}>"
    return f"table {quote(table.name)}: {shown}{odd}"
