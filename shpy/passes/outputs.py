"""Remove outputs of a module, and the code that only they need.

Stage: improve.

    select_outputs(module, [0, 2])         outputs a, b, c        ->   outputs a, c; what only b needed is gone
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from shpy.ir.nodes import Module
from shpy.passes.dead import remove_dead
from shpy.passes.dead_stores import remove_dead_stores


def select_outputs(module: Module, indices: Sequence[int]) -> Module:
    """Return the module with the outputs `indices` of its entry, in this order, without code for the others.

    The entry's last output may be the status, which has no port: its index, if given, must be the last.
    """
    entry = module.entry
    outputs = tuple(entry.outputs[i] for i in indices)
    others = tuple(o for i, o in enumerate(entry.outputs) if i not in set(indices))
    ports = tuple(module.outputs[i] for i in indices if i < len(module.outputs))
    fewer = replace(entry, outputs=outputs, variables=(*entry.variables, *others))
    selected = replace(module, outputs=ports, functions=(*module.functions[:-1], fewer))
    return remove_dead(remove_dead_stores(remove_dead(selected)))
