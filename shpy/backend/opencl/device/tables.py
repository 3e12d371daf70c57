"""Tables on a device: memory shared with the host, or copies that are updated when the data change.

Stage: run.

    buffer = tables_of(machine).buffer(data, np.float32, 4)
"""

from __future__ import annotations

import weakref
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from shpy.backend.base import Array
from shpy.backend.device.once import once
from shpy.backend.opencl.device.driver import Machine
from shpy.ir.tabledata import TableData

_Copies = dict[Any, tuple[int, Any, bool]]
"""For each layout of the elements: the version of the data, the buffer, and whether changed parts are sent to it."""


@once
def tables_of(machine: Machine) -> Tables:
    """Return the tables of a device."""
    return Tables(machine)


class Tables:
    """The buffers of tables, for as long as their data exists."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self._copies: WeakKeyDictionary[TableData, _Copies] = WeakKeyDictionary()

    def buffer(self, data: TableData, dtype: Any, size: int = 1, *, padded: bool = False) -> Any:
        """Return a table on the device: its own memory, or a copy, which is made anew where the data has changed.

        `size`: the components of an element; `padded`: each vector is followed by a number that nobody reads.
        """
        copies = self._copies.get(data)
        if copies is None:
            copies = self._copies[data] = {}
            weakref.finalize(data, self._leave, copies).atexit = False
        version, buffer, sent = copies.get((dtype, padded), (None, None, False))
        if version == data.version:
            return buffer
        changed = data.changed_since(version) if sent else None
        if changed is not None:
            self._send(buffer, {start: _as_held(data.array[start:stop], dtype, padded) for start, stop in changed})
        else:
            array = _as_held(data.array, dtype, padded)
            buffer = self.machine.lend(array, size)
            # What is lent, or small, is taken anew after a change: commands to a queue would take longer.
            sent = buffer is None and array.nbytes >= self.machine.worth_lending
            if buffer is None:
                cl = self.machine.cl
                flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
                buffer = cl.Buffer(self.machine.context, flags, hostbuf=array)
            else:
                data.lent(self.machine.settle)
        copies[dtype, padded] = (data.version, buffer, sent)
        return buffer

    def _leave(self, copies: _Copies) -> None:
        """Hold the buffers of deleted data until the runs that may read them have ended."""
        self.machine.outlive([buffer for _, buffer, _ in copies.values()])

    def _send(self, buffer: Any, parts: dict[int, Array]) -> None:
        """Write parts to their places along the first axis of a buffer."""
        cl, copied = self.machine.cl, []
        for start, part in parts.items():
            offset = start * part[0].nbytes
            copied.append(cl.enqueue_copy(self.machine.queue, buffer, part, dst_offset=offset, is_blocking=False))
        cl.wait_for_events(copied)


def _as_held(array: Array, dtype: Any, padded: bool) -> Array:
    """Return elements of a table as a buffer holds them; `padded` as in `Tables.buffer`."""
    array = np.ascontiguousarray(array, dtype=dtype)
    return np.concatenate([array, array[..., :1]], axis=-1) if padded else array
