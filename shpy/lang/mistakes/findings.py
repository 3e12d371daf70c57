"""The sentences for mistakes that the text shows: what is wrong, the line, and what to write instead.

Stage: record. Takes facts about the text; gives the `RecordError` to raise.
"""

from __future__ import annotations

import ast

from shpy.errors import RecordError
from shpy.ir.nodes import Loc
from shpy.lang.mistakes.facts import Block, Change, Fact
from shpy.lang.mistakes.kinds import Kind
from shpy.lang.recording.tree import quoted


def _loc(file: str, node: ast.AST) -> Loc:
    return Loc(file, getattr(node, "lineno", 0))


def _line(node: ast.AST) -> int:
    return int(getattr(node, "lineno", 0))


def rebound(file: str, prefix: str, fact: Fact, block: Block, use: ast.AST, *, next_turn: bool) -> RecordError:
    """Return the error for a name that a block rebinds and that is used after it, or in its loop's next iteration."""
    when = "in its next iteration" if next_turn else "after it"
    if fact.index:
        return RecordError(
            f"`{fact.place}` counts the iterations of `with {block.written}`, and is used after it (line {_line(use)})",
            loc=_loc(file, fact.node),
            cure=f"`last = {prefix}Attrib1i()` before the loop, `last[:] = {fact.place}` inside, `last` after it",
        )
    place = fact.place if fact.place.isidentifier() else quoted(file, use)
    verb = "rebound" if fact.existed or next_turn else "made"
    why = (
        "Python rebinds the name once, while recording, whatever happens at run time"
        if verb == "rebound"
        else "what a block makes ends with it"
    )
    return RecordError(
        f"`{place}` is {verb} inside `with {block.written}` and used {when} (line {_line(use)}): {why}",
        loc=_loc(file, fact.node),
        cure=_store_instead(file, prefix, place, fact),
    )


def _store_instead(file: str, prefix: str, place: str, fact: Fact) -> str:
    """Return the store that the user meant; where there is nothing to store into, how to make it."""
    inside = f"{place}[:] = {quoted(file, fact.value)}" if fact.value is not None else f"{place}[:] = …"
    if isinstance(fact.node, ast.AugAssign):
        inside = quoted(file, fact.node)
    numbers = [f.value for f in fact.before if f.known.kind is Kind.NUMBER and f.value is not None]
    hosts = [f for f in fact.before if f.known.kind is Kind.HOST]
    if fact.existed and numbers:
        start = f"`{place} = {_constructor(prefix, numbers[0], fact)}({quoted(file, numbers[0])})`"
    elif isinstance(fact.node, ast.AugAssign):
        local = place.rpartition(".")[2]  # what is stored into an object would outlive the recording
        start = f"`{local} = {prefix}Attrib1f({place})`"
        inside = inside.replace(place, local)
    elif fact.existed and not hosts:
        return inside
    else:
        start = f"`{place} = {fact.known.type}()`" if fact.known.type else f"make `{place}` a value"
    return f"{start} before the block, `{inside}` inside it"


def _constructor(prefix: str, start: ast.expr, fact: Fact) -> str:
    """Return the type that a host number must get, to become a variable of the program."""
    if fact.known.type:
        return fact.known.type
    numbers = [n.value for n in ast.walk(start) if isinstance(n, ast.Constant)]
    if numbers and all(isinstance(n, bool) for n in numbers):
        return f"{prefix}Attrib1b"
    fractional = fact.known.kind is Kind.VALUE or any(isinstance(n, float) for n in numbers)
    if fact.value is not None:
        fractional |= any(isinstance(n, ast.Constant) and isinstance(n.value, float) for n in ast.walk(fact.value))
    return f"{prefix}Attrib1f" if fractional else f"{prefix}Attrib1i"


def aliased(file: str, fact: Fact, change: Change, reader: str, use: ast.AST, *, next_turn: bool) -> RecordError:
    """Return the error for two names of one value: a store through one changes what the other reads."""
    statement = fact.alias
    assert statement is not None
    when = f"read in the next iteration (line {_line(use)})" if next_turn else f"read after it (line {_line(use)})"
    if isinstance(statement, ast.Assign) and len(statement.targets) > 1:
        *others, last = (ast.unparse(t) for t in statement.targets)
        cure = "; ".join(
            [f"{last} = {quoted(file, statement.value)}", *(f"{other} = {last}.copy()" for other in others)]
        )
    else:
        value = ast.unparse(statement.value)  # type: ignore[attr-defined]
        made = f"{fact.known.type}({value})" if fact.known.type else f"{value}.copy()"
        cure = f"{fact.place} = {made}"
    stored = f"`{quoted(file, change.node)}` (line {_line(change.node)})"
    return RecordError(
        f"`{quoted(file, statement)}` gives one value two names: {stored} changes both, and `{reader}` is {when}",
        loc=_loc(file, statement),
        cure=cure,
    )


def crossed(
    file: str, statement: ast.Assign, name: str, later: ast.expr, swap: tuple[str, str] | None, prefix: str
) -> RecordError:
    """Return the error for `x[:], y[:] = y, x`, which stores one side before it is read for the other."""
    cure = (
        f"copy first, or `{prefix}swap({swap[0]}, {swap[1]})`"
        if swap
        else f"copy first: `old = {name}.copy()`, and `old` for `{name}` on the right"
    )
    return RecordError(
        f"`{quoted(file, statement)}` stores into `{name}` before `{quoted(file, later)}` is stored from it",
        loc=_loc(file, statement),
        cure=cure,
    )


def leaves(file: str, node: ast.AST, block: Block, cure: str) -> RecordError:
    """Return the error for one of Python's own jumps inside a block: it happens while recording."""
    word = {ast.Return: "return", ast.Break: "break", ast.Continue: "continue"}.get(type(node), "yield")
    return RecordError(
        f"Python's `{word}` inside `with {block.written}` happens while recording, whatever the block's condition is",
        loc=_loc(file, node),
        cure=cure,
    )


def without_with(file: str, node: ast.expr, control: str) -> RecordError:
    """Return the error for a block that is called, not entered."""
    return RecordError(
        f"`{quoted(file, node)}` alone does nothing: {control} opens a block",
        loc=_loc(file, node),
        cure=f"with {quoted(file, node)}:",
    )


def without_call(file: str, node: ast.expr, block: bool) -> RecordError:
    """Return the error for `SH_BREAK`, or `with SH_DO:`, without parentheses."""
    name = quoted(file, node)
    return RecordError(
        f"`{name}` is not called",
        loc=_loc(file, node),
        cure=f"with {name}():" if block else f"{name}()",
    )


def until_not_last(file: str, node: ast.stmt, following: ast.stmt) -> RecordError:
    """Return the error for a test that is not the last statement of its loop."""
    return RecordError(
        f"`{quoted(file, node)}` is not the last statement of its SH_DO: line {_line(following)} follows it",
        loc=_loc(file, node),
        cure="move it to the end of the block; `SH_BREAK(c)` leaves a loop in the middle",
    )


def none_compared(file: str, node: ast.Compare) -> RecordError:
    """Return the error for `x == None` on a value."""
    verb = "is" if isinstance(node.ops[0], ast.Eq) else "is not"
    return RecordError(
        f"`{quoted(file, node)}` compares a value with None, component by component",
        loc=_loc(file, node),
        cure=f"{ast.unparse(node.left)} {verb} None",
    )
