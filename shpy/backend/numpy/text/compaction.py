"""A loop goes on with the lanes that are still in it, once many have left: a pass over the output tree.

Stage: emit. Loops that lanes leave one by one are `LaneLoop`s. The names that an iteration needs are made shorter, and
those that are needed after the loop are kept and given back.

    while True:                            all_c = c
        z = z * z + c                      lane = np.arange(lanes)
        leaving = live & (z > 4.0)         while True:
        put_aside(n_out, lane, ...)   ->       if few(live):
        live &= ~leaving                           c, lane, live, z = compact(live, c, lane, live, z)
        if not live.any():                     z = z * z + c
            break                              ...
    return n_out + c                       c = all_c
                                           return n_out + c
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import field, replace

from shpy.backend.emit import tree
from shpy.backend.emit.names import Names
from shpy.backend.emit.tree import BOOL, INT, Assign, Block, Do, Each, Exit, Expr, If, Loop, Name, Stmt, Tuple, Update
from shpy.ir.frozen import dataclass

_NONE: frozenset[Expr] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneLoop(Loop):
    """A loop that lanes leave one by one.

    `lane`: the name for the numbers its lanes have outside; `live`: its mask; `exits`: the arrays that lanes are put
    into when they leave, which keep all lanes; `lanes`: how many there are outside.
    """

    lane: Name
    live: Expr
    lanes: Expr
    exits: frozenset[Expr] = field(default=_NONE)


@dataclass(frozen=True, slots=True)
class _LoopNames:
    """The names that a loop stores, needs when an iteration begins, and leaves behind."""

    loop: LaneLoop
    stored: frozenset[Expr]
    head: frozenset[Expr]
    after: frozenset[Expr]


def compacted(block: Block, varying: Iterable[Expr], names: Names) -> Block:
    """Return the body of a function with its loops compacted.

    `varying` are the names whose values differ from lane to lane; `names` gives new names.
    """
    reader = _Reader()
    reader.before(block, _NONE, _NONE, _NONE)
    if not reader.loops:
        return block
    around = {key: _Around(entry, frozenset(varying), names) for key, entry in reader.loops.items()}
    return _rebuilt(block, around)


class _Around:
    """The statements that compaction adds before and after a loop, and at the start of each iteration."""

    def __init__(self, entry: _LoopNames, varying: frozenset[Expr], names: Names) -> None:
        loop = entry.loop
        inner = _names(*[e for s in tree.statements_of((loop,)) for e in tree.expressions_of(s)])
        carried = (entry.head & inner & varying - loop.exits) | {loop.lane, loop.live}
        inside = sorted(carried, key=_text)
        saved = [e for e in inside if e in entry.after and e != loop.lane]
        kept = {e: Name(e.type, names.take(f"all_{_text(e)}")) for e in saved}
        numbers = Assign(loop.lane, tree.call("np.arange", INT, loop.lanes))
        self.before: Block = (numbers,)
        self.head: Block = ()
        self.behind: Block = ()
        if not entry.stored & entry.after & varying - loop.exits:  # changes of an iteration leave by exits
            shorter = Assign(Tuple(BOOL, tuple(inside)), tree.call("compact", BOOL, loop.live, *inside))
            self.head = (If(tree.call("few", BOOL, loop.live), (shorter,)),)
            self.before = (*[Assign(kept[e], e) for e in saved], numbers)
            self.behind = tuple([Assign(e, kept[e]) for e in saved])


def _text(e: Expr) -> str:
    assert isinstance(e, Name)
    return e.text


def _rebuilt(block: Block, around: dict[int, _Around]) -> Block:
    statements: list[Stmt] = []
    for s in block:
        match s:
            case If():
                statements.append(replace(s, then=_rebuilt(s.then, around), orelse=_rebuilt(s.orelse, around)))
            case LaneLoop():
                a = around[id(s)]
                loop = Loop((*a.head, *_rebuilt(s.body, around)), test=s.test, loc=s.loc)
                statements += [*a.before, loop, *a.behind]
            case Loop():
                statements.append(replace(s, body=_rebuilt(s.body, around)))
            case _:
                statements.append(s)
    return tuple(statements)


def _names(*expressions: Expr | None) -> frozenset[Expr]:
    return frozenset([e for whole in expressions if whole is not None for e in tree.walk(whole) if isinstance(e, Name)])


def _targets(s: Assign) -> frozenset[Expr]:
    """Return the names that an assignment gives a new value."""
    targets = s.target.args if isinstance(s.target, Tuple) else (s.target,)
    return frozenset([e for e in targets if isinstance(e, Name)])


def _stored(block: Block) -> frozenset[Expr]:
    """Return the names that statements give a new value."""
    names: set[Expr] = set()
    for s in tree.statements_of(block):
        match s:
            case Assign():
                names |= _targets(s)
            case Update(name) | Each(name):
                names.add(name)
    return frozenset(names)


class _Reader:
    """Follows the statements of a function backwards: the names that are needed before them."""

    def __init__(self) -> None:
        self.loops: dict[int, _LoopNames] = {}
        self.names_by_id: dict[int, frozenset[Expr]] = {}
        """The names in an expression, by its `id`: a loop's statements are followed once for each loop around them."""

    def names(self, *expressions: Expr | None) -> frozenset[Expr]:
        """Return the names in expressions."""
        names = _NONE
        for e in expressions:
            if id(e) not in self.names_by_id:
                self.names_by_id[id(e)] = _names(e)
            names |= self.names_by_id[id(e)]
        return names

    def before(
        self, block: Block, after: frozenset[Expr], leave: frozenset[Expr], again: frozenset[Expr]
    ) -> frozenset[Expr]:
        """Find the names needed before statements; a break needs those of `leave`, a continue those of `again`."""
        for s in reversed(block):
            match s:
                case If():
                    sides = self.before(s.then, after, leave, again) | self.before(s.orelse, after, leave, again)
                    after = sides | self.names(s.condition)
                case Loop() | Each():
                    after = self.loop(s, after)
                case Exit("break"):
                    after = leave
                case Exit("continue"):
                    after = again
                case Exit():
                    after = self.names(s.value)
                case Assign():
                    stored = _targets(s)
                    target = _NONE if stored else self.names(s.target)
                    after = (after - stored) | target | self.names(s.value)
                case Update():
                    after |= self.names(s.target, s.value)
                case Do():
                    after |= self.names(s.value)
        return after

    def loop(self, s: Loop | Each, after: frozenset[Expr]) -> frozenset[Expr]:
        """Find the names needed before a loop, or a loop over a sequence, which gives its name a value."""
        own, tested = (frozenset({s.name}), True) if isinstance(s, Each) else (_NONE, s.test is not None)
        out = after if tested else _NONE
        if isinstance(s, Loop):
            out |= self.names(s.test)
        head = out
        while (again := out | (self.before(s.body, head, after, head) - own)) != head:
            head = again
        if isinstance(s, LaneLoop):
            self.loops[id(s)] = _LoopNames(s, _stored(s.body), head | {s.live}, after)
            head = (head | {s.live}) - {s.lane}  # the loop stores it first
        return head | self.names(s.over) if isinstance(s, Each) else head
