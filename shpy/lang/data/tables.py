"""Tables: data that programs read at an index.

Stage: record. Used by closure, or as arguments annotated `sh.Table[sh.Attrib4f, 2]`.

    heights = sh.Table(np.zeros((64, 64)), sh.Attrib1f)
    heights[row, col]      # the nearest element where row or col is out of range

The IR knows tables of scalars and vectors only. One of structs or matrices is a table for each leaf, read at one index:

    balls = sh.Table({"center": centers, "radius": radii}, Ball)      # tables balls.center, balls.radius
    balls[i].center
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from shpy.errors import RecordError, ShpyIndexError, ShpyTypeError
from shpy.ir.tabledata import TableData
from shpy.ir.types import Base, vec
from shpy.lang.data.sources import Argument, HostArrays, Source
from shpy.lang.recording.emit import DEFERRED, HOST
from shpy.lang.recording.location import here
from shpy.lang.recording.names import assigned_name
from shpy.lang.recording.recorder import Frame, need_frame
from shpy.lang.values import arithmetic, coerce
from shpy.lang.values.structure import Group, Layout, Leaf, build_values, layout_of, leaves, outside, type_of
from shpy.lang.values.value import CLASSES, Value


@dataclass(frozen=True, slots=True)
class TableType:
    """The annotation `Table[type, rank]`."""

    cls: Any
    rank: int

    def __repr__(self) -> str:
        rank = "" if self.rank == 1 else f", {self.rank}"
        return f"Table[{self.cls.__name__}{rank}]"

    def __reduce__(self) -> Any:
        return _table_type, (layout_of(self.cls, "an element"), self.rank)


def _table_type(layout: Layout, rank: int) -> TableType:
    return TableType(type_of(layout), rank)


class Table:
    """`Table(array, type)`: random-access data, (*shape, N) for N components and (*shape,) for one, 1-D to 3-D.

    `table[i]`, `table[row, col]`, `table[k, j, i]` in the order of numpy's axes, or `table[v]` with an integer vector.
    The type may be a matrix, from an array (*shape, N, N), or a struct, from a dict of fields or a structured array.
    A symbolic index out of range reads the nearest element on each axis; a constant one raises ShpyIndexError.
    The table has a copy of the array: later changes of the array have no effect. `copy=False` saves the memory of
    the copy where numbers need no conversion: the table shares the array, which is read-only and must stay as it is.
    Two tables of one given name in a program are an error; with `unique=False` a number is added to the name instead.
    Raises ShpyTypeError for arrays that are empty, of another rank, or whose numbers do not fit the type, and with
    `copy=False` for one that can be written, or is a view of such an array.
    """

    __hash__ = object.__hash__
    type: Any
    name: str | None
    named: bool
    source: Source
    leaf: int
    """The leaf of the source that it reads, where its elements are scalars or vectors."""
    _owner: Table | None

    def __init__(
        self, array: Any, type: Any = None, name: str | None = None, *, copy: bool = True, unique: bool = True
    ) -> None:
        label = name if name is not None else assigned_name()
        if hasattr(array, "table_source"):  # streams define this method
            source = array.table_source(type)
        else:
            source = HostArrays.of(array, _layout(type), label, copy=copy)
        self._become(source, label, unique and name is not None)

    def _become(self, source: Source, name: str | None, named: bool) -> None:
        self.source, self._layout, self.rank = source, source.layout, source.rank
        self.type = type_of(source.layout)
        self.name, self.named, self._owner, self.leaf = name, named, None, 0
        self._parts: tuple[Table, ...] = ()
        if not isinstance(source.layout, Leaf):
            self.name = name or "table"
            parts = enumerate(leaves(source.layout, self.name))
            self._parts = tuple(self._part(k, path, cls) for k, (path, _, cls) in parts)

    def _part(self, leaf: int, path: str, cls: type[Value]) -> Table:
        """Return the table of one leaf: the IR knows tables of scalars and vectors only."""
        part = object.__new__(Table)
        part.source, part._layout, part.rank, part._parts = self.source, Leaf(cls), self.rank, ()
        part.type, part.name, part.named, part._owner, part.leaf = cls, path, self.named, self, leaf
        return part

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "type"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, type=type_of(state["_layout"]))

    @classmethod
    def __class_getitem__(cls, key: Any) -> TableType:
        """Return the annotation of a table argument: its element type, and its rank if that is not 1.

        A type checker takes no plain number there (PEP 586): `sh.Table[sh.Attrib4f, Literal[2]]` means the same.
        """
        type_, rank = key if isinstance(key, tuple) else (key, 1)
        (rank,) = get_args(rank) or (rank,)  # Literal[2], or 2
        if rank not in (1, 2, 3):
            raise ShpyTypeError(f"a Table has 1 to 3 axes, not {rank}", loc=here(), cure="sh.Table[sh.Attrib4f, 2]")
        return TableType(type_ if is_compound(type_) else element_class(type_), rank)

    @property
    def is_argument(self) -> bool:
        """Return whether a run brings its elements."""
        return isinstance(self.source, Argument)

    @property
    def shape(self) -> tuple[Any, ...]:
        """The number of elements on each axis, in the order of numpy's; symbolic in the recording of an argument."""
        shape = self.source.shape
        if shape is not None:
            return shape
        frame = need_frame("a table's shape")
        size = vec(Base.I, self.rank)
        leaf = self._parts[0] if self._parts else self
        handle = frame.let("table_size", (), size, leaf._declared(frame))
        whole = arithmetic.make_value("Attrib", size, frame, handle)
        return (whole,) if self.rank == 1 else tuple(whole)

    def update(self, array: Any, *, start: int | None = None) -> None:
        """Replace the data, of all fields at once; the shape stays. Kernels use the new data from their next run on.

        With `start`, an index on the first axis, the array replaces as many elements from there on, and they alone are
        sent to devices. Raises ShpyTypeError for another shape, and ShpyIndexError for a part that is out of range.
        """
        self.source.update(array, start)

    def data(self, dtype: Any) -> TableData:
        """Return the data for a runtime, floats as `dtype`: one object until an update, which counts `version`."""
        return self.source.data(self.leaf, dtype)

    @property
    def version(self) -> int:
        """The number of changes that were counted."""
        return self.source.version(self.leaf)

    def host_array(self) -> NDArray[Any]:
        """Return the elements of a table of scalars or vectors, on the host."""
        return self.source.array(self.leaf)

    def leaves(self, name: str) -> dict[str, Table]:
        """Return the tables of the leaves, by their names in a module in which this table is called `name`."""
        return dict(zip([path for path, _, _ in leaves(self._layout, name)], self._parts or (self,), strict=True))

    def _declared(self, frame: Frame) -> str:
        return frame.recording.use("table", frame.recording.tables, self)

    def __getitem__(self, key: Any) -> Any:
        if self._parts:
            named = leaves(self._layout, f"{self.name}[…]")
            read = (p[key]._read_from(path, "constant") for p, (path, _, _) in zip(self._parts, named, strict=True))
            return build_values(self._layout, read)
        if isinstance(key, Value) and key.size == self.rank and key.size > 1:
            entries: list[Any] = [key]
        else:
            entries = list(key) if isinstance(key, tuple) else [key]
            if len(entries) != self.rank:
                raise ShpyTypeError(
                    f"this Table has {self.rank} axes and takes as many indices, not {len(entries)}",
                    loc=here(),
                    cure=f"table[{', '.join('kji'[-self.rank :])}]",
                )
        operands = [arithmetic.operand(e, "an index") for e in entries]
        self._check(operands)
        emitter = arithmetic.emitter_of(*operands)
        if emitter is HOST:
            return self._at_once(operands)
        scalars = [
            arithmetic.index(emitter, o) if isinstance(o, Value) else arithmetic.read(emitter, o, vec(Base.I))
            for o in operands
        ]
        index = scalars[0] if len(scalars) == 1 else emitter.let("construct", tuple(scalars), vec(Base.I, self.rank))
        source: Any = self if emitter is DEFERRED else self._declared(need_frame("a Table"))
        handle = emitter.let("table", (index,), self.type.type, source)
        element = arithmetic.make_value(self.type.kind, self.type.type, emitter, handle)
        return element._read_from(f"{self.name or 'table'}[…]", "constant")

    def _check(self, operands: list[Any]) -> None:
        for axis, o in enumerate(operands):
            if isinstance(o, coerce.Literal):
                if o.weak != "int":
                    raise ShpyTypeError("a Table takes ints as indices", loc=here(), cure="sh.Attrib1i(x)")
                extent = None if self.source.shape is None else self.source.shape[axis]
                if o.components[0] < 0 or (extent is not None and o.components[0] >= extent):
                    raise ShpyIndexError(
                        f"index {o.components[0]} on axis {axis} of a Table of shape {self.shape}",
                        loc=here(),
                        cure="a constant index in range; a symbolic one reads the nearest element",
                    )
            elif not o.type.is_int:
                raise ShpyTypeError(
                    f"a Table takes ints as indices, not {o.type!r}", loc=here(), cure="sh.Attrib1i(x), which truncates"
                )

    def _at_once(self, operands: list[Any]) -> Any:
        index = [
            int(c)
            for o in operands
            for c in (o.components if isinstance(o, coerce.Literal) else np.atleast_1d(np.asarray(o)))
        ]
        array = self.host_array()
        clamped = tuple(min(max(i, 0), n - 1) for i, n in zip(index, array.shape, strict=False))
        return CLASSES[self.type.kind, self.type.size, self.type.base](array[clamped])

    def __setitem__(self, key: Any, value: Any) -> None:
        raise RecordError(
            f"{self.name or 'a Table'} is read only", loc=here(), cure="an sh.Array, an output, or table.update(array)"
        )

    def __len__(self) -> int:
        return int(self.shape[0])


