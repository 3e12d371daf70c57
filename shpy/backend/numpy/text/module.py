"""The Python module of a vectorised module: a tile of lanes is one call of its entry.

Stage: emit. Takes a module from `vectorize`; returns the text and the names of the arguments of its entry.

    def mandelbrot(c, lanes):
        z = np.zeros((2, lanes), np.float32)
        n = np.float32(0.0)
        ...
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from shpy.backend.emit import tree
from shpy.backend.emit.spell_python import PythonSpeller
from shpy.backend.numpy import lanes as lane_functions
from shpy.backend.numpy.text.body import PythonBody
from shpy.backend.numpy.text.naming import Updates
from shpy.backend.numpy.text.operations import EXACT, MEANINGS, PythonUnit
from shpy.ir.nodes import Function
from shpy.ir.traverse import defined
from shpy.passes.calls import LaneFacts
from shpy.passes.vectorize import VectorModule

_LANE_NAMES: Final = frozenset(lane_functions.__all__)
_SOURCES: Final = {"shpy.backend.numpy.lanes": _LANE_NAMES, "shpy.ir": EXACT, "shpy.ir.meaning": MEANINGS - _LANE_NAMES}
"""The modules from which a text may import, with the names that it may import from each."""


@dataclass(frozen=True, slots=True)
class PrintedModule:
    """The text. `entry` is called with the inputs' tiles, then with what `arguments` lists, all by position.

    An argument is `("param", name)`, `("table", name)`, or `("place" | "grid_index" | "grid_shape" | "lanes", "")`.
    `large`: many lanes are to run together, for they leave loops one by one, and those that are left should still be
    many; or no function is called, so that few arrays live at a time, and numpy reuses temporaries of 256 KiB.
    """

    text: str
    entry: str
    arguments: tuple[tuple[str, str], ...]
    large: bool


def print_python(vector: VectorModule, *, exact: frozenset[str] = frozenset()) -> PrintedModule:
    """Return the module's text; functions named in `exact` are rounded correctly."""
    module, unit, speller = vector.module, PythonUnit(vector.module, exact), PythonSpeller()
    compacts = False
    for function in module.functions:
        facts = _all_of(function) if function.pure else vector.facts[function.name]
        updates = Updates(function, facts) if function is module.entry else None
        body = PythonBody(unit, function, facts, updates)
        parameters = tuple([tree.Parameter(p.type, p.text) for p in body.parameters()])
        block = body.function_block()
        speller.function(tree.Function(unit.functions[function.name], None, parameters, block))
        compacts |= body.compacts
    called = {name.partition(".")[0] for name in speller.called}
    imports = [f"from {source} import {', '.join(sorted(exports & called))}"
               for source, exports in _SOURCES.items() if exports & called]  # fmt: skip
    head = ["import numpy as np", *[""] * bool(imports), *imports]
    text = "\n".join([*head, *speller.lines]) + "\n"
    entry = module.entry.name
    return PrintedModule(text, unit.functions[entry], tuple(unit.handed[entry]), len(module.functions) == 1 or compacts)


def _all_of(function: Function) -> LaneFacts:
    """Return the facts of a pure function: its arguments may vary, and so may all that it computes."""
    slots = (*function.outputs, *function.variables)
    return LaneFacts(frozenset(v.id for v in defined(function)), frozenset(v.id for v in slots))
