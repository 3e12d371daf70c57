"""Tables: data that programs read at an index.

Stage: record. Used by closure, or as arguments annotated `sh.Table[sh.Attrib4f, 2]`.

    heights = sh.Table(np.zeros((64, 64)), sh.Attrib1f)
    heights[row, col]      # the nearest element where row or col is out of range

The IR knows tables of scalars and vectors only. One of structs or matrices is a table for each leaf, read at one index:

    balls = sh.Table({"center": centers, "radius": radii}, Ball)      # tables balls.center, balls.radius
    balls[i].center
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from shpy.errors import RecordError, ShpyIndexError, ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.tabledata import TableData
from shpy.ir.types import Base, vec
from shpy.lang.data.hostdata import as_base, checked_bool, working
from shpy.lang.recording.emit import DEFERRED, HOST
from shpy.lang.recording.location import here
from shpy.lang.recording.names import assigned_name
from shpy.lang.recording.recorder import Frame, need_frame
from shpy.lang.values import arithmetic, coerce
from shpy.lang.values.structure import Group, Layout, Leaf, build_values, flatten, layout_of, leaves, type_of
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
    The table has a copy of the array: what happens to the array later changes nothing. `copy=False` saves the memory of
    the copy where numbers need no conversion: the table shares the array, which is read-only and must stay as it is.
    Raises ShpyTypeError for arrays that are empty, of another rank, or whose numbers do not fit the type, and with
    `copy=False` for one that can be written, or is a view of such an array.
    """

    __hash__ = object.__hash__
    type: Any
    name: str | None
    named: bool
    rank: int
    _owner: Table | None = None

    def __new__(cls, array: Any = None, type: Any = None, name: str | None = None, *, copy: bool = True) -> Table:
        """Choose the class: a table of structs or matrices has its own, and so has one over the memory of a stream."""
        if hasattr(array, "_table_class"):
            table: Table = object.__new__(array._table_class())
            return table
        return object.__new__(CompoundTable if cls is Table and is_compound(type) else cls)

    def __init__(self, array: Any, type: Any = None, name: str | None = None, *, copy: bool = True) -> None:
        self.type = element_class(type)
        self.named = name is not None
        self.name = name if name is not None else assigned_name()
        self._array = self._checked(array) if checked_bool(copy, "copy") else self._shared(array)
        self.rank = self._array.ndim - (self.type.size > 1)
        self._version = 0
        self._shares = not copy
        """True if the array may be the user's, which only the user changes."""
        self._data: dict[Any, TableData] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_data": {}}

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
    def _spoken(self) -> str:
        return f"the Table {self.name}" if self.name else "a Table"

    def _checked(self, array: Any, *, part: bool = False) -> NDArray[Any]:
        data = self._fitting(array, part=part)
        return data.copy() if _may_share(data, array) else data

    def _shared(self, array: Any) -> NDArray[Any]:
        """Return an array for the element type, without a copy; ShpyTypeError where its memory can be written."""
        data = self._fitting(array)
        if _may_share(data, array) and not is_constant(data):
            raise ShpyTypeError(
                f"{self._spoken} with copy=False shares an array, and this one can be written",
                loc=here(),
                cure="sh.Table(array, type), which copies it; or array.flags.writeable = False on the array that "
                "owns the memory",
            )
        return data

    def _fitting(self, array: Any, *, part: bool = False) -> NDArray[Any]:
        """Return an array for the element type, or a part; it may share the memory of the one that is given."""
        what = self._spoken
        data = as_base(array, self.type.base, what)
        n = self.type.size
        rank = data.ndim - (n > 1)
        if n > 1 and (data.ndim == 0 or data.shape[-1] != n):
            raise ShpyTypeError(
                f"{what} of {self.type.__name__} takes an array (*shape, {n}), not {data.shape}",
                loc=here(),
                cure=f"array[..., :{n}]" if data.ndim > 1 and data.shape[-1] > n else f"array.reshape(-1, {n})",
            )
        if rank not in (1, 2, 3):
            raise ShpyTypeError(
                f"{what} has 1 to 3 axes, and this array, {data.shape}, has {rank}",
                loc=here(),
                cure=f"array.reshape(-1, {n})" if n > 1 else "array.reshape(-1)",
            )
        if data.size == 0 and not part:
            raise ShpyTypeError(f"{what} cannot be empty", loc=here(), cure="one element that stands for none")
        return data

    @property
    def shape(self) -> tuple[Any, ...]:
        """The number of elements on each axis, in the order of numpy's."""
        return self._array.shape[: self.rank]

    def update(self, array: Any, *, start: int | None = None) -> None:
        """Replace the data; the shape stays. Kernels use the new data from their next run on.

        With `start`, an index on the first axis, the array replaces as many elements from there on, and they alone are
        sent to devices. Raises ShpyTypeError for another shape, and ShpyIndexError for a part that is out of range.
        """
        if start is None:
            self._replace(self._for_update(array))
        else:
            part = self._checked_part(array, start)
            if len(part):
                self._change(part, start)

    def _for_update(self, array: Any) -> NDArray[Any]:
        data = self._checked(array, part=True)
        if data.shape != self._array.shape:
            raise ShpyTypeError(
                f"update of {self._spoken} keeps the shape: {self._array.shape}, not {data.shape}",
                loc=here(),
                cure="a new sh.Table",
            )
        return data

    def _checked_part(self, array: Any, start: int) -> NDArray[Any]:
        data = self._fitting(array, part=True)  # `_change` copies it
        if data.shape[1:] != self._array.shape[1:]:
            raise ShpyTypeError(
                f"a part of {self._spoken} is {('n', *self._array.shape[1:])}, not {data.shape}",
                loc=here(),
                cure="array.reshape(-1, ...)",
            )
        if not is_int(start):
            raise ShpyTypeError(f"start={start!r} is no index of {self._spoken}", loc=here(), cure="start=0, an int")
        if not 0 <= start <= len(self) - len(data):
            raise ShpyIndexError(
                f"elements {start} to {start + len(data) - 1} of {self._spoken}, which has {len(self)}",
                loc=here(),
                cure="a part in range",
            )
        return data

    def _change(self, part: NDArray[Any], start: int) -> None:
        entries = {key: data for key, data in self._data.items() if data.version == self._version}
        for data in entries.values():
            data.settle()  # one of them may share the memory of `_array`
        converted = [self._working(part, key) for key in entries]  # before anything changes: it may refuse a number
        if self._shares:
            whole = self._array.copy()
            whole[start : start + len(part)] = part
            self._replace(whole)
            return
        if not any(np.may_share_memory(data.array, self._array) for data in entries.values()):
            self._array[start : start + len(part)] = part
        self._version += 1
        for data, values in zip(entries.values(), converted, strict=True):
            data.change(start, values)

    def _replace(self, data: NDArray[Any]) -> None:
        self._array, self._shares = data, False
        self._version += 1

    def data(self, dtype: Any) -> TableData:
        """Return the data for a runtime, floats as `dtype`: one object until an update, which counts `version`."""
        key = np.dtype(dtype) if self._array.dtype.kind == "f" else self._array.dtype
        entry = self._data.get(key)
        if entry is None:
            entry = self._data[key] = TableData(self._frozen(key), self._version)
        elif entry.version != self._version:
            entry.replace(self._frozen(key), self._version)
        return entry

    def _frozen(self, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Return the data as a dtype, read-only; ShpyTypeError for a number that is out of its range.

        Data of the dtype that the table has are the table's own: each change is written once.
        """
        frozen = np.ascontiguousarray(self._working(self._array, dtype)).view()
        frozen.flags.writeable = False
        return frozen

    def _working(self, array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
        what = f"the Table {self.name}" if self.name else "a Table"
        return array if array.dtype == dtype else working(array, self.type.base, dtype, what)

    def leaves(self, name: str) -> dict[str, Table]:
        """Return the tables that stand for this one in a module, where it is called `name`: itself."""
        return {name: self}

    def _declared(self, frame: Frame) -> str:
        return frame.recording.use("table", frame.recording.tables, self)

    def __getitem__(self, key: Any) -> Any:
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
                extent = self._extent(axis)
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

    def _extent(self, axis: int) -> int | None:
        return int(self._array.shape[axis])

    def _at_once(self, operands: list[Any]) -> Any:
        index = [
            int(c)
            for o in operands
            for c in (o.components if isinstance(o, coerce.Literal) else np.atleast_1d(np.asarray(o)))
        ]
        array = self._host_array()
        clamped = tuple(min(max(i, 0), n - 1) for i, n in zip(index, array.shape, strict=False))
        return CLASSES[self.type.kind, self.type.size, self.type.base](array[clamped])

    def _host_array(self) -> NDArray[Any]:
        """Return the elements on the host."""
        return self._array

    def __setitem__(self, key: Any, value: Any) -> None:
        raise RecordError(
            f"{self.name or 'a Table'} is read only", loc=here(), cure="an sh.Array, an output, or table.update(array)"
        )

    def __len__(self) -> int:
        return int(self.shape[0])


def _may_share(data: NDArray[Any], array: Any) -> bool:
    """Return whether data may lie in the memory of what it was made of."""
    foreign = not isinstance(array, np.ndarray) and hasattr(array, "__dlpack__")  # numpy compares no such memory
    return foreign or bool(np.may_share_memory(data, array))


def is_constant(array: NDArray[Any]) -> bool:
    """Return whether an array owns its memory and is read-only, and so is every array of which it is a view."""
    while not array.flags.writeable and isinstance(array.base, np.ndarray):
        array = array.base
    return not array.flags.writeable and array.flags.owndata


def element_class(type_: Any) -> type[Value]:
    """Return the class of elements; ShpyTypeError for anything but a scalar or vector type of the language."""
    if not (isinstance(type_, type) and issubclass(type_, Value) and hasattr(type_, "kind")):
        raise ShpyTypeError(f"a Table holds values of the language, not {type_!r}", loc=here(), cure="sh.Attrib4f")
    return type_


class TableArgument(Table):
    """A table that a run is given: its shape is known only then."""

    def __init__(self, name: str, type_: TableType) -> None:
        self.type = type_.cls
        self.name, self.named = name, True
        self.rank = type_.rank

    @property
    def shape(self) -> tuple[Any, ...]:
        """The number of elements on each axis: an Attrib1i for one axis, else a tuple."""
        frame = need_frame("a table's shape")
        size = vec(Base.I, self.rank)
        handle = frame.let("table_size", (), size, self._declared(frame))
        whole = arithmetic.make_value("Attrib", size, frame, handle)
        return (whole,) if self.rank == 1 else tuple(whole)

    def _extent(self, axis: int) -> int | None:
        return None

    def _at_once(self, operands: list[Any]) -> Any:
        raise RecordError(f"{self.name} has data only when the program runs", loc=here())


class CompoundTable(Table):
    """A Table of structs or matrices. Made by `sh.Table`."""

    def __init__(self, array: Any, type: Any, name: str | None = None, *, copy: bool = True) -> None:
        python_name = name if name is not None else assigned_name()
        layout = layout_of(type, "an element")
        what = f"the Table {python_name}" if python_name else "a Table"
        entries = flatten(layout, array, what)
        parts = [
            Table(entry, cls, path, copy=copy)
            for (path, _, cls), entry in zip(leaves(layout, python_name or "table"), entries, strict=True)
        ]
        for part in parts:
            part.named = name is not None
        shapes = {part.name: part.shape for part in parts}
        if len(set(shapes.values())) > 1:
            listed = ", ".join(f"{path} {shape}" for path, shape in shapes.items())
            raise ShpyTypeError(
                f"{what} has fields of several shapes: {listed}", loc=here(), cure="one element of each field a place"
            )
        self._hold(type, layout, python_name or "table", parts)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "type"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, type=type_of(state["_layout"]))

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

    def update(self, array: Any, *, start: int | None = None) -> None:
        """Replace the data of all fields at once, or those of a part from `start` on; the shape stays."""
        entries = flatten(self._layout, array, f"the Table {self.name}")
        pairs = list(zip(self._parts, entries, strict=True))
        if start is None:
            checked = [part._for_update(entry) for part, entry in pairs]
            for part, data in zip(self._parts, checked, strict=True):  # only when all of them fit
                part._replace(data)
            return
        checked = [part._checked_part(entry, start) for part, entry in pairs]
        for part, data in zip(self._parts, checked, strict=True):
            part._change(data, start)

    def leaves(self, name: str) -> dict[str, Table]:
        """Return the tables of the leaves, by their names in a module in which this table is called `name`."""
        paths = [path for path, _, _ in leaves(self._layout, name)]
        return dict(zip(paths, self._parts, strict=True))

    def __getitem__(self, key: Any) -> Any:
        named = leaves(self._layout, f"{self.name or 'table'}[…]")
        read = (part[key]._read_from(path, "constant") for part, (path, _, _) in zip(self._parts, named, strict=True))
        return build_values(self._layout, read)


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
    """Make the table that stands for an argument while its program is recorded."""
    return CompoundArgument(name, type_) if is_compound(type_.cls) else TableArgument(name, type_)


def fits(table: Table, type_: TableType) -> bool:
    """Return whether a table can be an argument of this type: kinds aside, the same elements and rank."""
    return table.rank == type_.rank and fits_type(table.type, type_.cls)


def fits_type(source: Any, target: Any) -> bool:
    """Return whether elements of one type can stand for those of another one: kinds aside, the same leaves."""
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
