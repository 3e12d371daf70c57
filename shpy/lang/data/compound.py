"""Tables whose elements are structs or matrices: one table for each leaf, read at the same index.

Stage: record. The IR knows tables of scalars and vectors only; their names are those of the leaves.

    balls = sh.Table({"center": centers, "radius": radii}, Ball)      # tables balls.center, balls.radius
    balls[i].center
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from shpy.errors import ShpyTypeError
from shpy.lang.data.tables import Table, TableArgument, TableType
from shpy.lang.recording.location import here
from shpy.lang.recording.names import assigned_name
from shpy.lang.values.structure import Group, Layout, Leaf, build_values, flatten, layout_of, leaves


class CompoundTable(Table):
    """A Table of structs or matrices. Made by `sh.Table`."""

    def __init__(self, array: Any, type: Any, name: str | None = None) -> None:
        known = name if name is not None else assigned_name()
        layout = layout_of(type, "an element")
        what = f"the Table {known}" if known else "a Table"
        entries = flatten(layout, array, what)
        parts = [
            Table(entry, cls, path)
            for (path, _, cls), entry in zip(leaves(layout, known or "table"), entries, strict=True)
        ]
        for part in parts:
            part.named = name is not None
        shapes = {part.name: part.shape for part in parts}
        if len(set(shapes.values())) > 1:
            listed = ", ".join(f"{path} {shape}" for path, shape in shapes.items())
            raise ShpyTypeError(
                f"{what} has fields of several shapes: {listed}", loc=here(), cure="one element of each field a place"
            )
        self._hold(type, layout, known or "table", parts)

    def _hold(self, type: Any, layout: Layout, name: str, parts: Sequence[Table]) -> None:
        self.type = type
        self.name, self.named = name, parts[0].named
        self.rank = parts[0].rank
        self._layout = layout
        self._parts = tuple(parts)
        for part in parts:
            part._owner = self

    @property
    def shape(self) -> tuple[Any, ...]:
        """The number of elements on each axis, in the order of numpy's."""
        return self._parts[0].shape

    def update(self, array: Any) -> None:
        """Replace the data, of all fields at once; the shape stays."""
        entries = flatten(self._layout, array, f"the Table {self.name}")
        checked = [part._for_update(entry) for part, entry in zip(self._parts, entries, strict=True)]
        for part, data in zip(self._parts, checked, strict=True):  # only when all of them fit
            part._replace(data)

    def leaves(self, name: str) -> dict[str, Table]:
        """The tables of the leaves by their names in a module, where this one is called `name`."""
        paths = [path for path, _, _ in leaves(self._layout, name)]
        return dict(zip(paths, self._parts, strict=True))

    def __getitem__(self, key: Any) -> Any:
        return build_values(self._layout, iter([part[key] for part in self._parts]))


class CompoundArgument(CompoundTable):
    """A table of structs or matrices that a run is given."""

    def __init__(self, name: str, type_: TableType) -> None:
        layout = layout_of(type_.cls, "an element")
        parts = [TableArgument(path, TableType(cls, type_.rank)) for path, _, cls in leaves(layout, name)]
        self._hold(type_.cls, layout, name, parts)


def is_compound(type_: Any) -> bool:
    """Return whether elements are structs or matrices; ShpyTypeError for what is no type of the language."""
    try:
        layout = layout_of(type_, "an element")
    except ShpyTypeError:
        return False
    return not isinstance(layout, Leaf) and not (isinstance(layout, Group) and layout.form != "struct")


def argument(name: str, type_: TableType) -> Table:
    """The stand-in for a table argument while its program is recorded."""
    return CompoundArgument(name, type_) if is_compound(type_.cls) else TableArgument(name, type_)


def fits(table: Table, type_: TableType) -> bool:
    """Return whether a table can be an argument of this type: kinds aside, the same elements and rank."""
    return table.rank == type_.rank and fits_type(table.type, type_.cls)


def fits_type(given: Any, wanted: Any) -> bool:
    """Return whether elements of one type can stand for those of another one: kinds aside, the same leaves."""
    return _types(given) == _types(wanted)


def _types(cls: Any) -> list[Any]:
    found: Iterator[Any] = leaves(layout_of(cls, ""), "")
    return [(path, leaf.type) for path, _, leaf in found]


def listed_tables(tables: dict[str, Table]) -> dict[str, Table]:
    """A program's tables as the user made them: one for all fields of a struct and all rows of a matrix."""
    found: dict[str, Table] = {}
    for name, table in tables.items():
        owner = table._owner
        if owner is None:
            found[name] = table
        elif all(owner is not other for other in found.values()):
            path = (table.name or "").removeprefix(owner.name or "")
            found[name.removesuffix(path)] = owner
    return found
