"""The syntax trees of the user's functions and statements.

Stage: record. Takes code objects, and lines; gives the nodes of the texts that they were compiled from, or None where
no text belongs to them (a REPL, `exec`, a file that was edited since).

    definition_of(function.__code__)   # the ast.FunctionDef that made it, and its Text
"""

from __future__ import annotations

import ast
import functools
from types import CodeType
from typing import TypeAlias

from shpy.ir.nodes import Loc
from shpy.lang.recording.text import Text, text_of

FunctionNode: TypeAlias = ast.FunctionDef | ast.AsyncFunctionDef

_LONGEST = 72


def definition_of(code: CodeType) -> tuple[FunctionNode, Text] | None:
    """Return the `def` that made the code, and its text; None for lambdas, and where no text belongs to the code."""
    text = text_of(code)
    if text is None or text.tree is None:
        return None
    for node in _functions(text).get((code.co_name, code.co_firstlineno), ()):
        if _arguments(node) == code.co_varnames[: len(_arguments(node))]:
            return node, text
    return None


@functools.lru_cache(maxsize=256)
def _functions(text: Text) -> dict[tuple[str, int], list[FunctionNode]]:
    """Return the functions of a file by name and first line, which is that of the first decorator."""
    functions: dict[tuple[str, int], list[FunctionNode]] = {}
    for node in text.statements:
        if isinstance(node, FunctionNode):
            first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            functions.setdefault((node.name, first), []).append(node)
    return functions


def in_one_statement(a: Loc | None, b: Loc | None) -> bool:
    """Return whether two lines are one, or belong to one statement without others in it, such as a call over lines."""
    if a is None or b is None or a == b:
        return a == b
    low, high = sorted((a.line, b.line))
    tree = a.text.tree if a.text is not None and a.text is b.text else None
    return tree is not None and any(
        node.lineno <= low and high <= (node.end_lineno or 0)
        for node in ast.walk(tree)
        if isinstance(node, ast.stmt) and not hasattr(node, "body")
    )


def quoted(text: Text, node: ast.AST) -> str:
    """Return a node of the text as the user wrote it, on one line, shortened if it is long."""
    words = ""
    if isinstance(node, ast.expr | ast.stmt) and node.lineno == node.end_lineno:
        line = text.line(node.lineno).encode()  # columns count bytes
        words = line[node.col_offset : node.end_col_offset].decode(errors="replace")
    words = words or " ".join(ast.unparse(node).split())
    return words if len(words) <= _LONGEST else f"{words[: _LONGEST - 1]}…"


def _arguments(node: FunctionNode) -> tuple[str, ...]:
    arguments = node.args
    return tuple(a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs))
