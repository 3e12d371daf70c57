"""Kernels on an OpenCL device: runs over arrays and over memory of the device, as one or several dispatches.

Stage: run. A run brings inputs, tables and params to the device, launches one work item for each element or packet, and
brings the outputs back. A processor's kernels work on the arrays themselves. Arrays of another width than the kernel's
(float16 for f at f16, bools) are converted on the host. Of a run over a few elements, most time goes into making
buffers and setting arguments: such a run is staged, through arrays that the device knows already, with a kernel object
of its own.

PoCL generates code anew for each local size, for a global offset that is not 0, and for the first launch of 65,535 or
more work items along an axis. So a kernel has one local size, its second argument is where a dispatch begins, and its
first launch has `driver.ANY_SIZE` work items, most of them idle: that code serves smaller launches too. `Pace` decides
how many dispatches a run has.

    status = executable.run(call)
    start = executable.ready(device_call)        # for `Space.start`
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from shpy.backend.base import Array, Call, DeviceCall, TableMemory
from shpy.backend.device.pace import Pace, Watch
from shpy.backend.device.pool import Recent
from shpy.backend.opencl.device.arguments import argument, argument_dtype, extents
from shpy.backend.opencl.device.driver import ANY_SIZE, LOCAL_SIZE, Machine
from shpy.backend.opencl.device.memory import MEMORY, own, tables_of
from shpy.backend.opencl.device.outputs import collect, hand_over, outputs_of, shape_of
from shpy.backend.opencl.text.kernel import KernelText
from shpy.errors import BackendUnavailable, warn
from shpy.ir.nodes import Loc, Table
from shpy.ir.tabledata import TableData
from shpy.ir.types import Type, vec
from shpy.passes.pipeline import PreparedModule

HURRIED: Final = "built without the driver's optimization, until this has paid"
_WIDE: Final = 32
"""Images of fewer columns run as lists, since too many lanes of their packets would be idle."""
_SMALL: Final = 1 << 15
"""The most bytes of all inputs and outputs together. To copy more takes longer than to lend the arrays."""
_SHAPES: Final = 8
"""The most shapes of small runs for which a kernel keeps arrays."""
_LAUNCHES: Final = 64
"""The most launches that a kernel keeps."""
_BEGINS: Final = np.int32, np.uint64
"""The types of the argument by which a dispatch begins: a line of packets, or an element."""
_WHOLE, _SHARED = np.int32(1), np.int32(0)
"""The argument that tells whether each work item reads an element of its own, or all read one."""
_ALIGNMENT: Final = 128
"""Bytes: the size of the longest vector of OpenCL, to which the memory of a buffer has to be aligned."""


@dataclass(slots=True)
class OpenCLExecutable:
    """A kernel on a device: see `base.Executable`."""

    machine: Machine
    kernel: KernelText
    prepared: PreparedModule
    program: Any
    pace: Pace
    group: int
    remarks: tuple[str, ...] = ()
    compiled: Any = None
    """The kernel object that runs over arrays share: `warm_up` makes it."""
    stages: Recent[tuple[Any, ...], Staging] = field(default_factory=lambda: Recent(_SHAPES))
    """Arrays for small runs, by the shape of the run and the lengths of its inputs."""
    spare: list[Any] = field(default_factory=list)
    """Kernel objects that no run uses, for the next runs."""
    launches: Recent[tuple[Any, ...], Launch] = field(default_factory=lambda: Recent(_LAUNCHES))
    """The launches of `compiled`, by the shape and by whether the caller reads the results next."""
    optimize: Callable[[], Any] | None = None
    """Builds the program again, optimized, for a kernel that was built in a hurry; its pace tells when that pays."""

    @property
    def source(self) -> str:
        """The kernel's text."""
        return self.kernel.text

    @property
    def lanes(self) -> int:
        """Elements of a packet."""
        return self.kernel.lanes

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the faults of the device, and why elements run one at a time where packets were tried."""
        return (*self.machine.notes, *self.remarks, *((HURRIED,) if self.hurried else ()))

    @property
    def hurried(self) -> bool:
        """Return whether an optimized program may replace the present one."""
        return isinstance(self.pace, Watch) and self.pace.watches

    @property
    def loops(self) -> tuple[Loc | None, ...]:
        """The lines of the limited loops."""
        return self.prepared.loops

    @property
    def writes_all(self) -> bool:
        """Return whether no element has a status."""
        return not self.prepared.status

    def warm_up(self) -> None:
        """Launch the kernel once with idle work items, since drivers generate code for any size at the first launch."""
        self.compiled = self._launched(self.program)

    def _launched(self, program: Any) -> Any:
        """Return a kernel object of a program, launched once."""
        machine, entry, module = self.machine, self.prepared.module.entry, self.prepared.module
        empty = machine.take(LOCAL_SIZE)
        inputs = [(empty, 0) for _ in self.kernel.inputs]
        tables = [(empty, argument(np.ones(t.rank, np.int32))) for t in self.kernel.tables]
        params = {p.name: np.zeros(p.type.size, argument_dtype(p.type)) for p in module.params}
        leading = self._leading((1,) * self.kernel.grid)
        args = self._arguments(leading, inputs, tables, params, [empty for _ in entry.outputs])
        compiled = machine.kernel(program, self.kernel.name, args)
        compiled.set_args(np.uint64(0), *args[1:])
        enqueue = machine.cl.enqueue_nd_range_kernel
        machine.waiter.wait(enqueue(machine.queue, compiled, (ANY_SIZE, 1), (self.group, 1)))  # Ctrl-C is heard
        machine.give_back([empty])
        return compiled

    def _renew(self) -> None:
        """Replace the program by the optimized one if that pays now; runs take kernel objects of it from then on."""
        watch = self.pace
        if not isinstance(watch, Watch) or not watch.pays:
            return
        assert self.optimize is not None  # there is a Watch
        try:
            program = self.optimize()
            compiled = self._launched(program)
            self.program, self.compiled = program, compiled
            self.stages, self.spare, self.launches = Recent(_SHAPES), [], Recent(_LAUNCHES)
        except (self.machine.cl.Error, BackendUnavailable) as error:
            remark = f"stays slower than it could be on OpenCL: the driver does not optimize it ({error})"
            warn(f"{self.prepared.module.entry.loc}: {self.prepared.module.name} {remark}")
        watch.end()  # the last step: after Ctrl-C at any line before it, the next run does all of this again
        self.optimize = None

    def run(self, call: Call) -> Array | None:
        """Run the kernel; return the status of each element, or None if all elements are written."""
        with self.machine.lock:
            used: list[Any] = []
            lent: list[Any] = []
            try:
                staged = self.machine.shares_memory and not self.kernel.tables and is_small(call)
                status = self._run_staged(call) if staged else self._run(call, used, lent)
            except BaseException as error:
                self.machine.abandon((used, lent, call))
                if isinstance(error, self.machine.cl.MemoryError):
                    raise MemoryError from error
                raise
            self.machine.give_back(used)
            return status

    def _run(self, call: Call, used: list[Any], lent: list[Any]) -> Array | None:
        """Run over buffers, which join `used`, and arrays, which join `lent`: the device may need them after Ctrl-C."""
        machine, entry = self.machine, self.prepared.module.entry
        inputs: list[tuple[Any, int]] = []
        for i in self.kernel.inputs:
            type = entry.inputs[i].type
            array = np.ascontiguousarray(call.inputs[i], dtype=MEMORY[type.base])
            buffer = machine.lend(array, type.size)
            if buffer is None:
                buffer = machine.upload(array)
                used.append(buffer)
            else:
                lent.append((buffer, array))
            inputs.append((buffer, len(array)))
        tables = [self._table(call.tables[table.name], table)[:2] for table in self.kernel.tables]
        outputs = outputs_of(machine, self.prepared, call, used)
        lent.append(outputs)
        launch = self._launch(call.shape, reads=True)
        args = self._arguments(launch.leading, inputs, tables, call.params, [output.buffer for output in outputs])
        launch.start(args)
        return collect(machine, self.prepared, call, outputs)

    def _run_staged(self, call: Call) -> Array | None:
        staged = self.stages.get((call.shape, *map(len, call.inputs)), lambda: self._stage(call))
        for i, array in staged.inputs:
            np.copyto(array, call.inputs[i], casting="unsafe")
        if self.kernel.params:
            staged.set_params(self._params(call.params))
        staged.start()
        for array, buffer in zip(staged.outputs, staged.buffers, strict=True):
            self.machine.download(array, buffer)  # 12 µs less than to map the memory of an array, of 46 for a call
        return hand_over(self.prepared, call, staged.outputs)

    def _stage(self, call: Call) -> Staging:
        """Make arrays for runs of this shape, and a kernel object with them as arguments."""
        machine, entry, kernel = self.machine, self.prepared.module.entry, self.kernel
        inputs = [_staged_array(machine, entry.inputs[i].type, len(call.inputs[i])) for i in kernel.inputs]
        outputs = [np.empty(shape_of(slot.type, call.count), MEMORY[slot.type.base]) for slot in entry.outputs]
        buffers = [machine.take(array.nbytes) for array in outputs]
        leading = self._leading(call.shape)
        args = self._arguments(leading, [(buffer, len(a)) for a, buffer in inputs], (), call.params, buffers)
        first = len(args) - len(buffers) - len(kernel.params)
        compiled = machine.kernel(self.program, kernel.name, args if kernel.params else ())
        compiled.set_args(*args)
        start = self._starter(compiled, args, call.shape, self.program, reads=True)

        def set_params(values: list[Any]) -> None:
            args[first : first + len(values)] = values
            compiled.set_args(*args)

        arrays = [(i, array) for i, (array, _) in zip(kernel.inputs, inputs, strict=True)]
        return Staging(arrays, outputs, buffers, set_params, start)

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over buffers of the device: see `base.Executable`."""
        if not math.prod(call.shape):
            return lambda: None
        inputs = [(own(memory).buffer, memory.count) for memory in map(call.inputs.__getitem__, self.kernel.inputs)]
        results = [own(m).buffer for m in (*call.outputs, *(() if call.status is None else (call.status,)))]
        assert len(results) == len(self.prepared.module.entry.outputs)
        with self.machine.lock:
            tables = [self._table(call.tables[table.name], table) for table in self.kernel.tables]
            launch = self._launch(call.shape, reads=False) if once else None
            leading = self._leading(call.shape) if launch is None else launch.leading
            args = self._arguments(leading, inputs, [table[:2] for table in tables], call.params, results)
            run = self._repeated(args, call.shape) if launch is None else partial(launch.start, args)
        copies = [copy for _, _, copy in tables if copy is not None]
        if not copies:
            return run

        def start() -> None:
            for step in (*copies, run):
                step()

        return start

    def _repeated(self, args: list[Any], shape: tuple[int, ...]) -> Callable[[], None]:
        """Return a function that runs the kernel with these arguments, over a shape, again and again.

        A kernel object holds its arguments, so each repeated run has its own. To make an object takes longer than a
        small run, so the objects of runs that were deleted are used again.
        """
        # Another thread may replace the program before the run starts: a run that takes the earlier one is renewed.
        program, spare = self.program, self.spare
        compiled = self._spare_kernel(program, spare)
        compiled.set_args(*args)
        run = self._starter(compiled, args, shape, program, reads=False)
        weakref.finalize(run, spare.append, compiled).atexit = False
        return run

    def _spare_kernel(self, program: Any, spare: list[Any]) -> Any:
        try:
            return spare.pop()  # at once: another thread may take the last one
        except IndexError:
            return self.machine.cl.Kernel(program, self.kernel.name)

    def _table(self, data: TableData | TableMemory, table: Table) -> tuple[Any, Any, Callable[[], None] | None]:
        """Return a table's buffer and shape, and a function that updates it before each run, or None."""
        machine = self.machine
        padded = self.kernel.lanes > 1 and table.type.size == 3
        if isinstance(data, TableMemory):
            memory = own(data.memory)
            shape = extents(data.shape)
            if not padded:
                return memory.buffer, shape, None
            wide = memory.space.allocate(memory.count, vec(table.type.base, 4), memory.dtype)
            return wide.buffer, shape, memory.space.padding(memory, wide)
        dtype = np.dtype(MEMORY[table.type.base])
        shape = extents(data.array.shape[: table.rank])
        return tables_of(machine).buffer(data, dtype, table.type.size, padded=padded), shape, None

    def _leading(self, shape: tuple[int, ...]) -> list[Any]:
        """Return the first of the kernel's arguments, see `KernelText`, which depend on the shape alone."""
        kernel = self.kernel
        args: list[Any] = [np.uint64(math.prod(shape)), _BEGINS[kernel.lanes == 1](0)]
        if kernel.lanes > 1 and not kernel.listed:
            args.append(np.int32(self._row_length(shape)))
        if kernel.grid:
            args.append(extents(shape))
        return args

    def _arguments(
        self,
        leading: list[Any],
        inputs: Iterable[tuple[Any, int]],
        tables: Iterable[tuple[Any, Any]],
        params: dict[str, Array],
        outputs: Iterable[Any],
    ) -> list[Any]:
        """Return the kernel's arguments from buffers: each input's with its number of elements."""
        args, count = leading.copy(), int(leading[0])
        for buffer, length in inputs:
            args += (buffer, _WHOLE if length == count else _SHARED)
        for table in tables:
            args += table
        if self.kernel.params:
            args += self._params(params)
        args += outputs
        return args

    def _params(self, params: dict[str, Array]) -> list[Any]:
        types = {p.name: p.type for p in self.prepared.module.params}
        return [
            argument(np.asarray(params[name], argument_dtype(types[name])), types[name]) for name in self.kernel.params
        ]

    def _row_length(self, shape: tuple[int, ...]) -> int:
        """Return the number of elements side by side: a packet of an image is a block, that of a list a row."""
        *others, last = shape or (1,)
        columns = self.kernel.columns
        is_image = (
            columns < self.kernel.lanes and last >= _WIDE and math.prod(shape) >= last * (self.kernel.lanes // columns)
        )
        return last if others and (is_image or self.kernel.grid) else columns

    def _launch(self, shape: tuple[int, ...], *, reads: bool) -> Launch:
        """Return the launch over a shape of the kernel object that all runs share; the lock is held."""
        if self.hurried:
            return Launch(self._leading(shape), partial(self._start_hurried, shape, reads))
        return self.launches.get((shape, reads), lambda: self._new_launch(shape, reads=reads))

    def _new_launch(self, shape: tuple[int, ...], *, reads: bool) -> Launch:
        compiled = self.compiled
        run = self._starter(compiled, [], shape, self.program, reads=reads)

        def start(args: list[Any]) -> None:
            compiled.set_args(*args)
            run()

        return Launch(self._leading(shape), start)

    def _start_hurried(self, shape: tuple[int, ...], reads: bool, args: list[Any]) -> None:
        """Run the shared kernel object of a program that the optimized one may replace in between."""
        self.compiled.set_args(*args)
        self._starter(self.compiled, args, shape, self.program, reads=reads, shared=True)()

    def _starter(
        self, compiled: Any, args: list[Any], shape: tuple[int, ...], program: Any, *, reads: bool, shared: bool = False
    ) -> Callable[[], None]:
        """Return a function that runs a kernel of a program over a shape: see `starter`. The kernel has `args`."""
        items = self._items(shape)
        each = self.kernel.lanes if self.kernel.packets == 1 else -(-math.prod(shape) // items.columns)

        def renewed() -> Any:
            self._renew()
            if self.program is program:
                return None
            kernel = self.compiled if shared else self.machine.cl.Kernel(self.program, self.kernel.name)
            kernel.set_args(*args)
            return kernel

        renew = renewed if self.hurried or self.program is not program else None
        machine, begins = self.machine, _BEGINS[self.kernel.lanes == 1]
        return starter(machine, compiled, items, self.group, self.pace, each, begins, reads=reads, renew=renew)

    def _items(self, shape: tuple[int, ...]) -> Items:
        """Return the work items of a run: one for each element, packet or part of a line; packets in columns."""
        count = math.prod(shape)
        if self.kernel.lanes == 1:
            return Items(count)
        columns, row = self.kernel.columns, self._row_length(shape)
        lines = -(-count // (row * (self.kernel.lanes // columns)))
        if self.kernel.packets > 1:
            return Items(lines * -(-row // (self.kernel.packets * columns)))
        return Items(lines) if row == columns else Items(-(-row // columns), lines)


def is_small(call: Call) -> bool:
    """Return whether it is faster to copy the arrays of a run than to lend them."""
    return sum(a.nbytes for a in call.inputs) + sum(a.nbytes for a in call.outputs) <= _SMALL


@dataclass(slots=True)
class Staging:
    """Arrays for one shape of run: `start` starts the kernel on them, with the params that were set last."""

    inputs: list[tuple[int, Array]]
    outputs: list[Array]
    buffers: list[Any]
    set_params: Callable[[list[Any]], None]
    start: Callable[[], None]


def _staged_array(machine: Machine, type: Type, count: int) -> tuple[Array, Any]:
    """Return an array for `count` elements of a type, and the buffer whose memory it is."""
    dtype, shape = np.dtype(MEMORY[type.base]), shape_of(type, count)
    size = math.prod(shape) * dtype.itemsize
    room = np.empty(size + 2 * _ALIGNMENT, np.uint8)
    first = -room.__array_interface__["data"][0] % _ALIGNMENT
    array = room[first : first + size].view(dtype).reshape(shape)
    flags = machine.cl.mem_flags
    return array, machine.cl.Buffer(machine.context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=array)


class Launch(NamedTuple):
    """Runs over one shape: their first arguments, and the function that runs the kernel with all of them.

    Where it is kept, a call over streams takes 73 µs of CPU for 84, most of it in PoCL's threads.
    """

    leading: list[Any]
    start: Callable[[list[Any]], None]


class Items(NamedTuple):
    """The work items of a run: those of a list if `lines` is None, else `columns` work items in each line."""

    columns: int
    lines: int | None = None


def starter(
    machine: Machine,
    kernel: Any,
    items: Items,
    group: int,
    pace: Pace,
    each: int,
    begins: Callable[[int], Any],
    *,
    reads: bool,
    renew: Callable[[], Any] | None = None,
) -> Callable[[], None]:
    """Return a function that runs a kernel, whose arguments are set, over work items that stand for `each` elements.

    As many idle ones fill each line's last group. A dispatch begins with a line, or with a group of a list; see `Pace`
    for how many there are and what `reads` means. `begins` converts the beginning of a dispatch to its argument. Before
    each dispatch `renew` returns a kernel object that replaces the kernel from then on, or None.
    """
    groups = max(1, -(-items.columns // group))
    listed = items.lines is None
    rows, width, step = (groups, group, group) if items.lines is None else (items.lines, items.columns, 1)
    least = -(-machine.device.max_compute_units * group // width)  # each core should have a group
    elements = rows * width * each
    enqueue, queue = machine.cl.enqueue_nd_range_kernel, machine.queue
    moved = False  # whether the kernel may hold another beginning than 0, also after Ctrl-C at any line

    def dispatch(first: int, count: int) -> Any:
        nonlocal moved, kernel, renew
        if renew is not None and (newer := renew()) is not None:
            kernel, renew, moved = newer, None, False
        size = (count * group, 1) if listed else (groups * group, count)
        if not reads:
            machine.may_take_long |= not pace.was_brief(elements)
        if first or moved:
            moved = True
            kernel.set_arg(1, begins(first * step))
            moved = first > 0
        return enqueue(queue, kernel, size, (group, 1))

    return pace.driver(rows, dispatch, machine.waiter.wait, width * each, least, reads=reads)
