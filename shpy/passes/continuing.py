"""Move a loop's `continuing` part, which may not contain exits, into the loop's body, which may.

Stage: improve; for `exits` and `inline`, when an element may end in the `continuing` part.

    loop {                              loop {
      if %c { continue }                  store $left = false
      if %d { break }                     loop turns 1 {
      ...                                   if %c { break }
    } continuing {               ->         if %d { store $left = true; break }
      A                                     ...; break
    } until %e                            }
                                          if $left { break }
                                          A
                                        } until %e

In a loop without a Continue, A simply follows the body.
"""

from __future__ import annotations

from shpy.ir.builder import Builder
from shpy.ir.nodes import Break, Continue, If, Loop, Region, Stmt
from shpy.ir.traverse import continues
from shpy.ir.types import Base, vec
from shpy.passes.rewriter import falls_through, map_exits


def without_continuing(b: Builder, loop: Loop) -> Loop:
    """Return the loop with an empty `continuing`; `b` builds its function, and inner Loops stay the same objects."""
    if not continues(loop):
        if not falls_through(loop.body):
            return Loop(loop.body, (), None, loop.turns, loop.loc)
        return Loop(loop.body + loop.continuing, (), loop.until, loop.turns, loop.loc)
    return in_one_iteration(b, loop)


def in_one_iteration(b: Builder, loop: Loop) -> Loop:
    """Return the loop with its body in a loop of one iteration, which all of its exits leave; `b` as above.

    Without a Continue, `continuing` and `until` may read values of the body: then they belong to the inner loop, too.
    """
    if not continues(loop):
        plain = without_continuing(b, loop)
        last = () if plain.until is None else (If(plain.until, (Break(loop.loc),), (), loop.loc),)
        loop = Loop((*plain.body, *last), (), None, loop.turns, loop.loc)
    left = b.variable(vec(Base.B), name="left")

    def leave(s: Stmt) -> Region:
        b.push()
        if isinstance(s, Break):
            b.store(left, b.const(left.type, [True]), loc=s.loc)
        b.append(Break(s.loc) if isinstance(s, Continue) else s)
        return b.pop()

    b.push()
    b.store(left, b.const(left.type, [False]))
    body = map_exits(loop.body, leave)
    if falls_through(body):
        body = (*body, Break(loop.loc))
    b.append(Loop(body, (), None, 1, loop.loc))
    with b.when(b.load(left)):
        b.exit(Break)
    b.extend(loop.continuing)
    return Loop(b.pop(), (), loop.until, loop.turns, loop.loc)
