"""Reads of tables that the derivative is taken by: reverse mode gives the place and the bar of each.

Stage: improve; for `reverse`. The bar of a table has as many components as the table, and an element of a run reads a
few of these. So a read gives two outputs, and the caller adds the bars up over all elements of the run:

    %3 = table heights[%2]      ->      store $place_heights = 1 + clamp(%2, 0, size - 1); store $bar_heights = %bar_3

Places count the elements along all axes from 1 on, and 0 stands for a read that did not run, since outputs start as 0.
Reads in loops are counted while the function runs backwards. A run gives `AT_ONCE` of them, from the one numbered
`first` on, which is an input, so the caller runs the function again for the next ones:

    in a loop, %3 = table heights[%2]    ->    store $places[$count - %first] = …; store $bars[$count - %first] = %bar_3

A store out of range is dropped.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from shpy.ir.nodes import Let, Loop, Module, Region, Value, Variable
from shpy.ir.traverse import callee_of, calls_of, walk
from shpy.ir.types import Base, vec
from shpy.passes.derivatives.linear import Live, TangentBuilder

AT_ONCE = 16
"""The most reads of a table in loops for which a run gives outputs.

Each read has two, and OpenCL promises 1,024 bytes of arguments, 128 pointers. A step of 256 reads in a loop takes .65 s
of CPU with 16 or 8, .43 with 32, which leaves room for two tables (`python -m benchmarks --only fitting`).
"""

_INT = vec(Base.I)


@dataclass
class _LoopReads:
    """The reads of a table in loops: how many may run, and slots for the count and for those that a run gives."""

    most: int
    count: Variable
    places: Variable
    bars: Variable


@dataclass(frozen=True)
class Reads:
    """The tables of a function's reads: the `single` ones outside of loops, then those in loops, which take `runs`."""

    tables: tuple[str, ...] = ()
    single: int = 0
    runs: int = 1


class TableReads:
    """The reads of a function, while it is made: the table of each, and the outputs for its place and its bar."""

    def __init__(self, b: TangentBuilder) -> None:
        self.b = b
        self.times = 1
        """The most times that the present statement runs."""
        self._tables: list[str] = []
        self._outputs: list[Variable] = []
        self._in_loops: dict[str, _LoopReads] = {}
        self._first: Value | None = None
        self.reads = Reads()

    def add(self, table: str, place: Value, bar: Value) -> None:
        """Add a read."""
        if self.times > 1:
            self._add_in_loop(table, place, bar)
        else:
            for slot, v in zip(self._new_outputs(table, bar), (place, bar), strict=True):
                self.b.store(slot, v)

    def finish(self) -> list[Variable]:
        """Append stores of the outputs for reads in loops; return all outputs and set `reads`."""
        b, single, runs = self.b, len(self._tables), 1
        for table, reads in self._in_loops.items():
            runs = max(runs, -(-reads.most // AT_ONCE))
            for k in range(min(reads.most, AT_ONCE)):
                at = b.const(_INT, [k])
                for slot, array in zip(self._new_outputs(table, reads.bars), (reads.places, reads.bars), strict=True):
                    b.store(slot, b.load(array, at))
        self.reads = Reads(tuple(self._tables), single, runs)
        return self._outputs

    def place_of(self, table: str, index: Live) -> Value:
        """Return the place of the element at an index, which is clamped on each axis as in the read itself."""
        b = self.b
        shape = Live(b, b.let("table_size", type=index.type, attr=table))
        at: Any = index[0].op("clamp", 0, shape[0] - 1)
        for k in range(1, index.size):
            at = at * shape[k] + index[k].op("clamp", 0, shape[k] - 1)
        place: Live = at + 1
        return place.value

    def _new_outputs(self, table: str, bar: Value | Variable) -> list[Variable]:
        """Return outputs for the place and the bar of a read."""
        b = self.b
        slots = [b.variable(_INT, None, f"place_{table}", b.loc), b.variable(bar.type, None, f"bar_{table}", b.loc)]
        del b.variables[-2:]  # they become outputs
        self._tables.append(table)
        self._outputs += slots
        return slots

    def _add_in_loop(self, table: str, place: Value, bar: Value) -> None:
        b = self.b
        if table not in self._in_loops:
            self._in_loops[table] = _LoopReads(
                0,
                b.variable(_INT, None, f"reads_{table}"),
                b.variable(_INT, AT_ONCE, f"places_{table}"),
                b.variable(bar.type, AT_ONCE, f"bars_{table}"),
            )
        if self._first is None:
            self._first = b.input(_INT, "first")
        reads = self._in_loops[table]
        reads.most += self.times
        number = b.load(reads.count)
        at = b.let("sub", number, self._first)
        b.store(reads.places, place, index=at)
        b.store(reads.bars, bar, index=at)
        b.store(reads.count, b.let("add", number, b.const(_INT, [1])))


def reads_in_loops(module: Module, tables: Collection[str]) -> set[str]:
    """Return the functions of a module in which a loop reads one of the tables, itself or by a call."""
    reading: set[str] = set()
    looped: set[str] = set()
    for f in module.functions:
        if _reads(f.body, tables, reading):
            reading.add(f.name)
        loops = tuple(s for s in walk(f.body) if isinstance(s, Loop))
        if _reads(loops, tables, reading) or any(name in looped for name in calls_of(f)):
            looped.add(f.name)
    return looped


def _reads(region: Region, tables: Collection[str], functions: Collection[str]) -> bool:
    """Return whether statements read one of the tables, or call one of the functions."""
    return any(
        (isinstance(s, Let) and s.op == "table" and s.attr in tables) or callee_of(s) in functions for s in walk(region)
    )
