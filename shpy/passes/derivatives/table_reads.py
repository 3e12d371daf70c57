"""Reads of tables that the derivative is taken by: reverse mode gives the place and the bar of each.

Stage: improve; for `reverse`. The bar of a table has as many components as the table, and an element of a run reads a
few of these. So a read gives two outputs, and the caller adds the bars up over all elements of the run:

    %3 = table heights[%2]      ->      store $place_heights = 1 + clamp(%2, 0, size - 1); store $bar_heights = %bar_3

Places count the elements along all axes from 1 on, and 0 stands for a read that did not run, since outputs start as 0.
The number of reads has to be known, so a loop has none.
"""

from __future__ import annotations

from typing import Any

from shpy.errors import RecordError
from shpy.ir.nodes import Value, Variable
from shpy.passes.derivatives.linear import Live, TangentBuilder


class TableReads:
    """The reads of a function: the table of each, and the outputs for its place and its bar."""

    def __init__(self, b: TangentBuilder) -> None:
        self.b = b
        self.tables: list[str] = []
        self.outputs: list[Variable] = []
        self.loops = 0
        """The number of loops around the present statement."""

    def add(self, table: str, place: Value, bar: Value) -> None:
        """Add a read; RecordError in a loop."""
        b = self.b
        if self.loops:
            raise RecordError(
                f"the gradient by {table} takes an output for each read, and this read is in a loop",
                loc=b.loc,
                cure="a loop of Python, for k in range(n), which repeats the read; or the read outside of the loop",
            )
        for name, v in (("place", place), ("bar", bar)):
            slot = b.variable(v.type, None, f"{name}_{table}", b.loc)
            b.variables.pop()  # it becomes an output
            b.store(slot, v)
            self.outputs.append(slot)
        self.tables.append(table)

    def place_of(self, table: str, index: Live) -> Value:
        """Return the place of the element at an index, which is clamped on each axis as in the read itself."""
        b = self.b
        shape = Live(b, b.let("table_size", type=index.type, attr=table))
        at: Any = index[0].op("clamp", 0, shape[0] - 1)
        for k in range(1, index.size):
            at = at * shape[k] + index[k].op("clamp", 0, shape[k] - 1)
        place: Live = at + 1
        return place.value
