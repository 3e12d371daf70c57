"""The shapes of loops: for, while, do, and those that a language has no word for.

Stage: emit. The IR has one loop. Its shape is read off the statements that its parts became:

    body begins with If(not c) { Break }                        while (c) { ... }
    ... and `continuing` became one assignment                  for (int i = 0; i < n; i += 1) { ... }
    until c, which reads nothing declared in the loop           do { ... } while (!c);
    any other                                                   while (true) { ... if (c) { break; } }
    one whose `continuing` cannot follow a `continue`           again = false; while (true) { if (again) { ... } ... }
"""

from __future__ import annotations

from dataclasses import dataclass

from shpy.backend.emit import tree
from shpy.backend.emit.names import Names
from shpy.backend.emit.survey import Place, Survey, is_whole
from shpy.backend.emit.tree import BOOL, Assign, Block, Declare, Exit, Expr, Literal, Name
from shpy.ir.nodes import Let, Loc, Loop, Region, Store
from shpy.ir.traverse import continues, results, test_length, uses


@dataclass(frozen=True, slots=True)
class LoopParts:
    """A loop, with the tree that each of its parts became."""

    loop: Loop
    starts: tuple[Declare, ...]
    """The counters that begin with the loop."""
    test: Expr | None
    """The condition of the rest of the body, if the body begins with a test."""
    body: Block
    last: Block
    """The statements of `continuing`."""
    until: Expr | None
    around: Names
    """The names that are visible in the loop's head."""

    def counted(self) -> tree.Loop | None:
        """Return a `for`, if `continuing` is one assignment that reads no value of the body but those of its test."""
        body, continuing = self.loop.body, self.loop.continuing
        if self.until is not None or len(self.last) != 1 or not is_step(continuing):
            return None
        (step,) = self.last
        if not isinstance(step, Assign) or not (self._is_visible(step.value) and self._is_visible(step.target)):
            return None
        start = 0 if self.test is None else test_length(body)
        values = {v.id for s in body[start:] for v in results(s)}
        if not values.isdisjoint(v for s in continuing for v in uses(s)):
            return None
        return tree.Loop(self.body, self.starts, self.test, step, loc=self.loop.loc)

    def plain(self) -> tree.Loop | None:
        """Return body, `continuing` and test, one after the other; None if a `continue` would skip one of these."""
        line, again, ends = self._line_of_test(), None, list[tree.Stmt]()
        skips = continues(self.loop)
        if self.until is not None:
            if self.test is None and self._is_visible(self.until) and not (skips and self.last):
                again = tree.negation(self.until)
            else:
                ends.append(tree.If(self.until, (Exit("break"),), (), line))
        if skips and (self.last or ends):
            return None
        block, again_line = (*self.body, *self.last, *ends), None if again is None else line
        return tree.Loop(block, test=self.test, again=again, loc=self.loop.loc, again_loc=again_line)

    def gated(self, gate: Name) -> tree.Loop:
        """Return a loop whose step and test are at its top, skipped in the first iteration: `continue` goes there."""
        ends = () if self.until is None else (tree.If(self.until, (Exit("break"),)),)
        first = () if self.test is None else (tree.If(tree.negation(self.test), (Exit("break"),)),)
        top = (tree.If(gate, (*self.last, *ends)), Assign(gate, Literal(BOOL, True)))
        return tree.Loop((*top, *first, *self.body), loc=self.loop.loc)

    def _is_visible(self, e: Expr) -> bool:
        """Return whether the head of the loop knows all names in an expression."""
        return all(part.text in self.around for part in tree.walk(e) if isinstance(part, Name))

    def _line_of_test(self) -> Loc | None:
        """Return the user's line that computes what ends the loop."""
        values = (s.value for s in (*self.loop.body, *self.loop.continuing) if isinstance(s, Let))
        return next((value.loc for value in values if value.id == self.loop.until), None)


def leading_test(body: Region) -> int | None:
    """Return the index of the `If(c) { Break }` that comes after nothing but Lets."""
    at = test_length(body) - 1
    return at if at >= 0 and all(isinstance(s, Let) for s in body[:at]) else None


def is_step(region: Region) -> bool:
    """Return whether the region is Lets and then one store of a whole variable."""
    *lets, last = region or (None,)
    return isinstance(last, Store) and is_whole(last) and all(isinstance(s, Let) for s in lets)


def opens_loop(survey: Survey, s: Store, place: Place, reads: frozenset[int] = frozenset()) -> bool:
    """Return whether a store gives a counter its first value, and only the loop that follows touches it.

    `reads` are the variables that the value reads. Stores of others may come between.
    """
    if s.variable not in survey.counters:
        return False
    region, index, between = survey.regions[place[0]], place[1] + 1, set()
    while index < len(region) and isinstance(region[index], Let | Store):
        if isinstance(other := region[index], Store):
            between.add(other.variable)
        index += 1
    loop = region[index] if index < len(region) else None
    if not isinstance(loop, Loop) or loop.until is not None or not is_step(loop.continuing):
        return False
    step = loop.continuing[-1]
    if not isinstance(step, Store) or step.variable != s.variable or leading_test(loop.body) is None:
        return False
    inside = survey.touches_inside((place[0], index), s.variable)
    return reads.isdisjoint(between) and len(survey.touched[s.variable]) == inside + 1
