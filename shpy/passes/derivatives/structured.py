"""Replace Break, Continue and Return by flags, so that control leaves every region at its end.

Stage: improve; for `reverse`, which runs statements backwards, and needs to know only which branches were taken.
Discards stay, since an element that ends has no derivative.

    loop:                             loop:
        if c:                             left = false
            break                         if c:
        A                     ->              left = true
    until d                               if not left:
                                              A
                                              left = d
                                      until left
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from math import isqrt

from shpy.ir.builder import Builder
from shpy.ir.nodes import Break, Continue, Function, If, Let, Loop, Module, Region, Return, Stmt, Store, Value
from shpy.ir.ops import COMPOSITES, OPS
from shpy.ir.traverse import continues, has_exit, test_length
from shpy.ir.types import Base, vec
from shpy.passes.by_value import pass_by_value, takes_array
from shpy.passes.derivatives.table_reads import reads_in_loops
from shpy.passes.inline import inline_calls
from shpy.passes.lower import lower
from shpy.passes.pipeline import optimise
from shpy.passes.returns import returns_outside_loops

_BOOL = vec(Base.B)
_INT = vec(Base.I)
_LEAVES = Break | Continue | Return


FEW = 1024
"""The most iterations of a loop whose states are all kept; a longer one becomes a loop in a loop.

