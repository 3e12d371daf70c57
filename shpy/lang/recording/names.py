"""The names that the user gives to values: which variable does a source line assign?

Stage: record. Takes the line that is running; gives the name that its result is about to get, so that the IR and the
emitted text read like the user's program.

    12: z = sh.Attrib2f(0, 0)           # name_for(loc) == "z"
    13: z[:] = z + c                    # name_for(loc) is None: a store, not a name
    14: with SH_FOR(0, 8) as i:         # for_name(loc) == "i"
    15: a, b = x + 1, sh.sqrt(x)        # unpacked_name(loc) == "b" while the root is taken
"""

from __future__ import annotations

import ast
import dis
import re
from dataclasses import dataclass, field
from functools import lru_cache
from types import CodeType, FrameType
from typing import Any

from shpy.ir.nodes import Loc
from shpy.lang.recording.location import here, user_frame
from shpy.lang.recording.text import Text, text_of


@dataclass(slots=True)
class Naming:
    """The names that one file binds, by line: the targets of assignments and of `with … as`."""

    text: Text
    assigned: dict[int, str | None] = field(default_factory=dict)
    unpacked: dict[int, list[tuple[ast.expr, str]]] = field(default_factory=dict)
    bound: dict[int, str | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for node in self.text.statements:
            if isinstance(node, ast.Assign | ast.AnnAssign):
                _enter(self.assigned, node, _target(node))
                for expression, name in _pairs(node):
                    for line in range(node.lineno, (node.end_lineno or node.lineno) + 1):
                        self.unpacked.setdefault(line, []).append((expression, name))
            elif isinstance(node, ast.With | ast.AsyncWith):
                for item in node.items:
                    if isinstance(item.optional_vars, ast.Name):
                        _enter(self.bound, item.context_expr, item.optional_vars.id)


def _target(node: ast.Assign | ast.AnnAssign) -> str | None:
    """Return the plain name that is assigned: the first of `a = b = …`; None for tuples, items and attributes."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return next((t.id for t in targets if isinstance(t, ast.Name)), None)


def _pairs(node: ast.Assign | ast.AnnAssign) -> list[tuple[ast.expr, str]]:
    """Return the expressions and names of `a, b = x + 1, y`."""
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    if not (isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)):
        return []
    if len(target.elts) != len(node.value.elts):
        return []
    return [(e, t.id) for e, t in zip(node.value.elts, target.elts, strict=True) if isinstance(t, ast.Name)]


def _enter(names: dict[int, str | None], node: ast.stmt | ast.expr, name: str | None) -> None:
    """Give every line of the node the name; a line that two names share gets none."""
    for line in range(node.lineno, (node.end_lineno or node.lineno) + 1):
        names[line] = name if names.get(line, name) == name else None


@lru_cache(maxsize=256)
def _naming(text: Text) -> Naming | None:
    return Naming(text) if text.tree is not None else None


def _naming_at(loc: Loc | None) -> Naming | None:
    return _naming(loc.text) if loc is not None and loc.text is not None else None


def name_for(loc: Loc | None) -> str | None:
    """Return the variable that the assignment on this line binds, or None."""
    naming = _naming_at(loc)
    return naming.assigned.get(loc.line) if loc is not None and naming is not None else None


def assigned_name() -> str | None:
    """Return the variable that the user's running line binds, or None.

    Where no text belongs to the code, its bytecode tells: the variable that receives the running expression.
    """
    loc = here()
    if loc is None or loc.text is not None:
        return name_for(loc)
    frame = user_frame()
    return stored_name(frame) if frame is not None and frame.f_lineno == loc.line else None


def stored_name(frame: FrameType) -> str | None:
    """Return the variable that the bytecode binds to the result of what a frame is computing, or None."""
    for instruction in _instructions(frame.f_code):
        if instruction.offset <= frame.f_lasti:
            continue
        if instruction.opname in ("STORE_NAME", "STORE_FAST", "STORE_GLOBAL", "STORE_DEREF"):
            return str(instruction.argval)
        if _ENDS.match(instruction.opname):
            return None
    return None


_ENDS = re.compile(
    r"STORE_|UNPACK_|SWAP|POP_TOP|RETURN_|YIELD_|RAISE_|BEFORE_WITH|LOAD_SPECIAL|GET_ITER|FOR_ITER|.*JUMP"
)
"""Instructions at which the running expression is no longer the one that an assignment stores."""


@lru_cache(maxsize=64)
def _instructions(code: CodeType) -> tuple[dis.Instruction, ...]:
    return tuple(dis.get_instructions(code))


_listed: tuple[tuple[CodeType, list[Any]], ...] = ()
"""The places of instructions of the latest functions, which are compared by identity: code hashes its whole text."""


def _positions(code: CodeType) -> list[Any]:
    """Return where each instruction stands in the text: walked once a function, not once a value."""
    global _listed
    for key, positions in _listed:
        if key is code:
            return positions
    listing = list(code.co_positions())
    _listed = ((code, listing), *_listed[:7])  # in one assignment, since other threads record meanwhile
    return listing


def unpacked_name(loc: Loc) -> str | None:
    """Return the name that an assignment on a line, such as `a, b = x + 1, y`, gives the expression that is running."""
    naming = _naming_at(loc)
    if naming is None or loc.line not in naming.unpacked:
        return None
    frame = user_frame()
    if frame is None or frame.f_lineno != loc.line or text_of(frame.f_code) is not loc.text:
        return None
    positions = _positions(frame.f_code)[frame.f_lasti // 2]
    if None in positions:
        return None
    line, _, column, _ = positions
    for e, name in naming.unpacked[loc.line]:
        if (e.lineno, e.col_offset) <= (line, column) < (e.end_lineno, e.end_col_offset):
            return name
    return None


def for_name(loc: Loc | None) -> str | None:
    """Return the name that `with SH_FOR(…) as name` on this line binds, or None."""
    naming = _naming_at(loc)
    return naming.bound.get(loc.line) if loc is not None and naming is not None else None
