"""Parsed source files: one parse a file, found through linecache, so that notebooks work too.

Stage: record. Takes a file's name as code objects give it; gives its syntax tree, or None where there is no text
(a REPL, `exec`) or it does not parse.

    parsed("demo.py")               # ast.Module
    definition(function.__code__)   # the ast.FunctionDef that made it
"""

from __future__ import annotations

import ast
import functools
import linecache
from types import CodeType
from typing import TypeAlias

from shpy.ir.nodes import Loc
from shpy.parsing import parse

FunctionNode: TypeAlias = ast.FunctionDef | ast.AsyncFunctionDef

_LONGEST = 72

_files: dict[str, tuple[list[str], ast.Module | None]] = {}


def parsed(file: str) -> ast.Module | None:
    """Return the file's tree. linecache returns the same list of lines until the file changes, which keys the cache."""
    lines = linecache.getlines(file)
    known = _files.get(file)
    if known is not None and known[0] is lines:
        return known[1]
    tree: ast.Module | None = None
    if lines:
        try:
            tree = parse("".join(lines))
        except (SyntaxError, ValueError, RecursionError, MemoryError):  # `bytecode` checks frames instead
            tree = None
    _files[file] = (lines, tree)
    return tree


def definition(code: CodeType) -> FunctionNode | None:
    """Return the `def` that the code was compiled from; None for lambdas, and where the text has changed since."""
    tree = parsed(code.co_filename)
    if tree is None:
        return None
    for node in _functions(tree).get((code.co_name, code.co_firstlineno), ()):
        if _arguments(node) == code.co_varnames[: len(_arguments(node))]:
            return node
    return None


@functools.lru_cache(maxsize=256)
def _functions(tree: ast.Module) -> dict[tuple[str, int], list[FunctionNode]]:
    """Return the functions of a file by name and first line, which is that of the first decorator."""
    found: dict[tuple[str, int], list[FunctionNode]] = {}
    for node in ast.walk(tree):
        if isinstance(node, FunctionNode):
            first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            found.setdefault((node.name, first), []).append(node)
    return found


def in_one_statement(a: Loc | None, b: Loc | None) -> bool:
    """Return whether two lines are one, or belong to one statement without others in it, such as a call over lines."""
    if a is None or b is None or a == b:
        return a == b
    low, high = sorted((a.line, b.line))
    tree = parsed(a.file) if a.file == b.file else None
    return tree is not None and any(
        node.lineno <= low and high <= (node.end_lineno or 0)
        for node in ast.walk(tree)
        if isinstance(node, ast.stmt) and not hasattr(node, "body")
    )


def quoted(file: str, node: ast.AST) -> str:
    """Return the node as the user wrote it, on one line, shortened if it is long."""
    text = ""
    if isinstance(node, ast.expr | ast.stmt) and node.lineno == node.end_lineno:
        line = linecache.getline(file, node.lineno).encode()  # columns count bytes
        text = line[node.col_offset : node.end_col_offset].decode(errors="replace")
    text = text or " ".join(ast.unparse(node).split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _arguments(node: FunctionNode) -> tuple[str, ...]:
    arguments = node.args
    return tuple(a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs))
