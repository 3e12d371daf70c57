"""Writes into a printed function how a loop goes on with the lanes that are still in it, once many have left.

Stage: emit. Part of the numpy printer, which leaves a mark at the head of each loop that lanes leave one by one. Which
names an iteration needs, and which are needed after the loop, is read off the text.

    while True:                            all_c = c
        compact(1)                         lane = np.arange(lanes)
        z = z * z + c                      while True:
        leaving = live & (z > 4.0)             if few(live):
        put_aside(n_out, lane, ...)   ->            c, lane, live, z = compact(live, c, lane, live, z)
        live &= ~leaving                       z = z * z + c
        if not live.any():                     leaving = live & (z > 4.0)
            break                              ...
    return n_out + c                       c = all_c
                                           return n_out + c
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from shpy.backends.emit.names import Names
from shpy.parsing import parse

__all__ = ["MARK", "Compaction", "compacted"]

MARK = "compact"
"""What the mark calls, with the number of its loop."""
_NONE: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Compaction:
    """What the printer knows of a loop.

    `lane`: the name for the numbers its lanes have outside; `live`: its mask; `exits`: the arrays that lanes are put
    into when they leave, which keep all lanes; `lanes`: how many there are outside.
    """

    lane: str
    live: str
    exits: frozenset[str]
    lanes: str


@dataclass(frozen=True, slots=True)
class _Found:
    """A marked loop in the text: the names it stores, needs when an iteration begins, and leaves behind."""

    loop: ast.While
    stored: frozenset[str]
    head: frozenset[str]
    after: frozenset[str]


def compacted(text: str, loops: Mapping[int, Compaction], varying: Iterable[str], taken: Names) -> str:
    """The text of a function with its marks replaced.

    `varying` are the names of what differs from lane to lane; `taken` gives new ones.
    """
    if not loops:
        return text
    lines, names = text.split("\n"), frozenset(varying) | {c.lane for c in loops.values()}
    function = parse(text).body[0]
    assert isinstance(function, ast.FunctionDef)
    reader = _Reader(loops)
    reader.before(function.body, _NONE, _NONE, _NONE)
    added: list[tuple[int, int, int, list[str]]] = []  # first line, its rank, line after, what comes instead
    for number, found in reader.found.items():
        c = loops[number]
        mark, pad = found.loop.body[0], " " * found.loop.col_offset
        carried = sorted(found.head & _names([found.loop]) & names - c.exits | {c.lane, c.live})
        saved = [n for n in carried if n in found.after and n != c.lane]
        every = ", ".join(carried)
        keep = {n: taken.take(f"all_{n}") for n in saved}
        before = [f"{pad}{keep[n]} = {n}" for n in saved] + [f"{pad}{c.lane} = np.arange({c.lanes})"]
        head = [f"{pad}    if few({c.live}):", f"{pad}        {every} = compact({c.live}, {every})"]
        if found.stored & found.after & names - c.exits:
            head, saved, before = [], [], before[-1:]  # what an iteration changes has no way out yet
        added.append((found.loop.lineno - 1, 1, found.loop.lineno - 1, before))
        added.append((mark.lineno - 1, 1, mark.lineno, head))
        end = found.loop.end_lineno or 0
        added.append((end, -len(pad), end, [f"{pad}{n} = {keep[n]}" for n in saved]))
    # From the last line to the first; of loops that end on one line the inner comes first.
    for start, _, stop, new in sorted(added, key=lambda a: a[:2], reverse=True):
        lines[start:stop] = new
    return "\n".join(lines)


def _names(nodes: Sequence[ast.AST], context: type[ast.expr_context] = ast.expr_context) -> frozenset[str]:
    return frozenset(
        n.id for node in nodes for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, context)
    )


class _Reader:
    """Follows the statements of a function backwards: the names that are needed before them."""

    def __init__(self, loops: Mapping[int, Compaction]) -> None:
        self.loops = loops
        self.found: dict[int, _Found] = {}

    def before(
        self, statements: Sequence[ast.stmt], after: frozenset[str], leave: frozenset[str], again: frozenset[str]
    ) -> frozenset[str]:
        """Find the names needed before statements; a break needs those of `leave`, a continue those of `again`."""
        for s in reversed(statements):
            match s:
                case ast.If():
                    sides = self.before(s.body, after, leave, again) | self.before(s.orelse, after, leave, again)
                    after = sides | _names([s.test])
                case ast.While():
                    after = self.loop(s, after)
                case ast.Break():
                    after = leave
                case ast.Continue():
                    after = again
                case ast.Return():
                    after = _names([s])
                case ast.AugAssign():  # its target is read, although it counts as stored alone
                    after |= _names([s])
                case _:
                    after = (after - _names([s], ast.Store)) | _names([s], ast.Load)
        return after

    def loop(self, s: ast.While, after: frozenset[str]) -> frozenset[str]:
        """What is needed before a loop; its marks are found on the way."""
        test = _names([s.test])
        out = _NONE if isinstance(s.test, ast.Constant) else after
        head = test | out
        while True:
            again = test | out | self.before(s.body, head, after, head)
            if again == head:
                break
            head = again
        match s.body[0]:
            case ast.Expr(ast.Call(ast.Name(id="compact"), [ast.Constant(int(number))])):
                self.found[number] = _Found(s, _names(s.body, ast.Store), head, after)
                head -= {self.loops[number].lane}  # it is stored in front
        return head
