"""Find two names of one value at a store: through one of them the value changes, and the other is read later.

Stage: record, at each store of the user's. Most functions bind no name to an object that has another name, which their
bytecode shows, so nothing more is done there. Else the locals of the frame tell which names the value has; the text is
read only when there are several, to find the statement that made them.

    old = x
    x += d                  # RecordError: `old = x` gives one value two names …
    return x - old
"""

from __future__ import annotations

import ast
import functools
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import FrameType
from typing import Any

from shpy.errors import RecordError
from shpy.ir.nodes import Loc
from shpy.lang.mistakes.expressions import prefix_of
from shpy.lang.mistakes.frames import Entry
from shpy.lang.mistakes.listing import Listing, Place, listing_of
from shpy.lang.mistakes.statements import (
    Binding,
    Definition,
    is_inside,
    path_of,
    position_of,
)
from shpy.lang.recording.location import loc_in, user_frame
from shpy.lang.recording.recorder import Frame
from shpy.lang.recording.symbolic import Symbolic
from shpy.lang.recording.text import Text
from shpy.lang.recording.tree import quoted

Path = tuple[str, ...]
"""A name, and the fields of a struct that lead to a value: ("ray", "o")."""


def check_store(recorded: Frame, thing: Any, value: Any = None) -> None:
    """Raise RecordError if the user's running statement stores into a value which another name reads later.

    `thing` is the value or array, and `value` the operand of a store into the whole of it.
    """
    frame = user_frame()
    if frame is None:
        return
    listing = listing_of(frame.f_code)
    if listing.text is None:
        return
    if hasattr(value, "_variable"):
        for assignment in _of_several(listing.text).get(frame.f_lineno, ()):
            _check_exchange(assignment, listing, frame)
    if not (listing.aliases or listing.repeats):
        return
    names: Mapping[str, Any] = frame.f_locals
    several = [name for name in listing.aliases if next(_paths(names.get(name), thing, (name,)), None)]
    lists = [name for name, x in names.items() if _repeats(x, thing)] if listing.repeats else []
    if several or lists:
        key = (frame.f_lasti, *several, *lists)
        if key not in listing.innocent:
            definition = Definition.around(loc_in(frame.f_code, frame.f_lineno), frame)
            store = _Store(definition, frame, listing, thing)
            for statement, target in store.targets():
                store.check_repeats(lists, statement, target)
                entries = [block.entries[0] for block in recorded.blocks if block.loop and block.entries]
                store.check([entry for entry in entries if entry.frame is frame], statement, target)
        listing.innocent.add(key)


@functools.lru_cache(maxsize=64)
def _of_several(text: Text) -> dict[int, list[ast.Assign]]:
    """Return the assignments of several values to several targets on each line of a text."""
    by_line: dict[int, list[ast.Assign]] = {}
    for node in text.statements:
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Tuple)
            and isinstance(node.value, ast.Tuple)
        ):
            for line in range(node.lineno, (node.end_lineno or node.lineno) + 1):
                by_line.setdefault(line, []).append(node)
    return by_line


def _check_exchange(node: Any, listing: Listing, frame: FrameType) -> None:
    """Raise RecordError for `x[:], y[:] = y, x`, or such a line with fields: Python stores from left to right."""
    names = [ast.unparse(target).removesuffix("[:]") for target in node.targets[0].elts]
    pairs = list(zip(names, map(ast.unparse, node.value.elts), strict=False))
    running = [k for k, t in enumerate(node.targets[0].elts) if position_of(t) == listing.position_at(frame.f_lasti)]
    for later in running:
        for name, _ in pairs[:later]:
            if later < len(pairs) and name == pairs[later][1]:
                text, target = listing.text, node.targets[0].elts[later]
                assert text is not None
                cure = f"copy first: `old = {name}.copy()`, and `old` for `{name}` on the right"
                if len(pairs) == 2 and pairs[0] == pairs[1][::-1]:
                    cure = f"copy first, or `{prefix_of(frame)}swap({', '.join(names)})`"
                message = (
                    f"`{quoted(text, node)}` stores into `{name}` before `{quoted(text, target)}` is stored from it"
                )
                raise RecordError(message, loc=Loc(text.file, node.lineno, text), cure=cure)


def _paths(x: Any, thing: Any, path: Path) -> Iterator[Path]:
    """Yield the paths to a value from what a name holds: the name itself, or fields of a struct."""
    if x is thing:
        yield path
    for field in getattr(type(x), "_shpy_fields", ()) if isinstance(x, Symbolic) else ():
        yield from _paths(vars(x).get(field), thing, (*path, field))


def _repeats(x: Any, thing: Any) -> bool:
    """Return whether a list or dict, or a list in it, holds a value several times."""
    parts = x.values() if type(x) is dict else x if type(x) is list else ()
    return sum(part is thing for part in parts) > 1 or any(type(p) is list and _repeats(p, thing) for p in parts)


