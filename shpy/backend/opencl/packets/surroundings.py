"""The offsets around a packet at which a kernel reads its tables.

Stage: emit. Where all of them are known, the kernel asks once for a packet whether its neighbours are in range.

    surroundings(entry, tables)         # {"u": [(-1, 1), (-1, 1)]} for a stencil of five points
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from shpy.ir.constants import decode
from shpy.ir.nodes import Function, Let, Table
from shpy.ir.traverse import walk

_FAR: Final = 1 << 16
"""The largest offset of a neighbour for which no index beside a packet can wrap around."""


def surroundings(entry: Function, tables: Mapping[str, Table]) -> dict[str, list[tuple[int, int]]]:
    """Return for each table the least and the largest offset on both axes at which the entry reads neighbours.

    It is {} unless all of these reads are of scalars at constants that are not far; if modulo anything, then modulo the
    shape of the grid or of the table.
    """
    values = {s.value.id: s for s in walk(entry.body) if isinstance(s, Let)}

    def is_extent(modulus: Let | None, axis: int, table: str) -> bool:
        if modulus is None or modulus.op != "swizzle" or modulus.attr != (axis,):
            return False
        whole = values.get(modulus.args[0])
        return whole is not None and (whole.op == "grid_shape" or (whole.op, whole.attr) == ("table_size", table))

    around: dict[str, list[tuple[int, int]]] = {}
    for s in values.values():
        if s.op == "neighbour":
            table = tables[str(s.attr)]
            by, moduli = [[values.get(a) for a in args] for args in (s.args[:2], s.args[2:])]
            numbers = [b for b in by if b is not None and b.op == "const"]
            offsets = [decode(b.value.type, b.attr)[0] for b in numbers if isinstance(b.attr, tuple)]
            if table.rank != 2 or table.type.size > 1 or len(offsets) < 2 or max(map(abs, offsets)) > _FAR:
                return {}
            if not all(is_extent(m, axis, table.name) for axis, m in enumerate(moduli)):
                return {}
            spans = around.get(table.name, [(o, o) for o in offsets])
            around[table.name] = [(min(a, o), max(b, o)) for (a, b), o in zip(spans, offsets, strict=True)]
    return around
