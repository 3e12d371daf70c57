"""Memory of the numpy backend: arrays of the host, which kernels read and write where they are.

Stage: run.

    memory = NumpySpace(COLLECTIVES).allocate(4, vec(Base.F, 3), np.dtype(np.float32))
    memory.array                                # (4, 3)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from shpy.backend.base import Array, Call, Collectives, Counts, DeviceCall, TableMemory, too_large
from shpy.errors import ShpyTypeError
from shpy.ir.nodes import Status
from shpy.ir.tabledata import TableData
from shpy.ir.types import Type


@dataclass(slots=True, eq=False, weakref_slot=True)
class NumpyMemory:
    """An array (count, size), or (count,) for scalars: see `base.Memory`."""

    array: Array
    type: Type

    @property
    def count(self) -> int:
        """The number of elements."""
        return len(self.array)

    @property
    def dtype(self) -> np.dtype[Any]:
        """The dtype of a component."""
        return self.array.dtype

    @property
    def native(self) -> Array:
        """The array itself."""
        return self.array

    @property
    def extent(self) -> tuple[Any, int, int]:
        """The host's memory and addresses of bytes there."""
        first = self.array.__array_interface__["data"][0]
        return None, first, first + self.array.nbytes

    def write(self, array: Array) -> None:
        """Copy an array into this one."""
        self.array[...] = array

    def read(self, begin: int = 0, end: int | None = None) -> Array:
        """Return a copy."""
        return self.array[begin:end].copy()


class NumpySpace:
    """The host's memory: see `base.Space`."""

    overwrites = True
    on_host = True
    flushes = False

    def __init__(self, collectives: Collectives) -> None:
        self.collectives = collectives

    def allocate(self, count: int, type: Type, dtype: np.dtype[Any]) -> NumpyMemory:
        """Memory for `count` elements, whatever it holds; ShpyError if there is not enough memory."""
        try:
            return NumpyMemory(np.empty((count, type.size) if type.size > 1 else count, dtype), type)
        except (MemoryError, ValueError, OverflowError) as error:
            raise too_large(count, type, dtype) from error

    def owns(self, native: Any) -> bool:
        """Return True: every array lies in the host's memory."""
        return True

    def wrap(self, native: Any, type: Type, dtype: np.dtype[Any]) -> NumpyMemory:
        """Memory that is the array's own: contiguous, (count, size) or (count,), of the dtype of kernels."""
        tail = (type.size,) if type.size > 1 else ()
        if not (isinstance(native, np.ndarray) and native.flags.carray and native.dtype == dtype):
            spoken = "object that is no array"
            if isinstance(native, np.ndarray):
                lacks = {"non-contiguous": not native.flags.c_contiguous, "read-only": not native.flags.writeable}
                spoken = f"{' '.join([word for word, holds in lacks.items() if holds] + [str(native.dtype)])} array"
            raise ShpyTypeError(
                f"a stream of {type!r} shares a contiguous, writeable {dtype} array, not this {spoken}",
                cure="sh.Stream(array, type), which copies",
            )
        return NumpyMemory(native.reshape(-1, *tail), type)

    def view(self, memory: NumpyMemory, type: Type, count: int) -> NumpyMemory:
        """Return the same array as elements of another size."""
        flat = memory.array.reshape(-1)[: count * type.size]
        return NumpyMemory(flat.reshape(count, type.size) if type.size > 1 else flat, type)

    def copy(self, source: Any, target: Any) -> None:
        """Copy all elements."""
        target.array[...] = source.array

    def merge(self, status: Any, new: Any, old: Any) -> Any:
        """Put the elements of `old`, or zeros, where the status is not WRITTEN."""
        lost = status.array != Status.WRITTEN
        new.array[lost] = 0 if old is None else old.array[lost]
        return new

    def count(self, status: Any) -> Counts:
        """Count the elements of each status."""
        return Counts.of(status.array)

    def on_device(self, function: Callable[..., Any], natives: list[Any]) -> Any:
        """Call it: any thread may use an array."""
        return function(*natives)

    def start(self, runs: Iterable[Callable[[], None]]) -> None:
        """Run one after the other."""
        for run in runs:
            run()

    def finish(self) -> None:
        """Do nothing: whatever was started has ended."""


def over_arrays(run: Callable[[Call], Array | None], call: DeviceCall) -> Callable[[], None]:
    """Make a run over memory of the numpy backend of a run over arrays: see `base.Executable.ready`."""
    inputs, outputs = (tuple(_array(m) for m in memories) for memories in (call.inputs, call.outputs))
    changing = {n: _as_table(t) for n, t in call.tables.items() if isinstance(t, TableMemory)}
    steady = {n: t for n, t in call.tables.items() if isinstance(t, TableData)}
    whole = Call(call.shape, inputs, outputs, call.params, {**steady, **changing})
    status = None if call.status is None else _array(call.status)

    def start() -> None:
        for data in changing.values():
            data.version += 1
        statuses = run(whole)
        if status is not None:
            status[...] = Status.WRITTEN if statuses is None else statuses

    return start


def _array(memory: Any) -> Array:
    assert isinstance(memory, NumpyMemory)
    return memory.array


def _as_table(table: TableMemory) -> TableData:
    array = _array(table.memory)
    return TableData(array.reshape(*table.shape, *array.shape[1:]))
