"""Small faults at random places of the product's source.

    faults = chosen(7301, 60)                # 20 places in backends, 20 in passes, 20 in kernels
    faults[0].applied(source_of_its_file)    # the text with the fault

A fault changes one place: another comparison or operator, a negated condition, a constant that is one larger, a
statement left out. No fault is put into texts, annotations, types or what raises errors.
"""

from __future__ import annotations

import ast
import difflib
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PARTS = {
    "backends": ("shpy/backend",),
    "passes": ("shpy/passes",),
    "kernels": ("raytracer/kernels", "raytracer/integrators", "shpy/library"),
    "structures": ("raytracer/accel", "raytracer/view"),
    "language": ("shpy/lang",),
    "running": ("shpy/run", "shpy/streams", "shpy/chains", "shpy/collectives"),
    "measuring": ("shpy/accuracy", "shpy/testing"),
    "scenes": ("raytracer/meshes", "raytracer/scene"),
    "pages": ("shpy/view",),
}
"""Folders of each part."""
DRAWN = ("backends", "passes", "kernels")
"""The parts that faults are put into unless others are asked for."""

COMPARISONS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "is": "is not", "is not": "is",
               "in": "not in", "not in": "in"}  # fmt: skip
OPERATORS = {"+": "-", "-": "+", "*": "+", "/": "*", "//": "*", "%": "+", "<<": ">>", ">>": "<<", "&": "|", "|": "&"}
WORDS = {"and": "or", "or": "and"}


@dataclass(frozen=True)
class Fault:
    """A replacement of the text between two offsets of a file."""

    part: str
    path: str
    function: int
    """First line of the innermost function around it, its decorators included; 0 outside functions."""
    start: int
    end: int
    text: str

    def applied(self, source: str) -> str:
        """Return the text of the file with the fault."""
        return source[: self.start] + self.text + source[self.end :]

    def shown(self) -> str:
        """Return the file, the line, and how it changes."""
        source = (ROOT / self.path).read_text()
        lines = difflib.unified_diff(source.splitlines(), self.applied(source).splitlines(), n=0, lineterm="")
        changed = [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]
        return f"{self.path}:{source.count(chr(10), 0, self.start) + 1}\n    " + "\n    ".join(changed)


class Places:
    """Offsets of the nodes of a file."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.lines = [0]
        for line in source.splitlines(keepends=True):
            self.lines.append(self.lines[-1] + len(line))

    def offset(self, line: int, column: int) -> int:
        """Return the offset of a place that ast tells in bytes."""
        start = self.lines[line - 1]
        text = self.source[start : self.lines[line]]
        return start + len(text.encode()[:column].decode())

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        """Return where a node begins and ends."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self.offset(node.lineno, node.col_offset), self.offset(node.end_lineno, node.end_col_offset)

    def between(self, left: ast.expr, right: ast.expr, words: dict[str, str]) -> tuple[int, int, str] | None:
        """Return the operator between two operands, by its span, and its replacement."""
        start, end = self.span(left)[1], self.span(right)[0]
        found = re.fullmatch(r"([\s)]*)(\S+|is not|not in)([\s(\\]*)", self.source[start:end])
        if found is None or found[2] not in words:
            return None
        return start + found.start(2), start + found.end(2), words[found[2]]


def faults_in(part: str, path: str) -> Iterator[Fault]:
    """Yield every fault that can be put into a file."""
    source = (ROOT / path).read_text()
    places = Places(source)
    for node, function in running(ast.parse(source), 0):
        for start, end, text in changes(node, places):
            yield Fault(part, path, function, start, end, text)


UNTOUCHED_FIELDS = ("annotation", "returns", "decorator_list", "bases", "type_params")
UNTOUCHED = ast.Import | ast.ImportFrom | ast.Raise | ast.Assert | ast.JoinedStr


def running(node: ast.AST, function: int) -> Iterator[tuple[ast.AST, int]]:
    """Yield the nodes that run, each with the first line of its function.

    Annotations, decorators, imports, types, texts and what raises errors are left out.
    """
    for name, value in ast.iter_fields(node):
        if name in UNTOUCHED_FIELDS:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, UNTOUCHED) and not of_types(child):
                yield child, function
                yield from running(child, first_line(child) or function)


def first_line(node: ast.AST) -> int | None:
    """Return where a function begins as its code object tells it; None for other nodes."""
    match node:
        case ast.FunctionDef(decorator_list=[first, *_]) | ast.AsyncFunctionDef(decorator_list=[first, *_]):
            return first.lineno
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.Lambda():
            return node.lineno
    return None


def of_types(node: ast.AST) -> bool:
    """Tell whether a node only says what type something has."""
    match node:
        case ast.If(test):
            return ast.unparse(test) == "TYPE_CHECKING"
        case ast.AnnAssign(annotation=annotation):
            return ast.unparse(annotation).endswith("TypeAlias")
        case ast.Subscript(ast.Name(name)) | ast.Subscript(ast.Attribute(attr=name)):
            return name in ("Literal", "Callable", "Union", "Optional", "Annotated")
        case ast.BinOp(left, ast.BitOr(), right):
            return all(is_type(side) for side in (left, right))
    return False


def is_type(node: ast.expr) -> bool:
    """Tell whether an operand of `|` is the name of a type, or None."""
    match node:
        case ast.BinOp(left, ast.BitOr(), right):
            return is_type(left) and is_type(right)
        case ast.Constant(None):
            return True
        case ast.Subscript(value):
            return is_type(value)
        case ast.Name(name) | ast.Attribute(attr=name):
            return name in ("int", "float", "bool", "str", "bytes", "tuple", "list", "dict") or bool(
                re.fullmatch("[A-Z]+[a-z]\\w*", name)
            )
    return False


def changes(node: ast.AST, places: Places) -> Iterator[tuple[int, int, str]]:
    """Yield the changes of one node: (start, end, text)."""
    found: list[tuple[int, int, str] | None] = []
    match node:
        case ast.Compare(left, [_], [right]):
            found.append(places.between(left, right, COMPARISONS))
        case ast.BinOp(left, _, right) if not (isinstance(left, ast.Constant) and isinstance(left.value, str)):
            found.append(places.between(left, right, OPERATORS))
        case ast.BoolOp(_, [left, right, *_]):
            found.append(places.between(left, right, WORDS))
        case ast.If(test) | ast.IfExp(test) | ast.While(test):
            start, end = places.span(test)
            found.append((start, end, f"not ({places.source[start:end]})"))
        case ast.Constant(bool(value)):
            found.append((*places.span(node), str(not value)))
        case ast.Constant(int(value)):
            found.append((*places.span(node), str(value + 1)))
        case ast.Expr(ast.Call()):
            found.append((*places.span(node), "pass"))
    yield from (change for change in found if change is not None)


def chosen(seed: int, count: int, parts: tuple[str, ...] = DRAWN) -> list[Fault]:
    """Return faults at random places, as many in each part; within a part, each place is as likely as any other."""
    drawn = random.Random(seed)
    faults = []
    for n, name in enumerate(parts):
        files = sorted(p for folder in PARTS[name] for p in (ROOT / folder).rglob("*.py"))
        every = [fault for path in files for fault in faults_in(name, str(path.relative_to(ROOT)))]
        faults += drawn.sample(every, count // len(parts) + (n < count % len(parts)))
    return faults
