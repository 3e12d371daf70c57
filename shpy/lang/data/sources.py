"""Sources of Tables: where the elements lie that a program reads.

Stage: record. A source has an array for each leaf of the elements' type. It is the user's data (`HostArrays`), the
memory of a stream (`shpy/streams`), or known only when the program runs (`Argument`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.errors import RecordError, ShpyIndexError, ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.tabledata import TableData
from shpy.lang.data.hostdata import as_base, checked_bool, working
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Layout, Leaf, flatten, leaves
from shpy.lang.values.value import Value


class Source(ABC):
    """The elements of a Table: an array for each leaf, all of one shape."""

    layout: Layout
    rank: int

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...] | None:
        """The number of elements on each axis; None where only a run knows it."""

    @abstractmethod
    def data(self, leaf: int, dtype: Any) -> TableData:
        """Return a leaf's data for a runtime, floats as `dtype`."""

    @abstractmethod
    def array(self, leaf: int) -> NDArray[Any]:
        """Return a leaf's elements on the host."""

    def version(self, leaf: int) -> int:
        """Return the number of changes of a leaf that were counted; the memory of streams changes without."""
        return 0

    @abstractmethod
    def update(self, array: Any, start: int | None) -> None:
        """Replace all elements, or those of a part from `start` on, or none if one of them does not fit."""


@dataclass(frozen=True, eq=False)
class Argument(Source):
    """The elements of a table that a run is given."""

    layout: Layout
    rank: int
    name: str

    @property
    def shape(self) -> None:
        """None: a run knows it."""

    def data(self, leaf: int, dtype: Any) -> TableData:
        """Raise RecordError: a run brings the data."""
        raise RecordError(f"{self.name} has data only when the program runs", loc=here())

    def array(self, leaf: int) -> NDArray[Any]:
        """Raise RecordError: a run brings the data."""
        raise RecordError(f"{self.name} has data only when the program runs", loc=here())

    def update(self, array: Any, start: int | None) -> None:
        """Raise RecordError: a run brings the data."""
        raise RecordError(f"{self.name} has data only when the program runs", loc=here())


@dataclass(eq=False)
class HostArrays(Source):
    """The user's data, or copies of them."""

    layout: Layout
    arrays: Sequence[HostArray]
    spoken: str

    @classmethod
    def of(cls, array: Any, layout: Layout, name: str | None, *, copy: bool) -> HostArrays:
        """Check an array, or a nest of arrays as the layout has it; ShpyTypeError for arrays that do not fit."""
        spoken = f"the Table {name}" if name else "a Table"
        if isinstance(layout, Leaf):  # a shortcut: each run makes tables of its arguments
            return cls(layout, (HostArray(array, layout.cls, spoken, copy=copy),), spoken)
        paths = list(leaves(layout, name or "table"))
        entries = flatten(layout, array, spoken)
        arrays = [
            HostArray(entry, type_, f"the Table {path}", copy=copy)
            for (path, _, type_), entry in zip(paths, entries, strict=True)
        ]
        shapes = {path: part.shape for (path, _, _), part in zip(paths, arrays, strict=True)}
        if len(set(shapes.values())) > 1:
            listed = ", ".join(f"{path} {shape}" for path, shape in shapes.items())
            raise ShpyTypeError(
                f"{spoken} has fields of several shapes: {listed}", loc=here(), cure="one element of each field a place"
            )
        return cls(layout, arrays, spoken)

    @property
    def rank(self) -> int:  # type: ignore[override]
        """The number of axes."""
        return len(self.shape)

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of elements on each axis, in the order of numpy's."""
        return self.arrays[0].shape

    def data(self, leaf: int, dtype: Any) -> TableData:
        """Return a leaf's data: one object until an update, which counts its `version`."""
        return self.arrays[leaf].data(dtype)

    def array(self, leaf: int) -> NDArray[Any]:
        """Return a leaf's array."""
        return self.arrays[leaf].array

    def version(self, leaf: int) -> int:
        """Return the number of a leaf's changes."""
        return self.arrays[leaf].version

    def update(self, array: Any, start: int | None) -> None:
        """Replace all elements, or those of a part from `start` on; checks come before any change."""
        pairs = list(zip(self.arrays, flatten(self.layout, array, self.spoken), strict=True))
        if start is None:
            for part, data in [(part, part.checked(entry)) for part, entry in pairs]:
                part.replace(data)
            return
        for part, data in [(part, part.checked_part(entry, start)) for part, entry in pairs]:
            if len(data):
                part.change(data, start)


