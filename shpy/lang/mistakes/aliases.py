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

from shpy.lang.mistakes import findings
from shpy.lang.mistakes.frames import Entry
from shpy.lang.mistakes.listing import Listing, Place, listing_of
from shpy.lang.mistakes.statements import (
    Binding,
    Definition,
    constructor_of,
    is_inside,
    path_of,
    position_of,
    prefix_of,
)
from shpy.lang.recording.location import here, user_frame
from shpy.lang.recording.recorder import Frame
from shpy.lang.recording.symbolic import Symbolic
from shpy.lang.recording.text import Text
from shpy.lang.recording.tree import definition_of, quoted

Path = tuple[str, ...]
"""A name, and the fields of a struct that lead to a value: ("ray", "o")."""


def check_store(recorded: Frame, thing: Any, value: Any = None) -> None:
    """Raise RecordError if the user's running statement stores into a value which another name reads later.

    `thing` is the value or array, and `value` what it gets, where it is stored whole.
    """
    frame = user_frame()
    if frame is None:
        return
    if hasattr(value, "_variable"):
        check_exchange(recorded, [thing], [value])
    listing = listing_of(frame.f_code)
    if listing.text is None or not (listing.aliases or listing.repeats):
        return
    names: Mapping[str, Any] = frame.f_locals
    several = [name for name in listing.aliases if names.get(name) is thing or _is_in(names.get(name), thing)]
    lists = [name for name, x in names.items() if _repeats(x, thing)] if listing.repeats else []
    if several or lists:
        key = (frame.f_lasti, *several, *lists)
        stands = None if key in listing.innocent else definition_of(frame.f_code)
        listing.innocent.add(key)
        if stands is not None:
            store = _Store(Definition(*stands, frame), frame, listing, thing)
            target = store.target()
            if target is not None:
                store.check_repeats(lists, *target)
                entries = [block.entries[0] for block in recorded.blocks if block.loop and block.entries]
                store.check([entry for entry in entries if entry.frame is frame], *target)


def check_exchange(recorded: Frame, things: list[Any], values: list[Any]) -> None:
    """Raise RecordError for `x[:], y[:] = y, x`, or such a line with fields: Python stores from left to right.

    `things` take `values`, of which the same execution of one assignment may have changed some already.
    """
    user, loc = user_frame(), here()
    if user is None or loc is None:
        return
    at, stored = recorded.fields_stored
    if user.f_lasti < at:  # Python has gone back, or into another function
        stored = {}
    for earlier in {stored[v._variable] for v in values if v._variable in stored}:
        for node in _tuples(loc.text).get(loc.line, ()) if loc.text is not None and earlier.text is loc.text else ():
            if node.lineno <= earlier.line:
                _refuse_exchange(loc.text, node, prefix_of(user))
    recorded.fields_stored = user.f_lasti, stored
    stored.update((v._variable, loc) for v in things)


@functools.lru_cache(maxsize=64)
def _tuples(text: Text) -> dict[int, list[ast.Assign]]:
    """Return the assignments of several values to several targets on each line of a text."""
    by_line: dict[int, list[ast.Assign]] = {}
    for node in text.statements:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple | ast.List):
            for line in range(node.lineno, (node.end_lineno or node.lineno) + 1):
                by_line.setdefault(line, []).append(node)
    return by_line


def _refuse_exchange(text: Text, node: ast.Assign, prefix: str) -> None:
    """Raise the error for an assignment of several values to several targets; accept any other."""
    targets, values = node.targets[0], node.value
    if not (isinstance(targets, ast.Tuple | ast.List) and isinstance(values, ast.Tuple | ast.List)):
        return
    names = [ast.unparse(t).removesuffix("[:]") for t in targets.elts]
    pairs = list(zip(names, map(ast.unparse, values.elts), strict=False))
    for first, later in itertools.combinations(range(len(pairs)), 2):
        if pairs[first][0] == pairs[later][1]:
            swap = (pairs[0][0], pairs[1][0]) if len(pairs) == 2 and pairs[0] == pairs[1][::-1] else None
            raise findings.crossed(text, node, pairs[first][0], targets.elts[later], swap, prefix)


