"""The sentences for mistakes that the text or the bytecode shows: what is wrong, the line, and what to write instead.

Stage: record. Takes the place and the words; gives the `RecordError` to raise.
"""

from __future__ import annotations

import ast

from shpy.errors import RecordError
from shpy.ir.nodes import Loc
from shpy.lang.recording.text import Text
from shpy.lang.recording.tree import quoted


def at(text: Text, node: ast.AST) -> Loc:
    """Return the line of a node."""
    return Loc(text.file, line_of(node), text)


def line_of(node: ast.AST) -> int:
    """Return the number of a node's line."""
    return int(getattr(node, "lineno", 0))


def stored(start: str, inside: str, opened: str = "the block") -> str:
    """Return the cure for a name that a block rebinds: a declaration before it, or before its chain, and a store."""
    return f"{start} before {opened}, `{inside}` inside {'it' if opened == 'the block' else 'the block'}"


def stored_each(place: str) -> str:
    """Return the cure for a tuple, list or dict of values that a block rebinds."""
    return f"a name before the block for each value that `{place}` holds, and `x[:] = …` inside it"


def rebound(loc: Loc, place: str, written: str, used: str, cure: str, *, is_new: bool = False) -> RecordError:
    """Return the error for a place that a block rebinds, or makes; `used` says when and on which line it is used."""
    verb = "made" if is_new else "rebound"
    why = "Python rebinds the name once, while recording, whatever happens at run time"
    return RecordError(
        f"`{place}` is {verb} inside `with {written}` and used {used}: "
        f"{'what a block makes ends with it' if is_new else why}",
        loc=loc,
        cure=cure,
    )


def index_used(loc: Loc, place: str, written: str, used: int, prefix: str) -> RecordError:
    """Return the error for a loop's index that is used after the loop, on a line."""
    return RecordError(
        f"`{place}` counts the iterations of `with {written}`, and is used after it (line {used})",
        loc=loc,
        cure=f"`last = {prefix}Attrib1i()` before the loop, `last[:] = {place}` inside, `last` after it",
    )


def aliased(
    text: Text, statement: ast.stmt | ast.NamedExpr, change: ast.stmt, reader: str, when: str, cure: str
) -> RecordError:
    """Return the error for two names of one value: a store through one changes what the other reads."""
    return RecordError(
        f"`{quoted(text, statement)}` gives one value two names: `{quoted(text, change)}` (line {line_of(change)}) "
        f"changes both, and `{reader}` is read {when}",
        loc=at(text, statement),
        cure=cure,
    )


def repeated(text: Text, display: ast.AST, change: ast.stmt, name: str, cure: str) -> RecordError:
    """Return the error for a store into an item of a list that holds one value several times."""
    return RecordError(
        f"`{quoted(text, display)}` holds one value several times: `{quoted(text, change)}` (line {line_of(change)}) "
        "changes all of them",
        loc=at(text, display),
        cure=f"{name} = {cure}",
    )


def crossed(
    text: Text, statement: ast.Assign, name: str, later: ast.expr, swap: tuple[str, str] | None, prefix: str
) -> RecordError:
    """Return the error for `x[:], y[:] = y, x`, which stores one side before it is read for the other."""
    cure = (
        f"copy first, or `{prefix}swap({swap[0]}, {swap[1]})`"
        if swap
        else f"copy first: `old = {name}.copy()`, and `old` for `{name}` on the right"
    )
    return RecordError(
        f"`{quoted(text, statement)}` stores into `{name}` before `{quoted(text, later)}` is stored from it",
        loc=at(text, statement),
        cure=cure,
    )


def leaves(loc: Loc | None, word: str, written: str, cure: str) -> RecordError:
    """Return the error for one of Python's own jumps inside a block: it happens while recording."""
    return RecordError(
        f"Python's `{word}` inside `with {written}` happens while recording, whatever the block's condition is",
        loc=loc,
        cure=cure,
    )


def without_with(text: Text, node: ast.expr, control: str) -> RecordError:
    """Return the error for a block that is called, not entered."""
    return RecordError(
        f"`{quoted(text, node)}` alone does nothing: {control} opens a block",
        loc=at(text, node),
        cure=f"with {quoted(text, node)}:",
    )


def without_call(text: Text, node: ast.expr, block: bool) -> RecordError:
    """Return the error for `SH_BREAK`, or `with SH_DO:`, without parentheses."""
    name = quoted(text, node)
    return RecordError(f"`{name}` is not called", loc=at(text, node), cure=f"with {name}():" if block else f"{name}()")


def none_compared(text: Text, node: ast.Compare, value: ast.expr) -> RecordError:
    """Return the error for `x == None`, or `None == x`, on a value."""
    verb = "is" if isinstance(node.ops[0], ast.Eq) else "is not"
    return RecordError(
        f"`{quoted(text, node)}` compares a value with None, component by component",
        loc=at(text, node),
        cure=f"{ast.unparse(value)} {verb} None",
    )
