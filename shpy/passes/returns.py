"""Replace each Return inside a loop by a flag and a Break.

Stage: improve; for `inline` and `vectorize`, which then need to handle only Breaks in loops. Takes and returns a
function; afterwards no `Return` is inside a loop.

    loop:                            loop:
        if c:                            if c:
            return                           $returned = true
        ...                                  break
                            ->           ...
    ...                              if $returned:
                                         return
                                     ...

In a function with a status from `exits.py`, a Return after a store of a status other than WRITTEN becomes a `Discard`,
also inside loops: the status is stored, and no other output is needed. So does a Return under the test whether a call
has ended the element. After a loop, the status itself serves as the flag for such Discards.
"""

from __future__ import annotations

from shpy.ir.builder import Builder
from shpy.ir.constants import Base, vec
from shpy.ir.nodes import Break, Discard, Function, If, Let, Loc, Loop, Region, Return, Status, Stmt, Store
from shpy.ir.traverse import walk


def returns_outside_loops(function: Function, status: int | None = None) -> Function:
    """Return the function with every Return inside a loop replaced; `status` is the variable that holds the status."""
    inside = any(_contains(s, Return) for s in walk(function.body) if isinstance(s, Loop))
    return _ReturnRewriter(function, status).run() if inside or status is not None else function


def _contains(loop: Loop, kind: type[Return | Discard]) -> bool:
    return any(isinstance(s, kind) for s in walk(loop.body))


class _ReturnRewriter:
    def __init__(self, function: Function, status: int | None) -> None:
        self.function = function
        self.status = status
        self.b = Builder(function=function)
        self.flag = -1
        constants = [s for s in walk(function.body) if isinstance(s, Let) and s.op == "const"]
        self.ends = {s.value.id for s in constants if s.attr != (Status.WRITTEN,)}
        self.ended = self.ended_by_a_call({s.value.id for s in constants} - self.ends)

    def run(self) -> Function:
        if self.status is not None:
            # Tests after loops load the status; the store from `exits` is removed as dead if all paths end in a call.
            self.b.store(self.status, self.b.const(vec(Base.I), [Status.WRITTEN]))
        self.b.extend(self.region(self.function.body, in_loop=False))
        return self.b.finish()

    def region(self, region: Region, *, in_loop: bool) -> Region:
        self.b.push()
        for n, statement in enumerate(region):
            match statement:
                case Return(loc) if self.ends_element(region[:n]):
                    self.b.append(Discard(loc=loc))
                case Return(loc) if in_loop:
                    self.raise_flag(loc)
                    self.b.append(Break(loc))
                case If(condition, (Return(),), (), loc) if condition in self.ended:
                    self.b.append(If(condition, (Discard(loc=loc),), (), loc))
                case If(condition, then, orelse, loc):
                    then = self.region(then, in_loop=in_loop)
                    self.b.append(If(condition, then, self.region(orelse, in_loop=in_loop), loc))
                case Loop(body, continuing, until, turns, loc):
                    loop = Loop(self.region(body, in_loop=True), continuing, until, turns, loc)
                    self.b.append(loop)
                    self.after(loop, returned=_contains(statement, Return), in_loop=in_loop)
                case _:
                    self.b.append(statement)
        return self.b.pop()

    def ended_by_a_call(self, written: set[int]) -> set[int]:
        """Return the ids of the conditions `status != WRITTEN`, which tell whether a call has ended the element."""
        statements = (
            [s for s in walk(self.function.body) if isinstance(s, Let | Store)] if self.status is not None else []
        )
        statuses = {s.value for s in statements if isinstance(s, Store) and s.variable == self.status}
        statuses |= {
            s.value.id
            for s in statements
            if isinstance(s, Let) and s.op == "load" and s.attr == self.status and not s.args
        }
        return {
            s.value.id
            for s in statements
            if isinstance(s, Let) and s.op == "ne" and s.args[0] in statuses and s.args[1] in written
        }

    def ends_element(self, before: Region) -> bool:
        """Return whether the last status stored in these statements is not WRITTEN."""
        stores = [s for s in before if isinstance(s, Store) and s.variable == self.status]
        return self.status is not None and bool(stores) and stores[-1].value in self.ends

    def raise_flag(self, loc: Loc | None) -> None:
        if self.flag < 0:
            self.flag = self.b.variable(vec(Base.B), name="returned").id
        self.b.store(self.flag, self.b.const(vec(Base.B), [True]), loc=loc)

    def after(self, loop: Loop, *, returned: bool, in_loop: bool) -> None:
        """Append exits after a loop for the elements that ended or returned inside it."""
        b = self.b
        if _contains(loop, Discard) and self.status is not None:
            written = b.const(vec(Base.I), [Status.WRITTEN])
            ended = b.let("ne", b.load(self.status, loc=loop.loc), written, loc=loop.loc)
            b.append(If(ended.id, (Discard(loc=loop.loc),), (), loop.loc))
        if returned and self.flag >= 0:
            leave: Stmt = Break(loop.loc) if in_loop else Return(loop.loc)
            b.append(If(b.load(self.flag, loc=loop.loc).id, (leave,), (), loop.loc))
