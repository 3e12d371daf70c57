"""Memory of an OpenCL device: buffers that stay there from run to run, and tables.

Stage: run. Everything is started on one queue, which runs it in order, so a buffer that nobody holds any longer may be
taken again at once. The host waits when it reads, and now and then, so that what is started does not pile up.

    space = OpenCLSpace(machine, collectives)
    memory = space.allocate(4, vec(Base.F, 3), np.dtype(np.float32))
    space.start([executable.ready(call)])
    memory.read()
"""

from __future__ import annotations

import re
import sys
import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np

from shpy.backend.base import Array, Collectives, Counts, too_large
from shpy.backend.device.once import once
from shpy.backend.device.pool import Recent
from shpy.backend.opencl.device.driver import ANY_SIZE, LOCAL_SIZE, Machine, kind_of
from shpy.errors import ShpyTypeError
from shpy.ir.constants import DTYPES
from shpy.ir.nodes import Status
from shpy.ir.tabledata import TableData
from shpy.ir.types import Base, Type

MEMORY: Final = {**DTYPES, Base.B: np.uint8}
"""The dtype of a component in a buffer, by base."""
WORDS: Final = {1: "uchar", 2: "uint", 4: "uint", 8: "ulong"}
"""The unsigned type of a component's size in bytes; a component of 16 bits takes 32 in a buffer."""
_PAD: Final = """\
__kernel void pad(__global const WORD *packed, __global WORD *padded, ulong n) {
    size_t i = get_global_id(0);
    if (i < n)
        vstore4((WORD4)(vload3(i, packed), 0), i, padded);
}
"""
_STATUS: Final = """\
__kernel void keep(__global const int *status, __global WORD *new, __global const WORD *old, int size, ulong n) {
    size_t i = get_global_id(0);
    if (i < n && status[i] != WRITTEN)
        for (int k = 0; k < size; ++k)
            new[i * size + k] = old ? old[i * size + k] : 0;
}

// counts: elements written, elements stopped, the least status of these; each of n work items takes STRIDE statuses.
__kernel void count_statuses(__global const int *status, uint total, __global volatile uint *counts, ulong n) {
    if (get_global_id(0) >= n)
        return;
    uint written = 0, stopped = 0, least = UINT_MAX, end = min(total, (uint)(get_global_id(0) + 1) * STRIDE);
    for (uint i = get_global_id(0) * STRIDE; i < end; ++i) {
        int s = status[i];
        written += s == WRITTEN;
        if (s >= FIRST_LOOP || s == DEVICE_STOPPED) {
            ++stopped;
            if (s != DEVICE_STOPPED)
                least = min(least, (uint)s);
        }
    }
    atomic_add(counts, written);
    atomic_add(counts + 1, stopped);
    atomic_min(counts + 2, least);
}
"""
_STRIDE: Final = 4096
KERNELS: Final = 256
"""Kernels of the space's own that are kept: those used last."""
_AHEAD: Final = 256
"""The most runs that are started before the host waits."""


@dataclass(slots=True, eq=False, weakref_slot=True)
class OpenCLMemory:
    """A buffer of `count` elements: see `base.Memory`."""

    space: OpenCLSpace
    buffer: Any
    count: int
    type: Type
    dtype: np.dtype[Any]
    owner: OpenCLMemory | None = None
    """For a view, the memory that owns the buffer; this reference keeps it alive."""
    loan: Any = None
    """The loan by which the buffer returns to the pool; None for a buffer that the caller made."""

    @property
    def _buffer_dtype(self) -> np.dtype[Any]:
        return buffer_dtype(self.type, self.dtype)

    @property
    def native(self) -> Any:
        """A pyopencl.array.Array (count, size), or (count,) for scalars, over the same memory; bools are bytes."""
        from pyopencl.array import Array as DeviceArray  # here: it takes long to import

        self._give_up()
        return DeviceArray(self.space.machine.queue, self._shape, self._buffer_dtype, data=self.buffer)

    @property
    def each(self) -> int:
        """The bytes of an element."""
        return self.type.size * self._buffer_dtype.itemsize

    def _give_up(self) -> None:
        """Keep the buffer out of the pool: it is freed with the last array that holds it."""
        if self.owner is not None:
            self.owner._give_up()
        if self.loan is not None:
            self.loan.detach()

    @property
    def extent(self) -> tuple[Any, int, int]:
        """The root buffer, as an integer, with the first byte of this memory in it and the end."""
        buffer, first = self.buffer, 0
        whole = buffer.associated_memobject
        if whole is not None:
            buffer, first = whole, buffer.offset
        return buffer.int_ptr, first, first + self.count * self.each

    @property
    def _shape(self) -> tuple[int, ...]:
        return (self.count, self.type.size) if self.type.size > 1 else (self.count,)

    def write(self, array: Array) -> None:
        """Copy a host array to the device."""
        if self.count:
            machine = self.space.machine
            with machine.lock:
                source = np.ascontiguousarray(array, self._buffer_dtype)
                machine.cl.enqueue_copy(machine.queue, self.buffer, source)

    def read(self, begin: int = 0, end: int | None = None) -> Array:
        """Copy the elements to the host."""
        count = (self.count if end is None else end) - begin
        elements = np.empty((count, *self._shape[1:]), self._buffer_dtype)
        if count:
            machine = self.space.machine
            with machine.lock:
                self.space.finish(copies=True)
                machine.download(elements, self.buffer, begin * self.each)
        return elements.astype(self.dtype, copy=False)


