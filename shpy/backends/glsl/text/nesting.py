"""The depth to which a module's blocks nest for a driver, and the functions that need a shelter.

Stage: emit, before printing. Mesa's llvmpipe keeps the conditions of 79 nested blocks, counting those of functions
called, and ignores any deeper ones without an error. For llvmpipe the code after an early return nests, too:

    if (a) { return; }              if (a) { } else {
    if (b) { return; }      is          if (b) { } else { ... } }
    ...

Inside a loop it does not, for there a return is a break. So a function with too many returns is put into a loop of
one iteration: that is its shelter.
"""

from __future__ import annotations

from typing import Final

from shpy.errors import CompileError
from shpy.ir.nodes import Call, If, Loop, Module, Region, Return, Stmt
from shpy.ir.traverse import regions_of, walk

MAX_NESTING: Final = 72
"""A depth that is certain to be right: the driver adds a few of its own."""

_MANY: Final = 24
_MANY_WITH_LOOPS: Final = 8
"""Depth, and number of loops, from which llvmpipe's time of compiling doubles with each loop that nests."""


def sheltered_functions(module: Module) -> frozenset[str]:
    """Find the functions to put into a loop of one iteration; CompileError where even that nests too deep."""
    depths: dict[str, int] = {}
    loops: dict[str, int] = {}
    sheltered = set()
    for function in module.functions:
        depth = _depth(function.body, depths, returns_nest=True)
        inside = 1 + _depth(function.body, depths, returns_nest=False)
        calls = [s.function for s in walk(function.body) if isinstance(s, Call)]
        loops[function.name] = sum(isinstance(s, Loop) for s in walk(function.body)) + sum(loops[c] for c in calls)
        many = _MANY if loops[function.name] <= _MANY_WITH_LOOPS else _MANY_WITH_LOOPS
        if depth > many and inside < depth:
            sheltered.add(function.name)
            depth = inside
        if depth > MAX_NESTING:
            raise CompileError(
                f"{depth} blocks inside each other, subroutines counted in; GLSL takes {MAX_NESTING}", loc=function.loc
            )
        depths[function.name] = depth
    return frozenset(sheltered)


def _depth(region: Region, depths: dict[str, int], *, returns_nest: bool) -> int:
    """Return how deep the region's blocks nest, counting the blocks of the functions that it calls."""
    deepest = before = 0
    for s in region:
        inner = depths[s.function] if isinstance(s, Call) else 0
        if isinstance(s, If | Loop):
            nest = returns_nest and not isinstance(s, Loop)
            inner = 1 + max(_depth(r, depths, returns_nest=nest) for r in regions_of(s))
        deepest = max(deepest, before + inner)
        before += returns_nest and _returns(s)
    return deepest


def _returns(statement: Stmt) -> bool:
    return any(isinstance(s, Return) for r in regions_of(statement) for s in walk(r))
