"""Remove the values of params and the shapes of tables, so that programs that differ only in these share a kernel.

Stage: improve, before a kernel is compiled. A run passes the values and shapes:

    param sky: Color f3 = (0.2, 0.4, 1.0)   ->   param sky: Color f3 = (0.0, 0.0, 0.0)
    table heights: f[64, 64]                ->   table heights: f[?, ?]
    table steps: f[40]                      ->   table steps: f[8]              (read at `%i & 7`: at least 8)

A shape that the program reads by `table_size` stays, since `fold` makes it a constant. If an index of a table with one
axis is known to be in range, the least size for which it is in range stays, so that printers can omit the clamp.
"""

from __future__ import annotations

from dataclasses import replace

from shpy.ir.metadata import NOTHING
from shpy.ir.nodes import Let, Module
from shpy.ir.traverse import walk
from shpy.passes.known import Known


def forget_data(module: Module) -> Module:
    """Return the module with only those shapes of tables that the kernel's text depends on.

    Params lose their values and metadata.
    """
    sizes = {table.name: table.size for table in module.tables}
    kept: dict[str, tuple[int, ...]] = {}
    for function in module.functions:
        ranges = Known(function)
        for let in walk(function.body):
            if not isinstance(let, Let) or let.op not in ("table", "table_size"):
                continue
            name = str(let.attr)
            size = sizes[name]
            if size is None:
                continue
            if let.op == "table_size":
                kept[name] = size
            elif len(size) == 1:
                low, high = ranges.span(let.args[0])
                if 0 <= low and high < size[0]:
                    kept[name] = (max(high + 1, *kept.get(name, (0,))),)
    params = tuple(replace(p, value=(0,) * len(p.value), about=NOTHING) for p in module.params)
    tables = tuple(replace(t, size=kept.get(t.name)) for t in module.tables)
    return replace(module, params=params, tables=tables)