@dataclass(frozen=True)
class _Store:
    """The store that a frame is executing: where it stands, and the value or array that it changes."""

    definition: Definition
    frame: FrameType
    listing: Listing
    thing: Any

    def targets(self) -> Iterator[tuple[ast.stmt, ast.expr]]:
        """Yield the assignment that is running, and the target that it stores into; nothing for another statement."""
        place = self.listing.position_at(self.frame.f_lasti)
        for node in self.definition.statements:
            if isinstance(node, ast.Assign | ast.AugAssign):
                yield from ((node, target) for target in _targets(node) if position_of(target) == place)

    def check_repeats(self, names: list[str], statement: ast.stmt, target: ast.expr) -> None:
        """Raise RecordError for a store into an item of a list that holds one value several times."""
        for name in names:
            binding = self.bound(name, statement)
            if stored_path(target)[:1] == (name,) and binding is not None and binding.value is not None:
                if any(_repeated(inner) or _has_keys(inner) for inner in ast.walk(binding.value)):
                    display, store = (quoted(self.definition.text, n) for n in (binding.statement, statement))
                    raise RecordError(
                        f"`{display}` holds one value several times: `{store}` (line {statement.lineno}) changes all "
                        "of them",
                        loc=self.definition.at(binding.statement),
                        cure=f"{name} = {_apart(binding.value)}",
                    )

    def check(self, loops: list[Entry], statement: ast.stmt, target: ast.expr) -> None:
        """Raise RecordError if the value is read later under another name than that which it is stored through."""
        names, written = self.frame.f_locals, stored_path(target)
        inside = [path for path in _paths(names.get(written[0]), self.thing, written[:1])] if written else []
        through = next((path for path in inside if path[: len(written)] == written[: len(path)]), None)
        if through is None:
            return
        readers = [path for name in list(names) for path in _paths(names[name], self.thing, (name,))]
        for reader in readers:
            end = 1 if names[reader[0]] is names[through[0]] else None  # two names of one struct
            paths = [path[0] for path in (through[:end], reader[:end]) if len(path) == 1]
            bound = [b for name in paths if (b := self.bound(name, statement)) and self.is_alias(b, statement)]
            # Python gives names one value in other ways, too, as in `for v in (x, y)`.
            if reader[0] != through[0] and bound and self.origin(through, statement) == self.origin(reader, statement):
                if read := self.read(reader, loops, statement):
                    alias, name = max(bound, key=lambda b: position_of(b.target)), ".".join(read[0][:end])
                    both, store = (quoted(self.definition.text, n) for n in (alias.statement, statement))
                    raise RecordError(
                        f"`{both}` gives one value two names: `{store}` (line {statement.lineno}) changes both, and "
                        f"`{name}` is read {read[1]}",
                        loc=self.definition.at(alias.statement),
                        cure=self.copies(alias),
                    )

    def bound(self, name: str, node: ast.AST) -> Binding | None:
        """Return the last binding of a name before a node."""
        stands = [b for b in self.definition.bindings if path_of(b.target) == (name,)]
        return next((b for b in reversed(stands) if position_of(b.target) < position_of(node)), None)

    def is_alias(self, binding: Binding, store: ast.AST) -> bool:
        """Return whether a binding names an object that has a name, and is no choice of Python's.

        What an unannotated parameter holds is the caller's affair.
        """
        source = path_of(binding.value)
        if binding.grows or not (source or binding.shares):
            return False
        origin = self.bound(source[0], store) if source else None
        if source and (origin is None or (isinstance(origin.target, ast.arg) and not origin.target.annotation)):
            return False
        choices = [n for n in self.definition.statements if isinstance(n, ast.If | ast.Try | ast.TryStar | ast.Match)]
        return all(_branch(n, binding.statement) in (None, _branch(n, store)) for n in choices)

    def origin(self, path: Path, node: ast.AST) -> Path:
        """Return the path from which the aliases before a node have come."""
        alias = self.bound(path[0], node)
        if alias is None or not self.is_alias(alias, node):
            return path
        if alias.shares:
            return (f"line {alias.target.lineno}", *path[1:])
        return self.origin((*path_of(alias.value), *path[1:]), alias.statement)

    def read(self, reader: Path, loops: list[Entry], statement: ast.stmt) -> tuple[Path, str] | None:
        """Return what is read of a path after the store, all of it or the whole struct, and when; None if nothing."""
        assigned = [n for n in self.definition.statements if isinstance(n, ast.Assign)]
        bases = {position_of(t.value) for n in assigned for t in _parts_of(n)}
        others, place = self.other_branches(statement), Place(reader[0])

        def effect(k: int) -> str | None:
            happens, where = self.listing.effect_on(k, place), self.listing.instructions[k].positions
            if happens != "LOAD" or where is None or where.lineno is None:
                return happens
            if (where.lineno, where.col_offset) in bases or any(where.lineno in lines for lines in others):
                return None
            return happens if self.path_at(k, reader) else None

        here = self.frame.f_lasti
        for start, when in ((here, "after it"), *((e.offset, "in the next iteration") for e in loops)):
            use = self.listing.first_read(start, place, effect)
            if use is not None and (start == here or use[0] <= here):
                return self.path_at(self.listing.numbers[use[0]], reader), f"{when} (line {use[1]})"
        return None

    def path_at(self, k: int, reader: Path) -> Path:
        """Return the part of a path that the instructions from a number on read; () where they read another field."""
        for count, field in enumerate(reader[1:], 1):
            after = self.listing.instructions[k + count]
            if after.opname not in ("LOAD_ATTR", "LOAD_METHOD"):
                return reader[:count]
            if after.argval != field:
                return ()
        return reader

    def other_branches(self, statement: ast.stmt) -> list[range]:
        """Return the lines of the branches of SH_IF that are not executed where this store is."""
        ranges: list[range] = []
        blocks = self.definition.blocks
        for k, block in enumerate(blocks):
            if is_inside(statement, block.node):
                column = block.node.col_offset
                rest = (b for b in blocks[k + 1 :] if b.node.col_offset <= column)
                for other in itertools.takewhile(lambda b: b.what in ("SH_ELIF", "SH_ELSE"), rest):
                    ranges.append(range(other.node.lineno, (other.node.end_lineno or 0) + 1))
        return ranges

    def copies(self, alias: Binding) -> str:
        """Return the assignments that give each name of an alias a value of its own."""
        statement, value = alias.statement, alias.value
        if alias.shares:
            *others, last = (ast.unparse(t) for t in statement.targets)
            copies = [f"{other} = {last}.copy()" for other in others]
            return "; ".join([f"{last} = {quoted(self.definition.text, statement.value)}", *copies])
        assert value is not None
        name, copy = ast.unparse(alias.target), f"{ast.unparse(value)}.copy()"
        match statement:
            case ast.NamedExpr():
                return f"({name} := {copy})"
            case ast.Assign(targets=[ast.Tuple() | ast.List() as names], value=ast.Tuple() | ast.List() as values):
                left = ", ".join(ast.unparse(n) for n in names.elts)
                return f"{left} = {', '.join(copy if v is value else ast.unparse(v) for v in values.elts)}"
        return f"{name} = {copy}"