The arrays of states have one element for each iteration, and 4,096 at most. Split, a loop of 1,024 iterations with four
floats of state takes 1.4 times as long on llvmpipe and as long on PoCL, so the split is for loops that need it.
"""


def prepared(module: Module, tables: Collection[str] = (), *, defined: bool = False) -> Module:
    """Return a module whose functions take values, and leave each region at its end.

    Functions in which a loop reads one of the `tables` are inlined, so that one count numbers their reads. With
    `defined`, composite operations are calls of their definitions, whose roundings count one by one.
    """
    looped = reads_in_loops(module, tables) - {f.name for f in module.functions if f.tangent is not None}
    if defined:
        module = lower(module, frozenset(OPS) - COMPOSITES)
    module = optimise(pass_by_value(inline_calls(module, lambda f: takes_array(f) or f.name in looped)), fixed=False)
    functions = tuple(split_loops(structured(f), FEW) for f in module.functions)
    return optimise(replace(module, functions=functions), fixed=False)


def structured(function: Function) -> Function:
    """Return the function without Break, Continue and Return."""
    return _Flags(returns_outside_loops(function)).run()


class _Flags:
    """Rewrites one function."""

    def __init__(self, function: Function) -> None:
        self.function = function
        self.b = Builder(function=function)

    def run(self) -> Function:
        """Return the function whose regions end at their ends."""
        f, b = self.function, self.b
        if has_exit(f.body, Return):
            left = b.variable(_BOOL, name="left").id
            b.extend(self._guarded(f.body, left, left))
        else:
            b.extend(self._region(f.body))
        return replace(b.finish(), pure=f.pure)

    def _flag(self, slot: int, holds: bool) -> None:
        self.b.store(slot, self.b.const(_BOOL, [holds]))

    def _region(self, region: Region) -> Region:
        """Return a region without exits of its own, with the loops in it rewritten."""
        self.b.push()
        for s in region:
            self._statement(s)
        return self.b.pop()

    def _statement(self, s: Stmt) -> None:
        if isinstance(s, Loop):
            self._loop(s)
        elif isinstance(s, If):
            self.b.append(If(s.condition, self._region(s.then), self._region(s.orelse), s.loc))
        else:
            self.b.append(s)

    def _guarded(self, region: Region, skip: int, leave: int) -> Region:
        """Return a region in which an exit stores true into `skip`, and unless it is a Continue into `leave`."""
        b = self.b
        b.push()
        for n, s in enumerate(region):
            if isinstance(s, _LEAVES):
                b.loc = s.loc
                self._flag(skip, True)
                if not isinstance(s, Continue) and leave != skip:
                    self._flag(leave, True)
                break
            if isinstance(s, If) and has_exit((s,), _LEAVES):
                then, orelse = (self._guarded(r, skip, leave) for r in (s.then, s.orelse))
                b.append(If(s.condition, then, orelse, s.loc))
                if region[n + 1 :]:
                    b.loc = s.loc
                    with b.when(b.let("not", b.load(skip))):
                        b.extend(self._guarded(region[n + 1 :], skip, leave))
                break
            self._statement(s)
        return b.pop()

    def _loop(self, loop: Loop) -> None:
        b = self.b
        b.loc = loop.loc
        head = head_of(loop)
        if head:
            body = (*loop.body[:head], *self._region(loop.body[head:]))
            b.append(Loop(body, self._region(loop.continuing), None, loop.turns, loop.loc))
            return
        if not has_exit(loop.body, Break | Continue):
            b.append(Loop(self._region(loop.body + loop.continuing), (), loop.until, loop.turns, loop.loc))
            return
        left = b.variable(_BOOL, name="left").id
        last: Region = loop.continuing
        if loop.until is not None:
            last = (*last, Store(left, loop.until, None, None, loop.loc))
        skips = continues(loop)
        skip = b.variable(_BOOL, name="skip").id if skips else left
        b.push()
        self._flag(left, False)
        if skips:
            self._flag(skip, False)
            b.extend(self._guarded(loop.body, skip, left))
            if last:
                with b.when(b.let("not", b.load(left))):
                    b.extend(self._region(last))
        else:
            b.extend(self._guarded(loop.body + last, skip, left))
        until = b.load(left)
        turns = None if loop.turns is None else loop.turns + (test_length(loop.body) > 0)
        b.append(Loop(b.pop(), (), until.id, turns, loop.loc))


def head_of(loop: Loop) -> int:
    """Return the number of statements that are the test of a loop, if that is its only exit; else 0.

    They are Lets, and the If with the Break at last. An iteration counts once its test has passed, so the statements
    run once more than `turns` says.
    """
    head = test_length(loop.body)
    plain = all(isinstance(s, Let) for s in loop.body[: head - 1])
    return head if head and plain and loop.until is None and not has_exit(loop.body[head:], _LEAVES) else 0


def split_loops(function: Function, above: int) -> Function:
    """Return the structured function with each loop of more than `above` iterations as a loop in a loop.

    Reverse mode keeps the state at the start of each iteration, and computes an iteration of the outer loop again. So
    it keeps 2 sqrt(n) states in place of n, for one more computation of the loop.
    """
    b = Builder(function=function)

    def region(statements: Region) -> Region:
        b.push()
        for s in statements:
            match s:
                case If(condition, then, orelse, loc):
                    b.append(If(condition, region(then), region(orelse), loc))
                case Loop(body, continuing, until, turns, loc):
                    inner = Loop(region(body), region(continuing), until, turns, loc)
                    if turns is None or turns <= above:
                        b.append(inner)
                    else:
                        _split(b, inner, turns + (head_of(inner) > 0))
                case _:
                    b.append(s)
        return b.pop()

    b.extend(region(function.body))
    return replace(b.finish(), pure=function.pure)


def _split(b: Builder, loop: Loop, turns: int) -> None:
    """Append a loop of at most `turns` iterations as a loop in a loop."""
    b.loc = loop.loc
    head = head_of(loop)
    each = isqrt(turns - 1) + 1
    done, count = b.variable(_BOOL, name="done"), b.variable(_INT, name="step")
    b.push()
    b.store(count, b.const(_INT, [0]))
    b.push()
    if head:
        *test, leave = loop.body[:head]
        assert isinstance(leave, If)
        b.extend(test)
        b.store(done, leave.condition)
        with b.when(b.let("not", leave.condition)):
            b.extend((*loop.body[head:], *loop.continuing))
    else:
        b.extend((*loop.body, *loop.continuing))
        b.store(done, b.const(_BOOL, [True]) if loop.until is None else loop.until)
    steps = b.let("add", b.load(count), b.const(_INT, [1]))
    b.store(count, steps)
    full: Value = b.let("or", b.let("ge", steps, b.const(_INT, [each])), b.load(done))
    b.append(Loop(b.pop(), (), full.id, each, loop.loc))
    end = b.load(done)
    b.append(Loop(b.pop(), (), end.id, -(-turns // each), loop.loc))