def element_class(type_: Any) -> type[Value]:
    """Return the class of elements; ShpyTypeError for anything but a scalar or vector type of the language."""
    if not (isinstance(type_, type) and issubclass(type_, Value) and hasattr(type_, "kind")):
        raise ShpyTypeError(f"a Table holds values of the language, not {type_!r}", loc=here(), cure="sh.Attrib4f")
    outside(Leaf(type_), "an element")
    return type_


def _layout(type_: Any) -> Layout:
    """Return the layout of elements; ShpyTypeError for anything but values, structs and matrices of the language."""
    is_value = isinstance(type_, type) and issubclass(type_, Value)
    return layout_of(type_, "an element") if not is_value and is_compound(type_) else Leaf(element_class(type_))


def is_compound(type_: Any) -> bool:
    """Return whether elements are structs or matrices; raise ShpyTypeError unless it is a type of the language."""
    try:
        layout = layout_of(type_, "an element")
    except ShpyTypeError:
        return False
    outside(layout, "an element")
    return not isinstance(layout, Leaf) and not (isinstance(layout, Group) and layout.form != "struct")


def argument(name: str, type_: TableType) -> Table:
    """Make the table that stands for an argument while its program is recorded."""
    table = object.__new__(Table)
    table._become(Argument(layout_of(type_.cls, "an element"), type_.rank, name), name, True)
    return table


def fits(table: Table, type_: TableType) -> bool:
    """Return whether a table can be an argument of this type: kinds aside, the same elements and rank."""
    return table.rank == type_.rank and fits_type(table.type, type_.cls)


def fits_type(source: Any, target: Any) -> bool:
    """Return whether elements of one type can be used as another type: except for kinds, the leaves are the same."""
    return _types(source) == _types(target)


def _types(cls: Any) -> list[Any]:
    parts: Iterator[Any] = leaves(layout_of(cls, ""), "")
    return [(path, leaf.type) for path, _, leaf in parts]


def listed_tables(tables: dict[str, Table]) -> dict[str, Table]:
    """Return a program's tables as the user made them: one table for all fields of a struct or rows of a matrix."""
    originals: dict[str, Table] = {}
    for name, table in tables.items():
        owner = table._owner
        if owner is None:
            originals[name] = table
        elif all(owner is not other for other in originals.values()):
            path = (table.name or "").removeprefix(owner.name or "")
            originals[name.removesuffix(path)] = owner
    return originals