def _paths(x: Any, thing: Any, path: Path) -> Iterator[Path]:
    """Yield the paths to a value from what a name holds: the name itself, or fields of a struct."""
    if x is thing:
        yield path
    for field in getattr(type(x), "_shpy_fields", ()) if isinstance(x, Symbolic) else ():
        yield from _paths(vars(x).get(field), thing, (*path, field))


def _is_in(x: Any, thing: Any) -> bool:
    """Return whether a struct has a value among its fields."""
    return hasattr(type(x), "_shpy_fields") and any(True for _ in _paths(x, thing, ()))


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

    def target(self) -> tuple[ast.stmt, ast.expr] | None:
        """Return the assignment that is running, and the target that it stores into."""
        where = self.listing.instructions[self.listing.number_after(self.frame.f_lasti) - 1].positions
        place = (where.lineno, where.col_offset) if where is not None else None
        for node in self.definition.statements:
            if isinstance(node, ast.AugAssign) and position_of(node) == place:
                return node, node.target
            for target in _targets(node) if isinstance(node, ast.Assign) else ():
                if position_of(target) == place:
                    return node, target
        return None

    def check_repeats(self, names: list[str], statement: ast.stmt, target: ast.expr) -> None:
        """Raise RecordError for a store into an item of a list that holds one value several times."""
        for name in names:
            binding = self.bound(name, statement)
            if stored_path(target)[:1] == (name,) and binding is not None and binding.value is not None:
                if any(_repeated(inner) or _has_keys(inner) for inner in ast.walk(binding.value)):
                    cure = _apart(binding.value)
                    raise findings.repeated(self.definition.text, binding.statement, statement, name, cure)

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
                    text, cure = self.definition.text, self.copies(alias)
                    raise findings.aliased(text, alias.statement, statement, name, read[1], cure)

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
        name, written, type_ = ast.unparse(alias.target), ast.unparse(value), self.type_of(value, statement)
        copy = f"{type_}({written})" if type_ else f"{written}.copy()"
        match statement:
            case ast.NamedExpr():
                return f"({name} := {copy})"
            case ast.Assign(targets=[ast.Tuple() | ast.List() as names], value=ast.Tuple() | ast.List() as values):
                left = ", ".join(ast.unparse(n) for n in names.elts)
                return f"{left} = {', '.join(copy if v is value else ast.unparse(v) for v in values.elts)}"
        return f"{name} = {copy}"

    def type_of(self, value: ast.expr, statement: ast.AST) -> str | None:
        """Return the type of a name as the user wrote it, in an annotation or a call of its constructor."""
        if not (isinstance(value, ast.Name) and self.frame.f_locals.get(value.id) is self.thing):
            return None
        binding = self.bound(value.id, statement)
        if binding is None or not hasattr(type(self.thing), "kind"):
            return None
        if isinstance(binding.target, ast.arg):
            hint = binding.target.annotation
            return str(hint.value) if isinstance(hint, ast.Constant) else ast.unparse(hint) if hint else None
        return constructor_of(binding.value, self.frame)


def stored_path(target: ast.expr) -> Path:
    """Return the path to the value that a target stores into or into a part of: ("ray", "o") for `ray.o[0]`."""
    path: list[str] = []
    while isinstance(target, ast.Attribute | ast.Subscript):
        path = [] if isinstance(target, ast.Subscript) else [target.attr, *path]
        target = target.value
    return (target.id, *path) if isinstance(target, ast.Name) else ()


def _targets(node: ast.Assign) -> Iterator[ast.expr]:
    for target in node.targets:
        yield from target.elts if isinstance(target, ast.Tuple | ast.List) else (target,)


def _parts_of(node: ast.Assign) -> Iterator[ast.Attribute | ast.Subscript]:
    """Yield the targets of an assignment that store into an object, which is used and not read."""
    for target in _targets(node):
        while isinstance(target, ast.Attribute | ast.Subscript):
            yield target
            target = target.value


def _contains(node: ast.AST, inner: ast.AST) -> bool:
    return any(n is inner for n in ast.walk(node))


def _branch(choice: ast.AST, node: ast.AST) -> str | None:
    """Return the part of an `if`, a `try` or a `match` in which a node stands; None outside of it."""
    for part in ("body", "orelse", "handlers", "cases", "finalbody", "test"):
        stands = getattr(choice, part, [])
        if any(_contains(n, node) for n in (stands if isinstance(stands, list) else [stands])):
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