@cache
def _status_text(word: str) -> str:
    """Return the text of the kernels that read statuses, for elements whose components have this unsigned type."""
    names = {name: getattr(Status, name) for name in ("WRITTEN", "FIRST_LOOP", "DEVICE_STOPPED")}
    text = _STATUS.replace("WORD", word)
    for name, number in {**names, "STRIDE": _STRIDE}.items():
        text = re.sub(rf"\b{name}\b", str(number), text)
    return text


def buffer_dtype(type: Type, dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the dtype of a component in a buffer: a bool is a byte, and a float of 16 bits takes 32."""
    return np.dtype(np.float32) if dtype.char == "e" else np.dtype(MEMORY[type.base]) if type.is_bool else dtype


class OpenCLSpace:
    """The memory and the queue of one device: see `base.Space`."""

    overwrites = True
    on_host = False

    def __init__(self, machine: Machine, collectives: Callable[[OpenCLSpace], Collectives]) -> None:
        """Open the memory of a device; `collectives` returns the collective operations that run on it."""
        self.machine = machine
        self.collectives = collectives(self)
        self._kernels = Recent[tuple[str, str], Any](KERNELS)

    @property
    def flushes(self) -> bool:
        """Return whether the device takes denormals of binary32 for zeros."""
        return "denormals" in self.machine.wrong

    def allocate(self, count: int, type: Type, dtype: np.dtype[Any]) -> OpenCLMemory:
        """Return a buffer for `count` elements, not initialised; ShpyError if the device has not that much memory."""
        machine = self.machine
        # A kernel may read a vector of three as four, and whole packets.
        size = count * type.size * buffer_dtype(type, dtype).itemsize
        if size > sys.maxsize // 2:  # the next power of two is not a valid size
            raise too_large(count, type, dtype)
        kind = kind_of(size)
        with machine.lock:
            try:
                buffer = machine.take_of(kind)
            except (machine.cl.MemoryError, machine.cl.LogicError) as error:
                raise too_large(count, type, dtype) from error
        memory = OpenCLMemory(self, buffer, count, type, dtype)
        memory.loan = machine.pool.lend(kind, buffer)
        return memory

    def owns(self, native: Any) -> bool:
        """Return whether a pyopencl.array.Array lies in this device's context."""
        return bool(getattr(native, "context", None) == self.machine.context)

    def wrap(self, native: Any, type: Type, dtype: np.dtype[Any]) -> OpenCLMemory:
        """Return the memory of a contiguous pyopencl.array.Array of this device's context."""
        expected = buffer_dtype(type, dtype)
        if not self.owns(native):
            raise ShpyTypeError(
                "this pyopencl array lies in another context",
                cure="an array made with the queue of a stream's native()",
            )
        if native.offset or not native.flags.c_contiguous:
            raise ShpyTypeError(
                "a stream shares a whole buffer, and this pyopencl array is a part of one, or transposed",
                cure="sh.Stream.wrap(whole), of the array that has the whole buffer, and a slice of that stream",
            )
        bytes_of_bools = type.is_bool and native.dtype == dtype
        if not (native.dtype == expected or bytes_of_bools):
            raise ShpyTypeError(
                f"a stream of {type!r} shares a contiguous pyopencl array of {expected}, not {native.dtype}",
                cure=f"array.astype(np.{expected})",
            )
        return OpenCLMemory(self, native.base_data, native.size // type.size, type, dtype)

    def view(self, memory: OpenCLMemory, type: Type, count: int) -> OpenCLMemory:
        """Return a view of the buffer as `count` elements of another type."""
        return OpenCLMemory(self, memory.buffer, count, type, memory.dtype, memory)

    def copy(self, source: OpenCLMemory, target: OpenCLMemory) -> None:
        """Copy as many elements as `target` has."""
        machine, size = self.machine, target.count * target.each
        if size:
            with machine.lock:
                machine.cl.enqueue_copy(machine.queue, target.buffer, source.buffer, byte_count=size)

    def merge(self, status: OpenCLMemory, new: OpenCLMemory, old: OpenCLMemory | None) -> OpenCLMemory:
        """Replace elements whose status is not WRITTEN by those of `old`, or by zeros."""
        if new.count:
            buffer = None if old is None else old.buffer
            self._enqueue("keep", new, status.buffer, new.buffer, buffer, np.int32(new.type.size))
        return new

    def count(self, status: OpenCLMemory) -> Counts:
        """Count the elements of each status."""
        totals = np.array([0, 0, -1], np.int32).view(np.uint32)
        machine = self.machine
        with machine.lock:
            counts = machine.upload(totals)
            if status.count:
                items = -(-status.count // _STRIDE)
                self._enqueue("count_statuses", status, status.buffer, np.uint32(status.count), counts, items=items)
            machine.download(totals, counts)
            machine.give_back([counts])
        written, stopped, first = map(int, totals)
        return Counts(written, stopped, first if first < 2**31 else 0)

    def _enqueue(self, name: str, memory: OpenCLMemory, *args: Any, items: int | None = None) -> None:
        """Start a kernel of `_STATUS` over the elements of a memory."""
        self.each(_status_text(WORDS[memory.dtype.itemsize]), name, items or memory.count, args)

    def each(self, text: str, name: str, count: int, args: Sequence[Any]) -> None:
        """Start a kernel with a work item for each of `count` elements; its last argument is their number."""
        self.enqueue(text, name, count, (*args, np.uint64(count)), group=LOCAL_SIZE)

    def enqueue(
        self, text: str, name: str, items: int, args: Sequence[Any], *, group: int = 1, brief: bool = False
    ) -> None:
        """Start a kernel of a text over this number of work items; programs are cached by their text.

        The number is rounded up to whole groups of size `group`; the kernel has to ignore the idle items.
        """
        machine = self.machine
        with machine.lock:
            if group > 1 and (name, text) not in self._kernels:
                items = max(items, ANY_SIZE)
            kernel = self._kernels.get((name, text), lambda: machine.kernel(machine.build(text), name, args))
            kernel.set_args(*args)
            machine.cl.enqueue_nd_range_kernel(machine.queue, kernel, (-(-items // group) * group,), (group,))
            machine.may_take_long |= not brief
            self._count_one()

    def _count_one(self) -> None:
        """Count a run, and wait once too many have been started."""
        self.machine.started += 1
        if self.machine.started >= _AHEAD:
            self.finish()

    def on_device(self, function: Callable[..., Any], natives: list[Any]) -> Any:
        """Call `function` in this thread, as any thread may use the arrays."""
        return function(*natives)

    def start(self, runs: Iterable[Callable[[], None]]) -> None:
        """Start runs on the queue, in order."""
        machine = self.machine
        with machine.lock:
            for run in runs:
                run()
                self._count_one()
            machine.queue.flush()

    def padding(self, packed: OpenCLMemory, padded: OpenCLMemory) -> Callable[[], None]:
        """Return a run that copies vectors of three to vectors of four, the form of the tables of packets."""
        text = _PAD.replace("WORD", WORDS[packed.dtype.itemsize])
        # The run holds `padded`, since memory without an owner returns to the pool.
        return lambda: self.each(text, "pad", padded.count, (packed.buffer, padded.buffer))

    def finish(self, *, copies: bool = False) -> None:
        """Wait until everything that was started has ended; Ctrl-C ends the wait.

        `copies`: the caller copies to the host next, which waits for brief runs by itself.
        """
        self.machine.settle(copies=copies)


def own(memory: Any) -> OpenCLMemory:
    """Return the argument as an OpenCLMemory; all memory that reaches this space is of this class."""
    assert isinstance(memory, OpenCLMemory)
    return memory


_Copies = dict[Any, tuple[int, Any, bool]]
"""For each layout of the elements: the version of the data, the buffer, and whether changed parts are sent to it."""


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
            # Lent and small buffers are replaced after a change, since commands to a queue would take longer.
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


tables_of = once(Tables)
"""Return the tables of a device."""


def _as_held(array: Array, dtype: Any, padded: bool) -> Array:
    """Return elements of a table as a buffer holds them; `padded` as in `Tables.buffer`."""
    array = np.ascontiguousarray(array, dtype=dtype)
    return np.concatenate([array, array[..., :1]], axis=-1) if padded else array
