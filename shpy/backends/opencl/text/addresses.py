"""Find reads of tables in loops whose index is the sum of a varying and a loop-invariant part.

Stage: emit. The compiler computes the address of the invariant part once, before the loop:

    records[row + side]   ->   (records + side)[row]          for a `side` that is made before the loop

The sum must not wrap, as addresses have 64 bits. A chain of dependent reads, as in a walk through a tree, gets shorter.

    steady_parts(function, Known(function))[read.value.id] == (row, side)
"""

from __future__ import annotations

from collections.abc import Mapping

from shpy.ir.nodes import Function, Let, Loop, Region
from shpy.ir.traverse import regions_of
from shpy.passes.known import Known


def steady_parts(function: Function, known: Known) -> Mapping[int, tuple[int, int]]:
    """Return the changing and the steady part of the index of each read that has both, by the value that is read."""
    finder = _Finder(known)
    finder.visit(function.body, 0)
    return finder.found


class _Finder:
    def __init__(self, known: Known) -> None:
        self.known = known
        self.found: dict[int, tuple[int, int]] = {}
        self.lets: dict[int, Let] = {}
        self.loop_of: dict[int, int] = {}
        """The innermost loop in which a value is made; 0 outside all loops."""
        self.loops = 0

    def visit(self, region: Region, loop: int) -> None:
        """Visit the statements of a region in this loop."""
        for s in region:
            if isinstance(s, Let):
                self.lets[s.value.id] = s
                self.loop_of[s.value.id] = loop
                if s.op == "table" and loop and s.value.type.size != 3:  # three lie packed, behind a pointer to scalars
                    self.split(s, loop)
            elif inner := regions_of(s):
                if isinstance(s, Loop):
                    self.loops += 1
                at = self.loops if isinstance(s, Loop) else loop
                for each in inner:
                    self.visit(each, at)

    def split(self, read: Let, loop: int) -> None:
        """Split the index of a read, if it is a scalar sum."""
        total = self.lets.get(read.args[0])
        if total is None or total.op != "add" or total.value.type.size > 1 or self.known.may_wrap(total):
            return
        # A value that is seen here is made in this loop or in one around it.
        inside = [self.loop_of.get(a, 0) == loop for a in total.args]
        if any(inside) and not all(inside):
            changing, steady = total.args if inside[0] else total.args[::-1]
            if changing in self.lets and "const" not in (self.lets[changing].op, self._op(steady)):
                self.found[read.value.id] = changing, steady

    def _op(self, value: int) -> str:
        let = self.lets.get(value)
        return "" if let is None else let.op
