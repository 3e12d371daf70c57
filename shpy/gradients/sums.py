"""The derivatives that a sum over all elements needs: of a program's only output, by Params and by Tables.

Stage: above recording; for `shpy.fitting`. A Param has one derivative in each element. A Table has one for each read of
it: the place of the table's element, from 1 on, or 0 where the read did not run; and the derivative by its value:

    summed_leaves(error, [gain], [heights], …)     # error_gradient(uv, target) -> (value, d_gain, place, d_read)

Reads in loops are numbered, and a run gives the next ones from an input, `first`, on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Literal

from shpy.algebra import bound
from shpy.errors import RecordError
from shpy.gradients.functions import check_scalar, gradient_values
from shpy.gradients.programs import function_of, lifted, names_of
from shpy.ir.names import free
from shpy.ir.types import Base
from shpy.lang.data.tables import Table
from shpy.lang.data.textures import Texture
from shpy.lang.programs.joined import rerecorded
from shpy.lang.programs.outline import outlined
from shpy.lang.programs.record import RecordedProgram
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Layout, Leaf, flatten, layout_from
from shpy.lang.values.value import CLASSES
from shpy.passes.derivatives.table_reads import AT_ONCE, Reads, reads_in_loops

WHAT = "sh.value_and_gradient"


@dataclass(frozen=True)
class SummedLeaves:
    """A program whose outputs are the value, the leaves of each derivative by a Param, and two for each read.

    `layout` is that of the value and the derivatives by Params. `leaves` are the numbers of the table and of its leaf
    for each of `reads`. Where loops read tables, the input `first` is the number of the first of these reads that a run
    gives.
    """

    recorded: RecordedProgram
    layout: Layout
    reads: Reads
    leaves: list[tuple[int, int]]
    first: str | None

    def runs(self) -> Iterator[tuple[dict[str, int], int]]:
        """Yield for each run its inputs besides those of the program, and the number of the first read that counts."""
        for run in range(self.reads.runs):
            yield {} if self.first is None else {self.first: run * AT_ONCE}, self.reads.single if run else 0


def summed_leaves(
    recorded: RecordedProgram,
    params: Sequence[Any],
    tables: Sequence[str | Table],
    mode: Literal["forward", "reverse"],
    most: int | None,
) -> SummedLeaves:
    """Return the program of the derivatives by Params, and by Tables: the captured ones, and inputs by name."""
    names, uniforms = names_of(recorded, params) if params else ([], {})
    captured = [leaf for t in tables if isinstance(t, Table) for leaf in t.leaves("").values()]
    opened = lifted(recorded, uniforms, captured)
    looped = bool(tables) and reads_in_loops(opened.module, {t.name for t in opened.module.tables})
    first = free("first", opened.inputs) if looped else None
    types = dict(opened.inputs) if first is None else {**opened.inputs, first: Leaf(CLASSES["Attrib", 1, Base.I])}
    layouts: list[Layout] = []
    reads: list[Reads] = []
    moved: list[tuple[int, int]] = []

    def body(arguments: dict[str, Any]) -> Any:
        number = None if first is None else arguments.pop(first)
        outline = outlined(WHAT, function_of(opened, alone=True), (), arguments, names)
        check_scalar(WHAT, outline)
        leaf_places = {
            leaf: (k, n)
            for k, table in enumerate(tables)
            for n, leaf in enumerate(_table(arguments, table).leaves("").values())
        }
        declared = outline.frame.recording.tables
        moving = {name: leaf for name, leaf in declared.items() if leaf in leaf_places}
        derivatives = gradient_values(outline, WHAT, mode, most, value=True, tables=moving, first=number)
        reads.append(derivatives.reads)
        moved[:] = [leaf_places[moving[name]] for name in derivatives.reads.tables]
        _check_read(recorded, tables, {k for k, _ in moved})
        summed = (*derivatives.results, *derivatives.gradients)
        layouts[:] = [layout_from(summed, WHAT)]
        return (*flatten(layouts[0], summed, WHAT), *chain.from_iterable(derivatives.elements))

    name = f"{recorded.module.name}_gradient"
    flat = rerecorded(name, opened, types, None, body, opened.defaults)
    return SummedLeaves(bound(flat, uniforms), layouts[0], reads[0], moved, first)


def _table(arguments: dict[str, Any], table: str | Table) -> Table:
    """Return the table itself, or that of an input of this name, also of a texture."""
    argument = arguments[table] if isinstance(table, str) else table
    return argument.table if isinstance(argument, Texture) else argument


def _check_read(recorded: RecordedProgram, tables: Sequence[str | Table], read: set[int]) -> None:
    for k, table in enumerate(tables):
        if k not in read:
            name = table if isinstance(table, str) else table.name
            raise RecordError(
                f"{WHAT} by {name}: {recorded.module.name} does not depend on its elements, or in steps alone",
                loc=here(),
                cure=f"read {name} in the arithmetic of {recorded.module.name}, or leave it out",
            )
