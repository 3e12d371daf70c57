"""The output tree as text, for `SHPY_DUMP=tree`: a line for each statement, its expressions in prefix notation.

Stage: emit. No text of a target is made of it. An expression ends with the type that the target computes.

>>> from shpy.ir.types import vec
>>> x = tree.Name(vec("f"), "x")
>>> print(tree_text(tree.If(tree.infix(">", x, tree.number(1), tree.BOOL), (tree.Exit("break"),))))
if condition=(operator > x 1):b
  then
    exit word=break
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from shpy.backend.emit import tree
from shpy.backend.emit.tree import Expr


def tree_text(node: tree.Function | tree.Stmt) -> str:
    """Return the lines of a function or a statement. Parts that are empty and the user's lines are left out."""
    return "\n".join(_lines(node, ""))


def _lines(node: Any, indent: str) -> Iterator[str]:
    words, nested = [type(node).__name__.lower()], []
    for field in fields(node):
        value = getattr(node, field.name)
        if field.name.endswith("loc") or value is None or value in ("", ()):
            continue
        if isinstance(value, tree.Assign):  # the step of a loop
            nested.append((field.name, (value,)))
        elif isinstance(value, tuple) and field.name != "qualifiers":
            nested.append((field.name, value))
        else:
            words.append(f"{field.name}={_expression(value) if isinstance(value, Expr) else value}")
    yield indent + " ".join(words)
    for name, nodes in nested:
        yield f"{indent}  {name}"
        for inner in nodes:
            yield from _lines(inner, f"{indent}    ")


def _expression(e: Expr) -> str:
    match e:
        case tree.Name():
            return e.text
        case tree.Literal():
            return repr(e.value)
    own = [str(v) for v in (getattr(e, f.name) for f in fields(e)) if isinstance(v, str | int | tree.Own)]
    return f"({' '.join([type(e).__name__.lower(), *own, *map(_expression, e.parts)])}):{e.type!r}"
