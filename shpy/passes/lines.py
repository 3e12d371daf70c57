"""Separate the index of a line from the index within the line, for packets that each lie in one line of the grid.

Stage: improve, before `vectorize`. All lanes of such a packet have the same index on every axis but the last, so that
values that depend on the line alone are computed once for a packet, as scalars:

    %1: i2 = grid_index                %1: i2 = grid_index
    %2: i = swizzle.x %1               %4: i = grid_line                    (one for all lanes)
    %3: i = swizzle.y %1        ->     %3: i = swizzle.y %1

A pure function has two forms, for arguments that all vary and for uniform ones. Where a statement calls it instead,
`vectorize` makes a form for each combination of them: `mixed` names the functions that gain from that, and `placed`
those that need it, because their results vary even if their arguments do not.

A picture of five octaves of noise takes 0.91 of its time on AVX-512. A compiler that finds splats behind conversions
and calls could do without; LLVM 15 moves them past single operations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from shpy.ir.constants import Base, vec
from shpy.ir.nodes import Let, Module
from shpy.ir.traverse import calls_of, is_straight, walk
from shpy.passes.rewriter import Rewriter

_SMALL: Final = 30
"""The most statements of a function that stays pure: few of them depend on a part of the arguments alone."""


def reads_lines(module: Module) -> bool:
    """Return whether a prepared module reads the index in a grid of two axes or more."""
    lets = [s for f in module.functions for s in walk(f.body) if isinstance(s, Let)]
    return any(s.op == "grid_index" and s.value.type.size > 1 for s in lets)


def placed(module: Module) -> frozenset[str]:
    """Return the names of the pure functions that read the grid's index, themselves or by their callees."""
    reading = _reading(module)
    return frozenset(f.name for f in module.functions if f.pure and f.name in reading)


def mixed(module: Module) -> frozenset[str]:
    """Return the names of the pure functions of which a part may depend on some of the arguments alone.

    Those that an `alone` function calls stay pure, since it computes with one lane.
    """
    of_lanes = {name for f in module.functions if f.alone for name in calls_of(f)}
    for f in reversed(module.functions):  # a function comes before those that call it
        if f.name in of_lanes:
            of_lanes.update(calls_of(f))
    return frozenset(
        f.name
        for f in module.functions
        if f.pure and is_straight(f.body) and len(f.body) > _SMALL and sum(i.type.size for i in f.inputs) > 1
    ).difference(of_lanes)


def together(module: Module) -> Module:
    """Return the module in which no function that reads the index, itself or by its callees, is `alone`.

    The index is that of a packet; a lane would have to be given its own.
    """
    reading = _reading(module)
    alone = {f.name for f in module.functions if f.alone}
    if alone.isdisjoint(reading):
        return module
    functions = (replace(f, alone=False) if f.name in reading else f for f in module.functions)
    return replace(module, functions=tuple(functions))


def _reading(module: Module) -> set[str]:
    """Return the names of the functions that read the index, themselves or by their callees."""
    reading: set[str] = set()
    for f in module.functions:
        own = any(isinstance(s, Let) and s.op == "grid_index" for s in walk(f.body))
        if own or not reading.isdisjoint(calls_of(f)):
            reading.add(f.name)
    return reading


def in_lines(module: Module) -> Module:
    """Return a module of scalars that reads the index of an element's line as `grid_line`."""
    by_name = {f.name: f for f in module.functions}
    return replace(module, functions=tuple(_Lines(f, by_name).run() for f in module.functions))


class _Lines(Rewriter):
    """Rewrites the swizzles of one function."""

    def let(self, let: Let) -> None:
        index = self.lets.get(let.args[0]) if let.op == "swizzle" else None
        if index is None or index.op != "grid_index" or not isinstance(let.attr, tuple):
            self.emit(let)
            return
        axes = index.value.type.size - 1
        if axes in let.attr:
            self.emit(let)
        elif axes == 1:
            self.emit(Let(let.value, "grid_line"))
        else:
            line = self.make("grid_line", type=vec(Base.I, axes))
            self.emit(replace(let, args=(line,)))