class HostArray:
    """A leaf's array, and the versions of it that runtimes hold.

    With `copy=False` it may be the user's array, which must not change and is not changed here.
    """

    def __init__(self, array: Any, type: type[Value], spoken: str, *, copy: bool) -> None:
        self.type = type
        self.spoken = spoken
        self.array = self._copied(array) if checked_bool(copy, "copy") else self._shared(array)
        self.shape = self.array.shape[: self.array.ndim - (type.size > 1)]
        self.version = 0
        self._shares = not copy
        """True if the array may be the user's, which only the user changes."""
        self._data: dict[Any, TableData] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_data": {}}

    def _copied(self, array: Any, *, part: bool = False) -> NDArray[Any]:
        data = self._fitting(array, part=part)
        return data.copy() if _may_share(data, array) else data

    def _shared(self, array: Any) -> NDArray[Any]:
        """Return an array for the element type, without a copy; ShpyTypeError where its memory can be written."""
        data = self._fitting(array)
        if _may_share(data, array) and not _is_constant(data):
            raise ShpyTypeError(
                f"{self.spoken} with copy=False shares an array, and this one can be written",
                loc=here(),
                cure="sh.Table(array, type), which copies it; or array.flags.writeable = False on the array that "
                "owns the memory",
            )
        return data

    def _fitting(self, array: Any, *, part: bool = False) -> NDArray[Any]:
        """Return an array for the element type, or a part; it may share the memory of the one that is given."""
        data = as_base(array, self.type.base, self.spoken)
        n = self.type.size
        rank = data.ndim - (n > 1)
        if n > 1 and (data.ndim == 0 or data.shape[-1] != n):
            raise ShpyTypeError(
                f"{self.spoken} of {self.type.__name__} takes an array (*shape, {n}), not {data.shape}",
                loc=here(),
                cure=f"array[..., :{n}]" if data.ndim > 1 and data.shape[-1] > n else f"array.reshape(-1, {n})",
            )
        if rank not in (1, 2, 3):
            raise ShpyTypeError(
                f"{self.spoken} has 1 to 3 axes, and this array, {data.shape}, has {rank}",
                loc=here(),
                cure=f"array.reshape(-1, {n})" if n > 1 else "array.reshape(-1)",
            )
        if data.size == 0 and not part:
            raise ShpyTypeError(f"{self.spoken} cannot be empty", loc=here(), cure="an array of one element or more")
        return data

    def checked(self, array: Any) -> NDArray[Any]:
        """Return a copy that can replace the whole array; ShpyTypeError for another shape."""
        data = self._copied(array, part=True)
        if data.shape != self.array.shape:
            raise ShpyTypeError(
                f"update of {self.spoken} keeps the shape: {self.array.shape}, not {data.shape}",
                loc=here(),
                cure="a new sh.Table",
            )
        return data

    def checked_part(self, array: Any, start: int) -> NDArray[Any]:
        """Return an array that can replace a part from `start` on; it may share the memory of the one that is given."""
        data = self._fitting(array, part=True)
        if data.shape[1:] != self.array.shape[1:]:
            raise ShpyTypeError(
                f"a part of {self.spoken} is {('n', *self.array.shape[1:])}, not {data.shape}",
                loc=here(),
                cure="array.reshape(-1, ...)",
            )
        if not is_int(start):
            raise ShpyTypeError(f"start={start!r} is no index of {self.spoken}", loc=here(), cure="start=0, an int")
        if not 0 <= start <= len(self.array) - len(data):
            raise ShpyIndexError(
                f"elements {start} to {start + len(data) - 1} of {self.spoken}, which has {len(self.array)}",
                loc=here(),
                cure="a part in range",
            )
        return data

    def replace(self, data: NDArray[Any]) -> None:
        """Take another array."""
        self.array, self._shares = data, False
        self.version += 1

    def change(self, part: NDArray[Any], start: int) -> None:
        """Copy a part into the array, from `start` on."""
        entries = {key: data for key, data in self._data.items() if data.version == self.version}
        for data in entries.values():
            data.settle()  # one of them may share the memory of `array`
        converted = [self._working(part, key) for key in entries]  # before anything changes: it may refuse a number
        if self._shares:
            whole = self.array.copy()
            whole[start : start + len(part)] = part
            self.replace(whole)
            return
        if not any(np.may_share_memory(data.array, self.array) for data in entries.values()):
            self.array[start : start + len(part)] = part
        self.version += 1
        for data, values in zip(entries.values(), converted, strict=True):
            data.change(start, values)

    def data(self, dtype: Any) -> TableData:
        """Return the data for a runtime, floats as `dtype`: one object until an update, which counts `version`."""
        key = np.dtype(dtype) if self.array.dtype.kind == "f" else self.array.dtype
        entry = self._data.get(key)
        if entry is None:
            entry = self._data[key] = TableData(self._frozen(key), self.version)
        elif entry.version != self.version:
            entry.replace(self._frozen(key), self.version)
        return entry

    def _frozen(self, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Return the data as a dtype, read-only; ShpyTypeError for a number that is out of its range.

        Data of the dtype that the table has are the table's own: each change is written once.
        """
        frozen = np.ascontiguousarray(self._working(self.array, dtype)).view()
        frozen.flags.writeable = False
        return frozen

    def _working(self, array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
        return array if array.dtype == dtype else working(array, self.type.base, dtype, self.spoken)


def _may_share(data: NDArray[Any], array: Any) -> bool:
    """Return whether data may lie in the memory of what it was made of."""
    foreign = not isinstance(array, np.ndarray) and hasattr(array, "__dlpack__")  # numpy compares no such memory
    return foreign or bool(np.may_share_memory(data, array))


def _is_constant(array: NDArray[Any]) -> bool:
    """Return whether an array owns its memory and is read-only, and so is every array of which it is a view."""
    while not array.flags.writeable and isinstance(array.base, np.ndarray):
        array = array.base
    return not array.flags.writeable and array.flags.owndata
