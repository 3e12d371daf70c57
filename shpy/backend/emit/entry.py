"""One text of a target: the names that its functions share, and the global values that each function reads.

Stage: emit. A `Unit` is one text of a target. Where a target has no globals, a function is handed the tables, uniforms
and place in the grid that it and those that it calls read.

    needs_of(module, needed_by)["shade"]   # {("table", "noise"), ("param", "gain"), ("grid_index", "")}
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from shpy.backend.emit.names import Names, Target
from shpy.ir.nodes import Let, Module
from shpy.ir.traverse import callee_of, walk

Need = tuple[str, str]
"""A need of a function: ("table", its name), ("param", its name), or ("grid_index", "") and its kin."""
Needs = frozenset[Need]


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


def needed_by(let: Let) -> Needs:
    """Return the values from outside its function that an operation reads."""
    match let.op:
        case "table" | "table_size" | "neighbour":
            return frozenset({("table", str(let.attr))})
        case "param" | "grid_index" | "grid_line" | "grid_shape":
            return frozenset({(let.op, str(let.attr or ""))})
    return frozenset()


def needs_of(module: Module, needed: Callable[[Let], Needs]) -> dict[str, Needs]:
    """Return the needs of each function of a module, by its name; `needed` gives those of one operation."""
    needs_by_name: dict[str, Needs] = {}
    for function in module.functions:  # callees come first
        needs: set[Need] = set()
        for s in walk(function.body):
            callee = callee_of(s)
            if callee is not None:
                needs |= needs_by_name[callee]
            elif isinstance(s, Let):
                needs |= needed(s)
        needs_by_name[function.name] = frozenset(needs)
    return needs_by_name
