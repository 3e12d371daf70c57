"""Writes a tree in the language, as text that a person can run, and records it.

Stage: test. Takes a `Tree`, gives its source text, or a `Generated` program.

    print(source(tree))
    record(tree).compile("numpy")
"""

from __future__ import annotations

import itertools
import linecache
from collections.abc import Iterator
from typing import Any

import numpy as np

import shpy as sh
from shpy.ir.types import Base, Type
from shpy.program import Program
from shpy.testing.generated.syntax import (
    Apply,
    Assign,
    Block,
    Call,
    Component,
    Const,
    Construct,
    Convert,
    Declare,
    Do,
    Exit,
    Expr,
    For,
    If,
    Lanes,
    Name,
    Read,
    Splat,
    Stmt,
    Swizzle,
    Tree,
    While,
    Write,
)

__all__ = ["TABLES", "Generated", "class_of", "record", "source"]

SYMBOLS = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "floordiv": "//", "floormod": "%", "and": "&", "or": "|",
    "xor": "^", "shl": "<<", "shr": ">>", "eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">=",
}  # fmt: skip
PREFIX = {"neg": "-", "not": "~"}


def class_of(type: Type) -> str:
    """The type's name in the language."""
    return f"sh.Attrib{type.size}{type.base.value}"


def number(base: Base, value: float) -> str:
    """A literal that a Python float or int can be written as."""
    if base is Base.B:
        return str(bool(value))
    if base in (Base.I, Base.U):
        return str(int(value))
    return f"np.float32('{value}')" if np.isinf(value) or np.isnan(value) else repr(float(value))


def text(e: Expr) -> str:
    """The expression in the language."""
    match e:
        case Const(type, values):
            return f"{class_of(type)}({', '.join(number(type.base, v) for v in values)})"
        case Name(_, name):
            return name
        case Splat(_, scalar):
            return text(scalar)
        case Apply(_, op, args) if op in SYMBOLS:
            right = args[1]
            written = text(right)
            if isinstance(right, Const) and right.type.size == 1 and not isinstance(args[0], Const):
                written = written if op in ("shl", "shr") else number(right.type.base, right.values[0])
            return f"({text(args[0])} {SYMBOLS[op]} {written})"
        case Apply(_, op, args) if op in PREFIX:
            return f"({PREFIX[op]}{text(args[0])})"
        case Apply(_, op, args):
            return f"sh.{'mod' if op == 'floormod' else op}({', '.join(map(text, args))})"
        case Convert(type, value):
            return f"{class_of(type)}({text(value)})"
        case Construct(type, parts):
            return f"{class_of(type)}({', '.join(map(text, parts))})"
        case Swizzle(_, value, picked):
            return f"{text(value)}.{''.join('xyzw'[p] for p in picked)}"
        case Component(_, value, index):
            return f"{text(value)}[{text(index)}]"
        case Read(_, name, index):
            return f"{name}[{', '.join(map(text, index))}]"


