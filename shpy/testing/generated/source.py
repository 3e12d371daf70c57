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
from shpy.programs import Program
from shpy.testing.generated import syntax
from shpy.testing.generated.syntax import F3, FIELDS, B, F, I

SYMBOLS = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "floordiv": "//", "floormod": "%", "and": "&", "or": "|",
    "xor": "^", "shl": "<<", "shr": ">>", "eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">=",
}  # fmt: skip
PREFIX = {"neg": "-", "not": "~"}


def class_of(type: Type) -> str:
    """Return the type's name in the language."""
    return f"sh.Attrib{type.size}{type.base.value}"


def number(base: Base, value: float) -> str:
    """Return a literal that a Python float or int can be written as."""
    if base is Base.B:
        return str(bool(value))
    if base in (Base.I, Base.U):
        return str(int(value))
    return f"np.float32('{value}')" if np.isinf(value) or np.isnan(value) else repr(float(value))


def text(e: syntax.Expr) -> str:
    """Return the expression in the language."""
    match e:
        case syntax.Const(type, values):
            return f"{class_of(type)}({', '.join(number(type.base, v) for v in values)})"
        case syntax.Name(_, name):
            return name
        case syntax.Splat(_, scalar):
            return text(scalar)
        case syntax.Apply(_, op, args) if op in SYMBOLS:
            right = args[1]
            written = text(right)
            if isinstance(right, syntax.Const) and right.type.size == 1 and not isinstance(args[0], syntax.Const):
                written = written if op in ("shl", "shr") else number(right.type.base, right.values[0])
            return f"({text(args[0])} {SYMBOLS[op]} {written})"
        case syntax.Apply(_, op, args) if op in PREFIX:
            return f"({PREFIX[op]}{text(args[0])})"
        case syntax.Apply(_, op, args):
            return f"sh.{'mod' if op == 'floormod' else op}({', '.join(map(text, args))})"
        case syntax.Convert(type, value):
            return f"{class_of(type)}({text(value)})"
        case syntax.Construct(type, parts):
            return f"{class_of(type)}({', '.join(map(text, parts))})"
        case syntax.Swizzle(_, value, picked):
            return f"{text(value)}.{''.join('xyzw'[p] for p in picked)}"
        case syntax.Component(_, value, index):
            return f"{text(value)}[{text(index)}]"
        case syntax.Read(_, name, index, field):
            return f"{name}[{', '.join(map(text, index))}]{'.' * bool(field)}{field}"
        case syntax.LaneIndex(_, how, condition):
            return f"sh.cond(sh.{how}({text(condition)}), 7, 9)"
        case syntax.Product(_, matrix, vector, left):
            return f"({text(vector)} @ {matrix})" if left else f"({matrix} @ {text(vector)})"


def _place(name: str, picked: tuple[int, ...] | None, op: str | None) -> str:
    """Return the target of a store: `x[:]`, `x.xy`, `m[0]`, `m[0, 1]`."""
    if name.endswith("]"):
        return name if picked is None else f"{name[:-1]}, {', '.join(map(str, picked))}]"
    if picked is not None:
        return f"{name}.{''.join('xyzw'[p] for p in picked)}"
    return name if op is not None else f"{name}[:]"


