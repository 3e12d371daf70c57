"""Forget the values of params and the shapes of tables, so that programs that differ in nothing else are one kernel.

Stage: improve, before a kernel is compiled. A run brings the values and shapes along:

    param sky: Color f3 = (0.2, 0.4, 1.0)   ->   param sky: Color f3 = (0.0, 0.0, 0.0)
    table heights: f[64, 64]                ->   table heights: f[?, ?]

A shape that the program asks for stays: `fold` writes it into the text.
"""

from __future__ import annotations

from dataclasses import replace

from shpy.ir.nodes import Let, Module
from shpy.ir.traverse import walk

__all__ = ["forget_data"]


def forget_data(module: Module) -> Module:
    """The module without initial values, and without shapes that no operation asks for."""
    statements = (s for function in module.functions for s in walk(function.body))
    asked = {s.attr for s in statements if isinstance(s, Let) and s.op == "table_size"}
    params = tuple(replace(p, value=(0,) * len(p.value)) for p in module.params)
    tables = tuple(t if t.name in asked else replace(t, size=None) for t in module.tables)
    return replace(module, params=params, tables=tables)
