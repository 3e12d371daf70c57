"""What stands around the statements of a printed text: its imports, and the arguments of its functions.

Stage: emit. Part of the numpy printer.
"""

from __future__ import annotations

import re

from shpy.backends.numpy.operations import Imports
from shpy.ir.nodes import Call, Let, Module
from shpy.ir.traverse import walk

__all__ = ["LANES", "asked_by", "components_of", "imports_of"]

LANES = "lanes", ""
"""What a function asks for that needs the number of lanes."""


def imports_of(use: Imports, texts: list[str]) -> str:
    """The lines that import what the texts call: not all that was asked for is still in them."""
    lines = [line.split("  # ")[0] for text in texts for line in text.splitlines()]
    called = {word for line in lines for word in re.findall(r"\w+", line)}
    head = ["import numpy as np"]
    for source, imported in (("shpy.backends.numpy.lanes", use.lanes), ("shpy.ir.meaning", use.meaning)):
        if imported & called:
            head += [""] * (len(head) == 1) + [f"from {source} import {', '.join(sorted(imported & called))}"]
    return "\n".join(head)


def asked_by(module: Module) -> dict[str, list[tuple[str, str]]]:
    """What each function needs besides its inputs, for itself and for those that it calls."""
    ops = {"param": "param", "table": "table", "table_size": "table", "neighbour": "table"}
    order = [("param", p.name) for p in module.params] + [("table", t.name) for t in module.tables]
    order += [("place", ""), ("grid_index", ""), ("grid_shape", "")]
    asked: dict[str, list[tuple[str, str]]] = {}
    for function in module.functions:  # callees come first
        lets = [s for s in walk(function.body) if isinstance(s, Let)]
        found = {("place", "") for s in lets if s.op == "neighbour"}
        found |= {(ops.get(s.op, s.op), str(s.attr or "")) for s in lets}
        found |= {key for s in lets if s.op == "call" for key in asked[str(s.attr)]}
        found |= {key for s in walk(function.body) if isinstance(s, Call) for key in asked[s.function]}
        asked[function.name] = [key for key in order if key in found]
        if not function.pure:
            asked[function.name].append(LANES)
    return asked


def components_of(components: tuple[int, ...]) -> str:
    """The index of some components."""
    if len(components) == 1:
        return str(components[0])
    first, last = components[0], components[-1]
    return f"{first}:{last + 1}" if components == tuple(range(first, last + 1)) else str(list(components))
