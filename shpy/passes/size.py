"""How much a module does: its operations counted, for reports.

Stage: improve; it changes nothing. A loop's body counts once.

    count_ops(module)    ->   {"mul": 12, "add": 9, "load": 3, "if": 2, "loop": 1, "store": 4, ...}
"""

from __future__ import annotations

from collections import Counter

from shpy.ir.nodes import Let, Module
from shpy.ir.traverse import walk

__all__ = ["count_ops"]


def count_ops(module: Module) -> dict[str, int]:
    """How often each operation and each kind of statement stands in the module, most frequent first."""
    counted: Counter[str] = Counter()
    for function in module.functions:
        for s in walk(function.body):
            counted[s.op if isinstance(s, Let) else type(s).__name__.lower()] += 1
    return dict(counted.most_common())
