"""Control flow: SH_IF, SH_ELIF, SH_ELSE, SH_WHILE, SH_DO, SH_UNTIL, SH_FOR and the exits.

Stage: record. Each is a context manager that opens a region of the recording and, when it closes, leaves an `If` or
`Loop` behind; they nest freely.

    with SH_DO():
        n += 1
        SH_UNTIL(n >= 8)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from shpy.errors import RecordError
from shpy.ir.nodes import Break, Continue, Discard, If, Let, Loc, Region, Return, Stmt, Store
from shpy.ir.traverse import has_exit, walk
from shpy.ir.types import Base, vec
from shpy.lang.data.hostdata import checked_bool
from shpy.lang.functions.blocks import Block, CountedLoop, LoopBlock, leave, negated
from shpy.lang.library import trip_count
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import Frame, OpenRegion, need_frame
from shpy.lang.values import arithmetic
from shpy.lang.values.value import Value

_BOOL = vec(Base.B)

# An else-if chain nests a region per link; a longer one goes on behind a flag, so that depth stays small everywhere.
_CHAIN = 12


class Branch:
    """One link of an if chain: what its condition needs, the condition, its region."""

    def __init__(self, prelude: Region, condition: int, region: Region, loc: Loc | None) -> None:
        self.prelude = prelude
        self.condition = condition
        self.region = region
        self.loc = loc


class BranchChain:
    """SH_IF with the SH_ELIFs and the SH_ELSE that follow it: rebuilt into one If whenever a link is added."""

    def __init__(self, frame: Frame, scope: OpenRegion, position: int) -> None:
        self.frame = frame
        self.scope = scope
        self.starts = [position]
        self.segments: list[list[Branch]] = [[]]
        self.orelse: Region = ()
        self.matched: int | None = None
        self.end = 0
        self.variables = 0

    def add(self, branch: Branch) -> None:
        """Add a link; links beyond the length of a segment are tested only if the flag `matched` is not set."""
        if len(self.segments[-1]) == _CHAIN:
            self.segments.append([])
            if self.matched is None:
                self.matched = self.frame.variable(_BOOL, name="matched", loc=branch.loc)
                self.frame.homes[self.matched] = self.scope
        self.segments[-1].append(branch)

    def _set(self, value: bool) -> tuple[Let, Store]:
        assert self.matched is not None
        const = self.frame.new_value(_BOOL)
        return Let(const, "const", (), (int(value),)), Store(self.matched, const.id)

    def rebuild(self) -> None:
        """Replace the statements of the last two segments by those of the current links; earlier ones stand."""
        first = max(len(self.segments) - 2, 0)
        del self.starts[first + 1 :]
        del self.scope.statements[self.starts[first] :]
        statements = self.scope.statements
        if first == 0 and self.matched is not None:
            statements.extend(self._set(False))
        for k in range(first, len(self.segments)):
            segment, last = self.segments[k], k == len(self.segments) - 1
            nested: Region = self.orelse if last else ()
            for branch in reversed(segment):
                flag = () if last else self._set(True)
                link: Region = (If(branch.condition, (*flag, *branch.region), nested, branch.loc),)
                nested = branch.prelude + link
            if k > first:
                self.starts.append(len(statements))
            if k == 0:
                statements.extend(nested)
                continue
            assert self.matched is not None
            flag_value, free = self.frame.new_value(_BOOL), self.frame.new_value(_BOOL)
            statements.append(Let(flag_value, "load", (), self.matched))
            statements.append(Let(free, "not", (flag_value.id,)))
            statements.append(If(free.id, nested, (), segment[0].loc))
        self.end = len(statements)
        self.variables = len(self.frame.variables)


class SH_IF(Block):
    """Run the block where `c`, one bool, holds."""

    what = "SH_IF"

    def __init__(self, c: Any) -> None:
        super().__init__()
        self.condition = arithmetic.condition(c, self.what)

    def finish(self, region: Region) -> None:
        """Leave an If, to which SH_ELIF and SH_ELSE may add."""
        scope = self.frame.scope
        chain = BranchChain(self.frame, scope, len(scope.statements))
        chain.add(Branch((), self.condition, region, self.loc))
        chain.rebuild()
        scope.chain = chain


class _Else(Block):
    """Base of SH_ELIF and SH_ELSE, which continue the chain that ended just before."""

    def __init__(self) -> None:
        super().__init__()
        frame = self.frame
        chain = frame.scope.chain
        if chain is None:
            raise RecordError(
                f"{self.what} follows no SH_IF", loc=self.loc, cure="put it right after the block of an SH_IF"
            )
        self.chain = chain

    def between(self) -> Region:
        """Take the statements after the chain's last block out of the scope and return them.

        Raises RecordError for a statement that does more than compute a condition.
        """
        statements = self.frame.scope.statements
        moved = tuple(statements[self.chain.end :])
        for statement in moved:
            fresh = isinstance(statement, Store) and statement.variable >= self.chain.variables
            if not (isinstance(statement, Let) or fresh):
                raise RecordError(
                    f"between SH_IF and {self.what} something is recorded that does more than compute a condition",
                    loc=getattr(statement, "loc", None) or self.loc,
                    cure="put it before the SH_IF or into a block",
                )
        del statements[self.chain.end :]
        return moved


class SH_ELIF(_Else):
    """Run the block where no condition before it in the chain held and `c` does."""

    what = "SH_ELIF"

    def __init__(self, c: Any) -> None:
        super().__init__()
        self.condition = arithmetic.condition(c, self.what)
        self.prelude = self.between()

    def finish(self, region: Region) -> None:
        """Add the link."""
        self.chain.add(Branch(self.prelude, self.condition, region, self.loc))
        self.chain.rebuild()
        self.frame.scope.chain = self.chain


class SH_ELSE(_Else):
    """Run the block where no condition of the chain held."""

    what = "SH_ELSE"

    def __init__(self) -> None:
        super().__init__()
        if self.between():
            raise RecordError(
                "between SH_IF and SH_ELSE something is recorded",
                loc=self.loc,
                cure="put it before the SH_IF or into a block",
            )

    def finish(self, region: Region) -> None:
        """Close the chain."""
        self.chain.orelse = region
        self.chain.rebuild()
        self.frame.scope.chain = None


class SH_WHILE(LoopBlock):
    """Run the block while `c()`, one bool, holds: a callable, evaluated in every iteration."""

    what = "SH_WHILE"

    def __init__(self, c: Callable[[], Any]) -> None:
        super().__init__()
        if isinstance(c, Value) or not callable(c):
            raise RecordError(
                "SH_WHILE takes a callable, which is evaluated in every iteration",
                loc=self.loc,
                cure="SH_WHILE(lambda: …)",
            )
        self.test = c

    def __enter__(self) -> None:
        self.open()
        holds = arithmetic.condition(self.test, self.what)
        leave(self.frame, negated(self.frame, holds), Break(self.loc), self.loc)


class SH_DO(LoopBlock):
    """Run the block again and again until SH_UNTIL, its last statement, or an exit ends it."""

    what = "SH_DO"

    def finish(self, region: Region) -> None:
        """Leave the Loop; raise an error if no exit can end it."""
        if self.closed_by is None and not _can_end(region):
            raise RecordError(
                "nothing ends this SH_DO", loc=self.loc, cure="SH_UNTIL(c) as its last statement, or an SH_BREAK(c)"
            )
        super().finish(region)


def SH_UNTIL(c: Any) -> None:
    """End the SH_DO that it closes if `c`, a bool or a callable that returns one, is true: its last statement."""
    frame, loc = need_frame("SH_UNTIL"), here()
    block = frame.blocks[-1] if frame.blocks else None
    if not isinstance(block, SH_DO):
        raise RecordError(
            "SH_UNTIL stands in no SH_DO", loc=loc, cure="put it last in the SH_DO block; SH_BREAK(c) leaves elsewhere"
        )
    if block.closed_by is not None:
        raise RecordError(f"this SH_DO has an SH_UNTIL at {block.closed_by}", loc=loc, cure="c1 | c2 in one SH_UNTIL")
    block.closed_by = loc
    block.at_test(lambda: arithmetic.condition(c, "SH_UNTIL"))
    _check_skipped(frame, block, loc)
    assert block.scope is not None
    block.scope.sealed = loc


def _check_skipped(frame: Frame, block: LoopBlock, loc: Loc | None) -> None:
    """Raise the error for a test that reads what was made in the body after an SH_CONTINUE."""
    for statement in block.continuing:
        if block.continued is None or not (isinstance(statement, Let) and statement.op == "load"):
            continue
        variable = statement.attr
        assert isinstance(variable, int)
        if frame.homes[variable] is block.scope and variable >= block.continued_at:
            raise RecordError(
                f"SH_UNTIL reads what the SH_CONTINUE at {block.continued} skips",
                loc=loc,
                cure="SH_UNTIL(lambda: …), which computes it at the test",
            )


class SH_FOR(CountedLoop):
    """Count like range: SH_FOR(stop), SH_FOR(start, stop), SH_FOR(start, stop, step), evaluated once.

    `with SH_FOR(n) as i`: i is a fresh Attrib1i in each iteration.
    """

    def __init__(self, start: Any, stop: Any = None, step: Any = 1) -> None:
        first, last = (0, start) if stop is None else (start, stop)
        super().__init__(first, last, step, trip_count)


def _exit(what: str, exit: Stmt, c: Any) -> None:
    frame = need_frame(what)
    if c is None:
        frame.append(exit)
    else:
        leave(frame, arithmetic.condition(c, what), exit, here())


def _loop(what: str) -> LoopBlock:
    frame = need_frame(what)
    block = next((b for b in reversed(frame.blocks) if isinstance(b, LoopBlock)), None)
    if block is None:
        raise RecordError(f"{what} stands in no loop", loc=here(), cure="put it inside SH_DO, SH_WHILE or SH_FOR")
    return block


def SH_BREAK(c: Any = None) -> None:
    """End the innermost loop; with a condition `c`, only where it holds."""
    _loop("SH_BREAK")
    _exit("SH_BREAK", Break(here()), c)


def SH_CONTINUE(c: Any = None) -> None:
    """Go to the innermost loop's test, where `c` holds if it is given."""
    block = _loop("SH_CONTINUE")
    if block.continued is None:
        block.continued, block.continued_at = here(), len(block.frame.variables)
    _exit("SH_CONTINUE", Continue(here()), c)


def SH_DISCARD(c: Any = None) -> None:
    """End the whole element, from any depth, where `c` holds if it is given: it writes nothing."""
    _exit("SH_DISCARD", Discard(0, here()), c)


def SH_RETURN(value: Any = None, c: Any = None, *, through: bool = False) -> None:
    """End the program or subroutine whose body it stands in, with `value` (a tuple for several), where `c` holds.

    Raises RecordError in a plain function that the program calls: it would end the program, not that function.
    `through=True` means just that: a front end whose own functions record a program's statements ends the program from
    any of them.
    """
    frame = need_frame("SH_RETURN")
    frame.returned.check_place(through=checked_bool(through, "through"))
    frame.returned.at_exit(value, None if c is None else arithmetic.condition(c, "SH_RETURN"), Return(here()))


def _can_end(region: Region) -> bool:
    """Return whether a break of this loop, a return or a discard stands in it."""
    return has_exit(region, Break) or any(isinstance(s, Return | Discard) for s in walk(region))