class _Writer:
    """Writes a program's source text."""

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        self.lines: list[str] = []
        self.results: tuple[Expr, ...] = ()

    def source(self) -> str:
        """The whole text."""
        for function in self.tree.functions:
            self.results = function.results
            self.line(0, "@sh.subroutine")
            self.line(0, f"def {function.name}({', '.join(p.name for p in function.params)}):")
            self.block(1, function.body)
            self.line(1, self.returned("return", ""))
            self.lines += ["", ""]
        self.results = self.tree.results
        self.line(0, "@sh.program")
        self.line(0, f"def generated({', '.join(f'{i.name}: {class_of(i.type)}' for i in self.tree.inputs)}):")
        for array in self.tree.arrays:
            self.line(1, f"{array.name} = sh.Array({class_of(array.type)}, {array.length})")
        self.block(1, self.tree.body)
        self.line(1, self.returned("return", ""))
        return "\n".join(self.lines) + "\n"

    def line(self, depth: int, content: str) -> None:
        self.lines.append("    " * depth + content)

    def returned(self, word: str, condition: str) -> str:
        values = ", ".join(map(text, self.results))
        if word == "return":
            return f"return {values}".rstrip()
        given = f"({values})" if len(self.results) > 1 else values or "None"
        return f"{word}({given}{f', {condition}' if condition else ''})"

    def block(self, depth: int, block: Block) -> None:
        for statement in block:
            self.statement(depth, statement)
        if not block:
            self.line(depth, "pass")

    def statement(self, depth: int, s: Stmt) -> None:
        match s:
            case Declare(name, value):
                fresh = isinstance(value, Apply | Construct | Convert | Const)
                self.line(depth, f"{name} = {text(value) if fresh else f'{class_of(value.type)}({text(value)})'}")
            case Assign(name, value, picked, op):
                place = f"{name}[:]" if picked is None else f"{name}.{''.join('xyzw'[p] for p in picked)}"
                place = name if op is not None and picked is None else place
                self.line(depth, f"{place} {SYMBOLS[op] if op else ''}= {text(value)}")
            case Write(name, index, value):
                self.line(depth, f"{name}[{text(index)}] = {text(value)}")
            case Call(function, args, result):
                call = f"{function}({', '.join(map(text, args))})"
                self.line(depth, f"{result}[:] = {call}" if result else call)
            case Lanes(how, condition, name, value):
                self.line(depth, f"with SH_IF(sh.{how}({text(condition)})):")
                masked = f"{name}[:] = sh.cond({text(condition)}, {text(value)}, {name})"
                self.line(depth + 1, masked if how == "any_lane" else f"{name}[:] = {text(value)}")
                if how == "all_lanes":
                    self.line(depth, "with SH_ELSE():")
                    self.line(depth + 1, masked)
            case Exit("return", condition):
                self.line(depth, self.returned("SH_RETURN", text(condition) if condition else ""))
            case Exit(kind, condition):
                self.line(depth, f"SH_{kind.upper()}({text(condition) if condition else ''})")
            case _:
                self.compound(depth, s)

    def compound(self, depth: int, s: If | While | Do | For) -> None:
        match s:
            case If(branches, orelse):
                for word, (condition, body) in zip(itertools.chain(["IF"], itertools.repeat("ELIF")), branches):  # noqa: B905
                    self.line(depth, f"with SH_{word}({text(condition)}):")
                    self.block(depth + 1, body)
                if orelse is not None:
                    self.line(depth, "with SH_ELSE():")
                    self.block(depth + 1, orelse)
            case While(condition, body):
                self.line(depth, f"with SH_WHILE(lambda: {text(condition)}):")
                self.block(depth + 1, body)
            case Do(body, until, late):
                self.line(depth, "with SH_DO():")
                self.block(depth + 1, body) if body else None
                self.line(depth + 1, f"SH_UNTIL({'lambda: ' if late else ''}{text(until)})")
            case For(index, bounds, body):
                given = ", ".join(number(Base.I, b.values[0]) if isinstance(b, Const) else text(b) for b in bounds)
                self.line(depth, f"with SH_FOR({given}) as {index}:")
                self.block(depth + 1, body)


def source(tree: Tree) -> str:
    """The program in the language."""
    return _Writer(tree).source()


_files: Iterator[int] = itertools.count()
TABLES: dict[str, sh.Table[Any, Any]] = {
    "line": sh.Table(np.array([1.5, -2, 0.25, 3e4, -0.0], np.float32), sh.Attrib1f, name="line"),
    "grid": sh.Table(np.arange(12).reshape(2, 3, 2) / 4, sh.Attrib2f, name="grid"),
    "counts": sh.Table(np.array([2**31 - 1, -(2**24) - 1, 0, 7]), sh.Attrib1i, name="counts"),
}
"""The data that generated programs read."""


class Generated(Program):
    """A generated program: `tree` is its syntax, `text` its source, which hypothesis prints where it fails."""

    tree: Tree
    text: str

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """What hypothesis prints when it has found a program that fails."""
        printer.text(f"the program\n\n{self.text}")


def record(tree: Tree) -> Generated:
    """Run the text. Python finds its lines, so that errors and the emitted text can name them."""
    written = source(tree)
    file = f"<generated {next(_files)}>"
    linecache.cache[file] = (len(written), None, written.splitlines(True), file)
    names = {"sh": sh, "np": np, **TABLES, **{n: getattr(sh, n) for n in sh.__all__ if n.startswith("SH_")}}
    exec(compile(written, file, "exec"), names)
    made = Generated(names["generated"]._recorded)
    made.tree, made.text = tree, written
    return made
