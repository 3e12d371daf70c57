"""The functions of a module that need a shelter for a driver (`passes/nesting.py`).

Stage: emit, before printing. Mesa's llvmpipe keeps the conditions of 79 nested blocks, counting those of functions
called, and ignores any deeper ones without an error.
"""

from __future__ import annotations

from typing import Final

from shpy.errors import CompileError
from shpy.ir.nodes import Call, Loop, Module
from shpy.ir.traverse import walk
from shpy.passes.nesting import ALL, NONE, RETURNS, depth_of

MAX_NESTING: Final = 72
"""A depth that is certain to be right: the driver adds a few of its own."""

_MANY: Final = 24
_MANY_WITH_LOOPS: Final = 8
"""Depth, and number of loops, from which llvmpipe's time of compiling doubles with each loop that nests."""


def sheltered_functions(module: Module) -> frozenset[str]:
    """Find the functions to put into a loop of one iteration; CompileError where even that nests too deep.

    Compiling takes long where the returns of functions nest, so they get a shelter early. Other exits nest in some
    versions of Mesa alone: these count for the greatest depth.
    """
    depths: dict[str, int] = {}
    deepest: dict[str, int] = {}
    loops: dict[str, int] = {}
    sheltered = set()
    for function in module.functions:
        name, body = function.name, function.body
        depth, inside = depth_of(body, depths, RETURNS, NONE), 1 + depth_of(body, depths, NONE, NONE)
        calls = [s.function for s in walk(body) if isinstance(s, Call)]
        loops[name] = sum(isinstance(s, Loop) for s in walk(body)) + sum(loops[c] for c in calls)
        many = _MANY if loops[name] <= _MANY_WITH_LOOPS else _MANY_WITH_LOOPS
        depths[name] = depth
        if depth > many and inside < depth:
            sheltered.add(name)
            depths[name] = inside
        inner = name in sheltered
        deepest[name] = inner + depth_of(body, deepest, NONE if inner else RETURNS, ALL)
        if deepest[name] > MAX_NESTING:
            raise CompileError(
                f"{deepest[name]} blocks inside each other, subroutines counted in; GLSL takes {MAX_NESTING}",
                loc=function.loc,
            )
    return frozenset(sheltered)
