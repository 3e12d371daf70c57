"""Make an `alone` function compute two lanes, and interleave the iterations of their loops.

Stage: improve; the OpenCL backend applies it as it prints packets. The function has one loop, in which each iteration
depends on a load of the one before: in a walk through a tree, a node holds the index of the next node. The processor
computes one lane during the latency of the other lane's load.

    alone function f(%x: f) -> ($y: f) {   |   alone function f(%x: f, %there: b, %other_x: f) -> ($y: f, $other_y: f) {
      store $n = %x                        |     store $n = %x;              store $going = true
      loop {                               |     store $other_n = %other_x;  store $other_going = %there
        if %c { break }                    |     loop {
        ...                                |       if $going { if %c { store $going = false } else { ... } }
      }                               ->   |       if $other_going { the same, with $other_n }
      store $y = $n                        |     } until not ($going or $other_going)
    }                                      |     store $y = $n
                                           |     store $other_y = $other_n
                                           |   }

The statements before and after the loop are not interleaved, and run for the other lane even if `there` is false.

Without it, a picture of glass of 254,000 triangles takes 1.10 times the CPU time (512 x 512, 8 bounces, 16 lanes, PoCL
3.1 with AVX-512, walks of eight boxes), and with walks of four boxes a path-traced picture of as many matt triangles
took 1.00. The pass can go where both stay below 1.05.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from shpy.ir.builder import Builder
from shpy.ir.nodes import Break, Call, Discard, Function, Loop, Region, Return, Stmt, Value, Variable
from shpy.ir.traverse import Copy, continues, walk
from shpy.ir.types import Base, vec
from shpy.passes.inline import without_returns
from shpy.passes.rewriter import falls_through, map_exits

OTHER: Final = "other_"
"""The prefix of names for the other lane."""

_BOOL: Final = vec(Base.B)


def pair(function: Function) -> Function | None:
    """Return the function for two lanes; None if it is anything but statements, one loop, and statements.

    Its inputs are the inputs of the first lane, `there` (whether there is a second lane), and the inputs of the second.
    It returns the outputs of the first lane, then those of the second, which are undefined if `there` is False.
    """
    parts = _Parts.of(function)
    if parts is None:
        return None
    b = Builder(function.name, loc=function.loc)
    one, other = Copy(b.value, {}), Copy(b.value, {}, OTHER)
    _add_inputs(b, one, function)
    there = b.input(_BOOL, "there")
    _add_inputs(b, other, function)
    for copy in (one, other):
        for o in function.outputs:
            copy.slots[o.id] = b.output(o.type, copy.renamed(o.name), o.loc).id
    for copy in (one, other):
        for v in (*function.variables, parts.going):
            copy.slots[v.id] = b.variable(v.type, v.length, copy.renamed(v.name), v.loc).id
        b.extend(copy.region(parts.before))
    b.store(one.slots[parts.going.id], b.const(_BOOL, [True]))
    b.store(other.slots[parts.going.id], there)
    with b.loop(loc=parts.loop.loc) as loop:
        for copy in (one, other):
            with b.when(b.load(copy.slots[parts.going.id]), parts.loop.loc):
                b.extend(copy.region(parts.iteration))
        going = [b.load(copy.slots[parts.going.id]) for copy in (one, other)]
        loop.until(b.let("not", b.let("or", *going)))
    for copy in (one, other):
        b.extend(copy.region(parts.after))
    return b.finish()


def _add_inputs(b: Builder, copy: Copy, function: Function) -> None:
    for i in function.inputs:
        assert isinstance(i, Value)  # a function that lanes run alone takes no arrays
        copy.values[i.id] = b.input(i.type, copy.renamed(i.name), i.loc).id


@dataclass(frozen=True)
class _Parts:
    """The statements before a function's loop, those of an iteration, and those after the loop.

    An iteration that ends the loop stores false in `going`.
    """

    before: Region
    loop: Loop
    iteration: Region
    after: Region
    going: Variable

    @classmethod
    def of(cls, function: Function) -> _Parts | None:
        """Return the parts; None if the body has not just one loop, or leaves it for elsewhere than after it."""
        at = [n for n, s in enumerate(function.body) if isinstance(s, Loop)]
        if len(at) != 1 or any(isinstance(s, Return | Discard | Call) for s in walk(function.body)):
            return None
        loop = function.body[at[0]]
        assert isinstance(loop, Loop)
        if continues(loop):
            return None
        b = Builder(function=function)
        going = b.variable(_BOOL, name="going")
        iteration = without_returns(_iteration(b, loop, going))
        if iteration is None:
            return None
        return cls(function.body[: at[0]], loop, iteration, function.body[at[0] + 1 :], going)


def _iteration(b: Builder, loop: Loop, going: Variable) -> Region:
    """Return an iteration that stores false in `going` and returns where the loop breaks."""

    def leave(s: Stmt) -> Region:
        if not isinstance(s, Break):
            return (s,)
        b.push()
        b.store(going, b.const(_BOOL, [False]), loc=s.loc)
        b.exit(Return, s.loc)
        return b.pop()

    body = map_exits(loop.body, leave)
    if not falls_through(body):
        return body
    b.push()
    if loop.until is not None:
        b.store(going, b.let("not", loop.until), loc=loop.loc)
    return (*body, *loop.continuing, *b.pop())
