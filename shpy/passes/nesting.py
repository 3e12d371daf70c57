"""The depth to which blocks nest for a driver, and loops of one iteration that keep it small.

Stage: improve; the GLSL printer measures the depth again. Mesa makes a condition of each block, and nests in it what
follows an exit, but for loops that it cannot take apart:

    if (a) { continue; }            if (a) { } else {
    if (b) { continue; }    is          if (b) { } else { ... } }
    ...

A shelter is such a loop: it has one iteration, and an end that the driver cannot derive. `shelter_loops` puts the body
of a loop with many exits into one, and the GLSL printer a function with many returns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from shpy.errors import CompileError
from shpy.ir.builder import Builder
from shpy.ir.nodes import Break, Call, Continue, Function, If, Loop, Module, Region, Return, Stmt
from shpy.ir.traverse import regions_of, walk
from shpy.passes.continuing import in_one_iteration
from shpy.passes.rewriter import falls_through

Kinds = frozenset[type[Stmt]]
"""Kinds of exits."""

NONE: Final[Kinds] = frozenset()
RETURNS: Final[Kinds] = frozenset({Return})
ALL: Final[Kinds] = frozenset({Return, Break, Continue})
_FEW: Final = 8
"""The most exits of a loop that has no shelter."""
MAX_NESTING: Final = 72
"""A depth that is certain to be right: llvmpipe keeps the conditions of 79 blocks, and ignores deeper ones silently."""

_MANY: Final = 24
_MANY_WITH_LOOPS: Final = 8
"""Depth, and number of loops, from which llvmpipe's time of compiling doubles with each loop that nests."""


def depth_of(region: Region, depths: Mapping[str, int], exits: Kinds, in_loops: Kinds) -> int:
    """Return how deep the region's blocks nest, counting the blocks of the functions that it calls (`depths`).

    The kinds of `exits` nest what follows them, and in loops those of `in_loops`; in a shelter no exit does.
    """
    deepest = before = 0
    for s in region:
        if isinstance(s, If | Loop):
            kinds = exits if isinstance(s, If) else NONE if is_shelter(s) else in_loops
            inner = 1 + max(depth_of(r, depths, kinds, in_loops) for r in regions_of(s))
            deepest = max(deepest, before + inner)
            before += bool(exits) and any(type(s) in exits for s in _exits(s))
        elif isinstance(s, Call):
            deepest = max(deepest, before + depths[s.function])
    return deepest


def is_shelter(loop: Loop) -> bool:
    """Return whether the loop has many exits, and one iteration that ends with some of them."""
    return loop.turns == 1 and not falls_through(loop.body) and _count_exits(loop) > _FEW


def shelter_loops(module: Module, most: int, few: int = _FEW) -> Module:
    """Return the module with shelters in loops with more than `few` exits, where blocks nest deeper than `most`."""
    depths: dict[str, int] = {}
    functions = []
    for function in module.functions:
        depth = depth_of(function.body, depths, NONE, ALL)
        if depth > most:
            function = _sheltered(function, few)
            depth = depth_of(function.body, depths, NONE, ALL)
        depths[function.name] = depth
        functions.append(function)
    return replace(module, functions=tuple(functions))


def _sheltered(function: Function, few: int) -> Function:
    b = Builder(function=function)

    def sheltered(region: Region) -> Region:
        b.push()
        for s in region:
            if isinstance(s, If):
                s = replace(s, then=sheltered(s.then), orelse=sheltered(s.orelse))
            elif isinstance(s, Loop):
                s = replace(s, body=sheltered(s.body))
                s = in_one_iteration(b, s) if _count_exits(s) > few else s
            b.append(s)
        return b.pop()

    b.extend(sheltered(function.body))
    return b.finish()


def _count_exits(loop: Loop) -> int:
    return sum(len(_exits(s)) for s in loop.body)


def _exits(statement: Stmt) -> list[Stmt]:
    """Return the exits in a statement that leave the region around it: of the loops in it their Returns alone."""
    if isinstance(statement, Loop):
        return [s for r in regions_of(statement) for s in walk(r) if isinstance(s, Return)]
    if isinstance(statement, If):
        return [exit for r in regions_of(statement) for s in r for exit in _exits(s)]
    return [statement] if type(statement) in ALL else []


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
