"""The state at one point of a function's text: which assignments each name may come from.

Stage: record. `Flow` (flow.py) walks the statements in order and keeps a `State`; each `Fact` is one assignment that
reaches here. Recording runs the body of a block once, straight through, while the user means it to run sometimes or
many times: what a block leaves behind in a name is therefore marked as *escaped* when the block ends.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import TypeAlias

from shpy.lang.mistakes import findings
from shpy.lang.mistakes.kinds import Kind, Known
from shpy.lang.recording.text import Text
from shpy.lang.recording.tree import quoted

NO_OBJECT = 0


@dataclass(eq=False, slots=True)
class Block:
    """A `with SH_…` that is open, or (`control` None) a loop of Python."""

    control: str | None
    written: str
    line: int
    start: int = 0
    exposed: list[Use] = field(default_factory=list)

    @property
    def is_loop(self) -> bool:
        """Return whether the body is meant to run many times."""
        return self.control in (None, "SH_WHILE", "SH_DO", "SH_FOR")


@dataclass(eq=False, slots=True)
class Fact:
    """One assignment of a place: where, when (in the order of the text), of what kind, and to which object."""

    place: str
    node: ast.AST
    when: int
    inference: Known
    object: int
    before: tuple[Fact, ...] = ()
    existed: bool = False  # it had a meaning before, outside all blocks that are closed
    value: ast.expr | None = None
    alias: ast.stmt | ast.NamedExpr | None = None
    index: bool = False
    escaped: Block | None = None
    repeats: int = 0  # indices to a value that stands several times in a list, see repeats.py

    def origins(self) -> tuple[Fact, ...]:
        """Return the assignments that stand before the blocks that are closed."""
        return tuple(o for f in self.before for o in ((f,) if f.escaped is None else f.origins()))

    def suspicious(self, *others: Fact) -> bool:
        """Return whether it matters that the block may not run, or runs again: not for strings, sets and the like.

        It does for a tuple, list or dict with values. `others` are further assignments that the place may have had
        before.
        """
        if self.index or self.inference.kind is Kind.VALUE:
            return True
        before = (*self.before, *others)
        if not before and not self.existed:
            return False  # made here first, and not certainly a value: the recorder will know
        if self.inference.kind is not Kind.HOST or self.inference.holds:
            return True
        return any(f.inference.kind in (Kind.VALUE, Kind.NUMBER) or f.inference.holds for f in before)


@dataclass(frozen=True, slots=True)
class Use:
    """A place that is read where no assignment inside the loop has reached it: it is older, or the last iteration's."""

    place: str
    node: ast.AST
    fact: Fact | None
    reads: bool
    asks_none: bool


@dataclass(frozen=True, slots=True)
class Change:
    """A store into an object, through one of its names."""

    place: str
    node: ast.stmt
    when: int
    fact: Fact


State: TypeAlias = "dict[str, tuple[Fact, ...]]"
"""The assignments that reach a point, by place: a name, or a path as it is written (`self.k`, `d['k']`)."""


def joined(start: State, ends: list[State], when: int) -> State:
    """Return the state where Python's branches, or a loop's exits, join.

    If any branch assigned a place, it has the assignments of those branches only, as if the others were never taken.
    Python's `if` is decided once, while recording, and correlated conditions must not look like mistakes. Aliases
    that only some branches made are dropped, since it is legitimate to choose a variable that way.
    """
    facts = dict(start)
    for place in dict.fromkeys(p for end in ends for p in end):
        new: list[Fact] = []
        for end in ends:
            for fact in end.get(place, ()):
                if fact.when >= when and fact not in new:
                    if fact.alias is not None:
                        fact.alias, fact.object = None, NO_OBJECT
                    new.append(fact)
        if new:
            facts[place] = tuple(new)
    return facts


# Cures


def store_instead(text: Text, prefix: str, place: str, fact: Fact, block: Block) -> str:
    """Return the cure for a rebinding: the store `x[:] = …` that the user meant.

    If the name held no value before the block, the cure also makes one.
    """
    if fact.inference.kind is Kind.HOST and any(f.inference.holds for f in (fact, *fact.before)):
        return findings.stored_each(place)
    inside = f"{place}[:] = {quoted(text, fact.value)}" if fact.value is not None else f"{place}[:] = …"
    if isinstance(fact.node, ast.AugAssign):
        inside = quoted(text, fact.node)
    before = (*fact.before, *fact.origins())
    numbers = [f.value for f in before if f.inference.kind is Kind.NUMBER and f.value is not None]
    hosts = [f for f in before if f.inference.kind is Kind.HOST]
    if fact.existed and numbers:
        start = f"`{place} = {_constructor(prefix, numbers[0], fact)}({quoted(text, numbers[0])})`"
    elif isinstance(fact.node, ast.AugAssign):
        local = place.rpartition(".")[2]  # what is stored into an object would outlive the recording
        start = f"`{local} = {prefix}Attrib1f({place})`"
        inside = inside.replace(place, local)
    elif fact.existed and not hosts:
        return inside
    else:
        start = f"`{place} = {fact.inference.type}()`" if fact.inference.type else f"make `{place}` a value"
    return findings.stored(start, inside, "the SH_IF" if block.control in ("SH_ELIF", "SH_ELSE") else "the block")


def _constructor(prefix: str, start: ast.expr, fact: Fact) -> str:
    """Return the type that a host number must get, to become a variable of the program."""
    if fact.inference.type:
        return fact.inference.type
    numbers = [n.value for n in ast.walk(start) if isinstance(n, ast.Constant)]
    if numbers and all(isinstance(n, bool) for n in numbers):
        return f"{prefix}Attrib1b"
    called = [n.func for n in ast.walk(start) if isinstance(n, ast.Call)]
    floats = any("float" in ast.unparse(f) for f in called)  # float(n), np.float32(n)
    fractional = fact.inference.kind is Kind.VALUE or floats or any(isinstance(n, float) for n in numbers)
    if fact.value is not None:
        fractional |= any(isinstance(n, ast.Constant) and isinstance(n.value, float) for n in ast.walk(fact.value))
    return f"{prefix}Attrib1f" if fractional else f"{prefix}Attrib1i"


def copy_instead(text: Text, fact: Fact) -> str:
    """Return the assignments that give each name of an alias a value of its own."""
    statement = fact.alias
    if isinstance(statement, ast.Assign) and len(statement.targets) > 1:
        *others, last = (ast.unparse(t) for t in statement.targets)
        copies = [f"{other} = {last}.copy()" for other in others]
        return "; ".join([f"{last} = {quoted(text, statement.value)}", *copies])
    assert fact.value is not None
    value = ast.unparse(fact.value)
    copy = f"{fact.inference.type}({value})" if fact.inference.type else f"{value}.copy()"
    match statement:
        case ast.NamedExpr():
            return f"({fact.place} := {copy})"
        case ast.Assign(targets=[ast.Tuple() | ast.List() as names], value=ast.Tuple() | ast.List() as values):
            left = ", ".join(ast.unparse(name) for name in names.elts)
            right = ", ".join(copy if v is fact.value else ast.unparse(v) for v in values.elts)
            return f"{left} = {right}"
    return f"{fact.place} = {copy}"
