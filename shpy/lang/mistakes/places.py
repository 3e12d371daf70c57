"""Reaching definitions of the places in a function's text, at each point of a walk: names, items and attributes.

Stage: record. Keeps the state that statements change; raises when a place is used that a closed block has rebound, or
when a value is read that was changed through another name.
"""

from __future__ import annotations

import ast
import heapq
import re
from bisect import bisect_left
from collections.abc import Iterator, Set
from contextlib import contextmanager
from operator import attrgetter

from shpy.errors import RecordError
from shpy.lang.mistakes import findings
from shpy.lang.mistakes.facts import NO_OBJECT, Block, Change, Fact, State, Use, copy_instead, store_instead
from shpy.lang.mistakes.kinds import Judge, Kind, Known
from shpy.lang.mistakes.repeats import apart, store_depth
from shpy.lang.recording.scope import Scope
from shpy.lang.recording.tree import quoted


class Places:
    """The state of one function's walk: where each place comes from, and which blocks are open."""

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        self.state: State = {}
        self.open: list[Block] = []
        self.changes: dict[int, dict[str, list[Change]]] = {}
        self._facts: list[Fact] = []
        self._paths: dict[str, set[str]] = {}
        self.fields: dict[tuple[int, str], int] = {}
        self.judge = Judge(scope, self._inference_of)
        self.hidden: list[Set[str]] = []
        self.asking_none = False
        self._clock = 0
        self._objects = NO_OBJECT
        self._first_branch: dict[int, int] = {}
        self._other_branches: list[range] = []

    def tick(self) -> int:
        """Return the next moment in the order of the text."""
        self._clock += 1
        return self._clock

    def new_object(self) -> int:
        """Return an object that no name has yet."""
        self._objects += 1
        return self._objects

    def single(self, place: str) -> Fact | None:
        """Return the assignment that a place comes from, if there is just one."""
        facts = self.state.get(place, ())
        return facts[0] if len(facts) == 1 else None

    def object_of(self, value: ast.expr | None) -> int:
        """Return the object that an expression gives, if it names a value or a field of a struct; else `NO_OBJECT`."""
        if isinstance(value, ast.Attribute) and self.judge.field(value) is not None:
            owner = self.object_of(value.value)
            return NO_OBJECT if owner == NO_OBJECT else self.fields.setdefault((owner, value.attr), self.new_object())
        if not isinstance(value, ast.Name) or self.judge.kind(value).kind is not Kind.VALUE:
            return NO_OBJECT
        fact = self.single(value.id)
        return fact.object if fact is not None else NO_OBJECT

    def _inference_of(self, place: str) -> Known | None:
        if any(place in hidden for hidden in self.hidden):
            return Known(Kind.UNKNOWN)
        facts = self.state.get(place)
        if not facts:
            return None
        kinds = {f.inference.kind for f in facts}
        if len(kinds) > 1:
            return Known(Kind.UNKNOWN)
        return facts[0].inference if len(facts) == 1 else Known(kinds.pop())

    def bind_name(
        self,
        name: str,
        node: ast.stmt | ast.NamedExpr | ast.arg | ast.pattern,
        inference: Known,
        *,
        value: ast.expr | None = None,
        index: bool = False,
        shared: int = NO_OBJECT,
    ) -> Fact:
        """Bind a name, and forget its items and attributes. `shared` is the object, if it has another name already."""
        for place in self._paths.get(name, ()):
            self.state.pop(place, None)
        fact = self.bind_path(name, node, inference, value=value, index=index)
        if shared != NO_OBJECT:
            assert isinstance(node, ast.stmt | ast.NamedExpr)
            fact.object, fact.alias = shared, node
        return fact

    def bind_path(
        self,
        place: str,
        node: ast.AST,
        inference: Known,
        *,
        value: ast.expr | None = None,
        existed: bool = False,
        index: bool = False,
    ) -> Fact:
        """Bind a place: from here on it comes from this assignment."""
        before = self.state.get(place, ())
        existed = existed or any(f.escaped is None or f.existed for f in before)
        fact = Fact(place, node, self.tick(), inference, self.new_object(), before, existed, value, index=index)
        self.state[place] = (fact,)
        self._facts.append(fact)
        if not place.isidentifier():
            self._paths.setdefault(re.split(r"[.\[]", place, maxsplit=1)[0], set()).add(place)
        return fact

    def leave(self, block: Block) -> None:
        """Mark the assignments that a block which ends has made, and that reach its end, as escaped."""
        for fact in self._facts[bisect_left(self._facts, block.start, key=attrgetter("when")) :]:
            if fact.escaped is None and fact in self.state.get(fact.place, ()):
                fact.escaped = block

    def change(self, target: ast.expr, root: str, node: ast.stmt) -> None:
        """Note a store into the value of a name, or a part of it."""
        fact = self.single(root)
        if fact is None:
            return
        holders = [target]
        while isinstance(holders[-1], ast.Attribute | ast.Subscript):
            holders.append(holders[-1].value)
        objects = {self.object_of(holder): ast.unparse(holder) for holder in holders}
        objects.pop(NO_OBJECT, None)
        stored = next(iter(objects), NO_OBJECT)  # all its fields change, and one field of each that holds it
        inside = [thing for (owner, _), thing in self.fields.items() if owner == stored]
        for thing in (*objects, *inside):
            change = Change(objects.get(thing, root), node, self.tick(), fact)
            self.changes.setdefault(thing, {}).setdefault(change.place, []).append(change)

    def check_repeats(self, target: ast.expr, node: ast.stmt, *, rebinds: bool) -> None:
        """Raise the error for a store into a value that stands several times in a list.

        `rebinds` tells an assignment that may put a new value into the list, which then holds different ones.
        """
        root, steps = store_depth(target)
        fact = self.single(root) if root is not None else None
        if fact is None or not fact.repeats or fact.value is None:
            return
        if steps > fact.repeats or (steps == fact.repeats and not rebinds):
            raise findings.repeated(self.scope.text, fact.node, node, fact.place, apart(fact.value))
        fact.repeats = 0

    def hand_over(self, names: list[str]) -> None:
        """Note that a function has got what names hold: it may put other values into a list."""
        for name in names:
            if fact := self.single(name):
                fact.repeats = 0

    # Uses.

    def use(self, place: str, node: ast.AST, *, reads: bool = True) -> None:
        """Note the use of a place: for what it holds (`reads`), or only to store into it."""
        if any(place in hidden for hidden in self.hidden):
            return
        facts = self.state.get(place, ())
        for fact in facts:
            if fact.escaped is not None and fact.suspicious():
                raise self.rebound(fact, fact.escaped, node, next_iteration=False)
            self._expose(Use(place, node, fact, reads, self.asking_none), fact.when)
            if reads and len(facts) == 1:
                self.check_alias(fact, node)
        if not facts:
            self._expose(Use(place, node, None, reads, self.asking_none), 0)
        if reads and isinstance(node, ast.Attribute):
            self.check_field(node)

    def _expose(self, use: Use, when: int) -> None:
        for block in self.open:
            if block.is_loop and when < block.start:
                block.exposed.append(use)

    def rebound(self, fact: Fact, block: Block, node: ast.AST, *, next_iteration: bool) -> RecordError:
        """Return the error for a place that a block rebinds."""
        text, prefix = self.scope.text, self.scope.prefix
        loc = findings.at(text, fact.node)
        if fact.index:
            return findings.index_used(loc, fact.place, block.written, node, prefix)
        place = fact.place if fact.place.isidentifier() else quoted(text, node)
        cure = store_instead(text, prefix, place, fact, block)
        is_new = not (fact.existed or next_iteration)
        return findings.rebound(loc, place, block.written, _used(node, next_iteration), cure, is_new=is_new)

    def check_alias(self, fact: Fact, node: ast.AST, *, since: int = 0, next_iteration: bool = False) -> None:
        """Raise the error if the value read here was changed through another name after it got the name of `fact`."""
        if fact.object == NO_OBJECT:
            return
        for change in self._seen(fact.object, max(fact.when, since), besides=fact.place):
            aliases = [f for f in (fact, change.fact) if f.alias is not None]
            if aliases:
                alias = max(aliases, key=lambda f: f.when)
                assert alias.alias is not None
                text, when = self.scope.text, _used(node, next_iteration).replace(" its ", " the ")
                cure = copy_instead(text, alias)
                raise findings.aliased(text, alias.alias, change.node, fact.place, when, cure)

    def check_fields(self, node: ast.expr) -> None:
        """Raise the error if a field of the struct read here, as a whole, was changed through a name of its own."""
        self._check_inside(self.object_of(node), node)

    @contextmanager
    def branch(self, control: str) -> Iterator[None]:
        """Within an SH_ELIF or SH_ELSE, disregard the stores of the branches before it, which were not executed."""
        depth, now = len(self.open), self.tick()
        if control not in ("SH_ELIF", "SH_ELSE"):
            self._first_branch[depth] = now
        self._other_branches.append(range(self._first_branch.get(depth, now), now))
        yield
        self._other_branches.pop()

    def _seen(self, thing: int, since: int, besides: str | None = None) -> Iterator[Change]:
        """Yield the changes of an object since a time, without those of other branches or through one of its names."""
        recent = [
            changes[bisect_left(changes, since, key=attrgetter("when")) :]
            for place, changes in self.changes.get(thing, {}).items()
            if place != besides
        ]
        for change in heapq.merge(*recent, key=attrgetter("when")):
            if not any(change.when in before for before in self._other_branches):
                yield change

    def _check_inside(self, owner: int, node: ast.expr) -> None:
        for thing in [thing for (holder, _), thing in self.fields.items() if holder == owner]:
            self._check_changes(thing, node)
            self._check_inside(thing, node)

    def check_field(self, node: ast.Attribute, *, since: int = 0, next_iteration: bool = False) -> None:
        """Raise the error if the field read here was changed through a name of its own."""
        self._check_changes(self.object_of(node), node, since, next_iteration)

    def _check_changes(self, thing: int, node: ast.expr, since: int = 0, next_iteration: bool = False) -> None:
        for change in self._seen(thing, since):
            if change.fact.object == thing and change.fact.alias is not None:
                text, cure = self.scope.text, copy_instead(self.scope.text, change.fact)
                when = _used(node, next_iteration).replace(" its ", " the ")
                raise findings.aliased(text, change.fact.alias, change.node, ast.unparse(node), when, cure)


def _used(node: ast.AST, next_iteration: bool) -> str:
    return f"{'in its next iteration' if next_iteration else 'after it'} (line {findings.line_of(node)})"
