"""One text of a target: the names that its functions share, and the needs of each besides its arguments.

Stage: emit. A `Unit` is one text of a target. Where a target has no globals, a function is handed the tables, uniforms
and place in the grid that it and those that it calls read.

    needs_of(module)["shade"]   # Needs(tables={"noise"}, params={"gain"}, grid={"grid_index"}, ranks={2})
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from shpy.backends.emit.names import Names, Target
from shpy.backends.emit.survey import changed_variables
from shpy.ir.nodes import Call, Function, Let, Module, Return, Store
from shpy.ir.traverse import walk


@dataclass(frozen=True, slots=True)
class Needs:
    """Names of tables and params, of `grid_index` and `grid_shape`, and the ranks of these."""

    tables: frozenset[str] = frozenset()
    params: frozenset[str] = frozenset()
    grid: frozenset[str] = frozenset()
    ranks: frozenset[int] = frozenset()

    def __or__(self, other: Needs) -> Needs:
        return Needs(
            self.tables | other.tables, self.params | other.params, self.grid | other.grid, self.ranks | other.ranks
        )


class Unit:
    """One text: the module, and the names of what is global in it."""

    target: ClassVar[Target]

    def __init__(self, module: Module) -> None:
        self.module = module
        self.callees = {f.name: f for f in module.functions}
        self.globals = Names(self.target)
        self.functions: dict[str, str] = {}
        """The name in the text of each function of the module."""
        self.leaves_loops = True
        """True if the driver leaves loops when the conditions of their exits hold."""


def needed_by(let: Let) -> Needs | None:
    """Return what an operation reads that is not its function's; None for nothing."""
    match let.op:
        case "table" | "table_size" | "neighbour":
            return Needs(tables=frozenset({str(let.attr)}))
        case "param":
            return Needs(params=frozenset({str(let.attr)}))
        case "grid_index" | "grid_shape":
            return Needs(grid=frozenset({let.op}), ranks=frozenset({let.value.type.size}))
    return None


def needs_of(module: Module, needed: Callable[[Let], Needs | None] = needed_by) -> dict[str, Needs]:
    """Return what each function of a module needs, by its name; `needed` tells what one operation does."""
    found: dict[str, Needs] = {}
    for function in module.functions:  # callees come first
        needs = Needs()
        for s in walk(function.body):
            match s:
                case Let(_, "call", _, str(name)) | Call(name):
                    needs |= found[name]
                case Let() if (own := needed(s)) is not None:
                    needs |= own
        found[function.name] = needs
    return found


def leaves_early(function: Function) -> bool:
    """Return whether a Return stands anywhere but at the function's end."""
    return any(isinstance(s, Return) for s in walk(function.body) if s is not function.body[-1])


def direct_outputs(entry: Function, callees: Mapping[str, Function]) -> frozenset[int]:
    """Return the outputs that are stored once, at the top of the body, and touched by nothing else: no variable."""
    touched: Counter[int] = Counter()
    for s in walk(entry.body):
        if isinstance(s, Let):
            if s.op == "load" and isinstance(s.attr, int):
                touched[s.attr] += 1
        else:
            touched.update(changed_variables(s, callees))
    whole = {s.variable for s in entry.body if isinstance(s, Store) and s.components is None and s.index is None}
    return frozenset(o.id for o in entry.outputs if o.id in whole and touched[o.id] == 1)