class _Writer:
    """Writes a program's source text."""

    def __init__(self, tree: syntax.Tree) -> None:
        self.tree = tree
        self.lines: list[str] = []
        self.results: tuple[syntax.Expr, ...] = ()

    def source(self) -> str:
        """Return the whole text."""
        self.line(0, "@sh.struct")
        self.line(0, "class Pair:")
        for field, type in FIELDS.items():
            self.line(1, f"{field}: {class_of(type)}")
        self.lines += ["", ""]
        without = len(self.lines)
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
            element = "Pair" if array.struct else class_of(array.type)
            self.line(1, f"{array.name} = sh.Array({element}, {array.length})")
        self.block(1, self.tree.body)
        self.line(1, self.returned("return", ""))
        used = any("Pair" in line for line in self.lines[without:])
        return "\n".join(self.lines if used else self.lines[without:]) + "\n"

    def line(self, depth: int, content: str) -> None:
        self.lines.append("    " * depth + content)

    def returned(self, word: str, condition: str) -> str:
        values = ", ".join(map(text, self.results))
        if word == "return":
            return f"return {values}".rstrip()
        operands = f"({values})" if len(self.results) > 1 else values or "None"
        return f"{word}({operands}{f', {condition}' if condition else ''})"

    def block(self, depth: int, block: syntax.Block) -> None:
        for statement in block:
            self.statement(depth, statement)
        if not block:
            self.line(depth, "pass")

    def plain(self, depth: int, s: syntax.Plain) -> None:
        match s:
            case syntax.Declare(name, value):
                fresh = isinstance(value, syntax.Apply | syntax.Construct | syntax.Convert | syntax.Const)
                self.line(depth, f"{name} = {text(value) if fresh else f'{class_of(value.type)}({text(value)})'}")
            case syntax.DeclareMatrix(name, rows):
                self.line(depth, f"{name} = sh.Matrix{len(rows)}f({', '.join(map(text, rows))})")
            case syntax.DeclareStruct(name, values):
                self.line(depth, f"{name} = Pair({', '.join(map(text, values))})")
            case syntax.Assign(name, value, picked, op):
                self.line(depth, f"{_place(name, picked, op)} {SYMBOLS[op] if op else ''}= {text(value)}")
            case syntax.StoreAt(name, index, value):
                self.line(depth, f"{name}[{text(index)}] = {text(value)}")
            case syntax.Write(name, index, value, op):
                self.line(depth, f"{name}[{text(index)}] {SYMBOLS[op] if op else ''}= {text(value)}")
            case syntax.WriteStruct(name, index, values):
                self.line(depth, f"{name}[{text(index)}] = Pair({', '.join(map(text, values))})")
            case syntax.Multiply(name, other):
                self.line(depth, f"{name}[:] = {name} @ {other}")

    def statement(self, depth: int, s: syntax.Stmt) -> None:
        if isinstance(s, syntax.Plain):
            self.plain(depth, s)
            return
        match s:
            case syntax.Call(function, args, result):
                call = f"{function}({', '.join(map(text, args))})"
                self.line(depth, f"{result}[:] = {call}" if result else call)
            case syntax.Lanes(how, condition, name, value):
                self.line(depth, f"with SH_IF(sh.{how}({text(condition)})):")
                masked = f"{name}[:] = sh.cond({text(condition)}, {text(value)}, {name})"
                self.line(depth + 1, masked if how == "any_lane" else f"{name}[:] = {text(value)}")
                if how == "all_lanes":
                    self.line(depth, "with SH_ELSE():")
                    self.line(depth + 1, masked)
            case syntax.Exit("return", condition):
                self.line(depth, self.returned("SH_RETURN", text(condition) if condition else ""))
            case syntax.Exit(kind, condition):
                self.line(depth, f"SH_{kind.upper()}({text(condition) if condition else ''})")
            case _:
                self.compound(depth, s)

    def compound(self, depth: int, s: syntax.If | syntax.While | syntax.Do | syntax.For) -> None:
        match s:
            case syntax.If(branches, orelse):
                for word, (condition, body) in zip(itertools.chain(["IF"], itertools.repeat("ELIF")), branches):  # noqa: B905
                    self.line(depth, f"with SH_{word}({text(condition)}):")
                    self.block(depth + 1, body)
                if orelse is not None:
                    self.line(depth, "with SH_ELSE():")
                    self.block(depth + 1, orelse)
            case syntax.While(condition, body):
                self.line(depth, f"with SH_WHILE(lambda: {text(condition)}):")
                self.block(depth + 1, body)
            case syntax.Do(body, until, late):
                self.line(depth, "with SH_DO():")
                self.block(depth + 1, body) if body else None
                self.line(depth + 1, f"SH_UNTIL({'lambda: ' if late else ''}{text(until)})")
            case syntax.For(index, bounds, body):
                limits = ", ".join(
                    number(Base.I, b.values[0]) if isinstance(b, syntax.Const) else text(b) for b in bounds
                )
                self.line(depth, f"with SH_FOR({limits}) as {index}:")
                self.block(depth + 1, body)


def source(tree: syntax.Tree) -> str:
    """Return the program in the language."""
    return _Writer(tree).source()


_files: Iterator[int] = itertools.count()
TABLES: dict[str, sh.Table[Any, Any]] = {
    "line": sh.Table(np.array([1.5, -2, 0.25, 3e4, -0.0], np.float32), sh.Attrib1f, name="line"),
    "points": sh.Table(np.arange(24).reshape(8, 3) / 8, sh.Attrib3f, name="points"),
    "grid": sh.Table(np.arange(12).reshape(2, 3, 2) / 4, sh.Attrib2f, name="grid"),
    "counts": sh.Table(np.array([2**31 - 1, -(2**24) - 1, 0, 7]), sh.Attrib1i, name="counts"),
}
"""The data that generated programs read."""

PARAMS = {
    "pf": sh.Param(sh.Attrib1f, 0.75, name="pf"),
    "pv": sh.Param(sh.Attrib3f, (-0.5, 2, 1e-3), name="pv"),
    "pi": sh.Param(sh.Attrib1i, 2, name="pi"),
    "pb": sh.Param(sh.Attrib1b, True, name="pb"),
}
"""The uniforms that they read."""

UNIFORMS = (syntax.Variable("pf", F), syntax.Variable("pv", F3), syntax.Variable("pi", I), syntax.Variable("pb", B))
"""The names and types of PARAMS, in their order."""


class Generated(Program):
    """A generated program: `tree` is its syntax, `text` its source, which hypothesis prints where it fails."""

    tree: syntax.Tree
    text: str

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """Print a failing program for hypothesis."""
        printer.text(f"the program\n\n{self.text}")


def record(tree: syntax.Tree) -> Generated:
    """Run the text. Python finds its lines, so that errors and the emitted text can name them."""
    written = source(tree)
    file = f"<generated {next(_files)}>"
    linecache.cache[file] = (len(written), None, written.splitlines(True), file)
    names = {"sh": sh, "np": np, **TABLES, **PARAMS, **{n: getattr(sh, n) for n in sh.__all__ if n.startswith("SH_")}}
    exec(compile(written, file, "exec"), names)
    program = Generated(names["generated"].recorded)
    program.tree, program.text = tree, written
    return program