def stored_path(target: ast.expr) -> Path:
    """Return the path to the value that a target stores into or into a part of: ("ray", "o") for `ray.o[0]`."""
    path: list[str] = []
    while isinstance(target, ast.Attribute | ast.Subscript):
        path = [] if isinstance(target, ast.Subscript) else [target.attr, *path]
        target = target.value
    return (target.id, *path) if isinstance(target, ast.Name) else ()


def _targets(node: ast.Assign | ast.AugAssign) -> Iterator[ast.expr]:
    for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
        yield from target.elts if isinstance(target, ast.Tuple | ast.List) else (target,)


def _parts_of(node: ast.Assign) -> Iterator[ast.Attribute | ast.Subscript]:
    """Yield the targets of an assignment that store into an object, which is used and not read."""
    for target in _targets(node):
        while isinstance(target, ast.Attribute | ast.Subscript):
            yield target
            target = target.value


def _branch(choice: ast.AST, node: ast.AST) -> str | None:
    """Return the part of an `if`, a `try` or a `match` in which a node stands; None outside of it."""
    for part in ("body", "orelse", "handlers", "cases", "finalbody"):
        if any(inner is node for n in getattr(choice, part, ()) for inner in ast.walk(n)):
            return part
    return None


def _has_keys(node: ast.AST) -> bool:
    """Return whether an expression is `dict.fromkeys(keys, value)`."""
    return isinstance(node, ast.Call) and ast.unparse(node.func) == "dict.fromkeys" and len(node.args) == 2


def _repeated(node: ast.AST) -> tuple[ast.expr, ast.expr] | None:
    """Return the item and the number of `[x] * 3` or `3 * [x]`."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        for items, times in ((node.left, node.right), (node.right, node.left)):
            if isinstance(items, ast.List | ast.Tuple) and len(items.elts) == 1:
                return items.elts[0], times
    return None


def _apart(node: ast.expr) -> str:
    """Return the text that makes each item by itself: `[sh.Attrib1f(0) for _ in range(3)]`."""
    if pair := _repeated(node):
        return f"[{_apart(pair[0])} for _ in range({ast.unparse(pair[1])})]"
    match node:
        case ast.Call(args=[keys, value]) if _has_keys(node):
            return f"{{key: {_apart(value)} for key in {ast.unparse(keys)}}}"
        case ast.List(elts=parts):
            return f"[{', '.join(_apart(part) for part in parts)}]"
        case ast.ListComp():
            return ast.unparse(node).replace(ast.unparse(node.elt), _apart(node.elt), 1)
        case ast.Name() | ast.Attribute() | ast.Subscript():
            return f"{ast.unparse(node)}.copy()"
    return ast.unparse(node)
