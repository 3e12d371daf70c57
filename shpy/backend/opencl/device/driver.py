"""OpenCL devices: contexts, queues, programs in memory, and buffers that are used again.

Stage: run. Everything of pyopencl that the runtime touches is here.

    machine = machine_of(None)               # the first device
    program = machine.build(text)            # cached by its text
    with machine.lock:
        buffer = machine.take(4096)
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Container, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from platform import machine as architecture
from typing import Any, ClassVar, Final
from weakref import WeakValueDictionary

import numpy as np

from shpy.backend.base import Array, Device
from shpy.backend.device import store
from shpy.backend.device.once import once, once_of_each
from shpy.backend.device.pool import Kind, Pool, rounded
from shpy.backend.device.probe import COUNT, FAULTS, PROBED, hard_inputs, notes_of, wrong_operations
from shpy.backend.device.processes import Driver, at_exit
from shpy.backend.opencl.device.buffers import new_buffer
from shpy.backend.opencl.device.compiler_trials import (
    MEMORY,
    SIZES,
    TRIALS,
    most_private,
    name_of,
    outcomes_here,
    thread_stack,
)
from shpy.backend.opencl.device.declarations import GUARD, declarations
from shpy.backend.opencl.device.loading import POCL, explain_absence, explain_cache, pyopencl
from shpy.backend.opencl.device.probes import ABILITIES, BINARY64, EXACTNESS, abilities_in_binary64
from shpy.backend.opencl.device.trial import DECLARES, Trial, Unfinished, works
from shpy.backend.opencl.device.waiting import Waiter
from shpy.backend.opencl.packets.prologue import GUESSES, SIGNS, TRUNCATIONS, Abilities
from shpy.backend.opencl.packets.widen import WIDER, WIDTHS
from shpy.errors import BackendUnavailable, ShpyTypeError, warn
from shpy.ieee import ieee_arithmetic, in_ieee_arithmetic, was_flushing
from shpy.ir.ops import TRANSCENDENTALS
from shpy.passes.library import CORRECTABLE
from shpy.passes.modes import Math
from shpy.passes.pipeline import Target

TARGET: Final = Target("opencl", native=TRANSCENDENTALS)
SLOW: Final = frozenset("pow sin cos tan sinh cosh erf erfc log2 expm1".split())
"""Functions of vectors that take longer in PoCL 3.1 than our formulas do: relaxed mode does not call them.

With the formulas, `pow` takes .34 of the CPU time, and a sum of the nine others .36 (`scripts/decisions powers
functions`). PoCL's `pow` of doubles is wrong beside an infinity, and its sin, cos and tan near zero beside a number far
from it.
"""
PACKET_TARGET: Final = replace(TARGET, vector=True, native=TRANSCENDENTALS - SLOW, fast=SLOW - {"pow"})
LOCAL_SIZE: Final = 64
"""Work items of a group."""
ANY_SIZE = 1 << 16
"""Work items of the first launch of a kernel; all of them are idle, so it takes microseconds on any device."""
_LEAST = 64
"""Bytes of the smallest buffer."""
_TRIED_HERE: Final = "trials that a process ran itself"
"""The list of trials, by their keys, that some process has begun to run itself."""
_NOT_OPTIMIZED: Final = "-cl-opt-disable"
_FEW: Final = 16
"""The most brief runs for which a wait need not be interruptible."""


_DRIVER = Driver("opencl")


def _driver_devices() -> tuple[Any, ...]:
    """Return every device, GPUs first; BackendUnavailable without one, and in a process that was forked too late."""
    _DRIVER.use()  # before a lock that another thread of the parent may have held
    return _listed()


@once
def _listed() -> tuple[Any, ...]:
    _DRIVER.use()
    platforms: list[Any] = []
    try:
        cl = pyopencl()
        with suppress(cl.Error), ieee_arithmetic():  # the driver may start threads, which compute as this one does
            platforms = cl.get_platforms()
            if all_devices := [d for platform in platforms for d in platform.get_devices()]:
                return tuple(sorted(all_devices, key=lambda d: not d.type & cl.device_type.GPU))
        raise explain_absence([platform.name.strip() for platform in platforms])
    except BackendUnavailable:
        _DRIVER.release()
        raise


def devices() -> list[Device]:
    """Return every OpenCL device of every platform, GPUs first; BackendUnavailable when there is none."""
    return [
        Device(
            d.name.strip(),
            f"{d.platform.name.strip()}, {d.version.strip()}, driver {d.driver_version.strip()}",
            tuple(name for name, extension in _FEATURES.items() if extension in d.extensions.split()),
            machine_of(at).notes,
        )
        for at, d in enumerate(_driver_devices())
    ]


_FEATURES = {"f64": "cl_khr_fp64", "f16": "cl_khr_fp16"}


def _built_silently(program: Any, options: list[str]) -> Any:
    """Build a program without pyopencl's warning about build logs, which some drivers write after each build."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return program.build(options=options, cache_dir=False)


def machine_of(index: int | None) -> Machine:
    """Return the device of this index in `devices()`, the first for None; a process opens each device once."""
    all_devices = _driver_devices()
    index = index or 0
    if not 0 <= index < len(all_devices):
        raise ShpyTypeError(f"there is no OpenCL device {index}", cure=f"device=0 to {len(all_devices) - 1}")
    return _opened(index)


@once
def _opened(index: int) -> Machine:
    return Machine(_listed()[index])


@lru_cache(maxsize=256)
def kind_of(size: int) -> Kind:
    """Return the kind of the buffers with at least `size` bytes."""
    return Kind(rounded(max(size, _LEAST)))


class Machine:
    """One device with its context and queue. `lock` is held while its buffers and kernels are in use."""

    worth_lending: ClassVar = 1 << 16
    """Bytes: smaller arrays are copied in less time than it takes to make a buffer of their memory."""

    def __init__(self, device: Any) -> None:
        fault = explain_cache([device.platform.name.strip()])
        if fault is not None:
            raise fault
        self.cl = pyopencl()
        self.device = device
        with ieee_arithmetic():
            self.context = self.cl.Context([device])
            self.queue = self.cl.CommandQueue(self.context)
        self._lock = threading.RLock()
        self.waiter = Waiter(self._lock)
        at_exit(self.waiter.end)
        self.doubles = "cl_khr_fp64" in device.extensions.split()
        self.denormals = bool(device.single_fp_config & self.cl.device_fp_config.DENORM)
        """True if the driver promises that its own functions keep denormals."""
        self._options = ["-cl-std=CL1.2", "-w"]
        if device.single_fp_config & self.cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT:
            self._options.append("-cl-fp32-correctly-rounded-divide-sqrt")
        # Whoever runs a program keeps it: once its last executable is gone, so is the program.
        self._programs: WeakValueDictionary[tuple[str, Math, bool], Any] = WeakValueDictionary()
        self.pool = Pool()
        self._uploads: list[Any] = []
        """Copies to the device that may be in progress, with their arrays, and memory that runs may still read."""
        self.started = 0
        """The number of runs over streams that were started since the last wait."""
        self.may_take_long = False
        """True if one of these runs may take long."""

    @property
    def lock(self) -> AbstractContextManager[Any]:
        """The device's lock. Raises BackendUnavailable in a process that was forked after the device was opened."""
        _DRIVER.use()
        return self._lock

    def options(self, math: Math) -> list[str]:
        """Return the options with which a program of this mode is built."""
        return [*self._options, "-cl-fast-relaxed-math"] if math == "fast" else self._options

    def build(self, text: str, math: Math = "strict", *, hurried: bool = False) -> Any:
        """Return the program of this text, built once; raises pyopencl's error if the driver refuses it.

        `hurried`: the driver does not optimize it, which `hurries` says to be quicker.
        """
        program = self._programs.get((text, math, hurried))
        if program is None:
            options = [*self.options(math), _NOT_OPTIMIZED] if hurried else self.options(math)
            program = self._programs[text, math, hurried] = self._compiled(text, options)
        return program

    def _compiled(self, text: str, options: list[str]) -> Any:
        """Return the program of a text, which declares the functions that it calls where that takes less time."""
        if DECLARES in self._succeeded:
            try:
                declared = declarations(text, doubles=self.doubles) + text
                return _built_silently(self.cl.Program(self.context, declared), [*options, GUARD])
            except self.cl.Error:
                pass  # the fault is in the text, or a declaration is missing: the whole header tells
        return self._compiled_with_header(text, options)

    def _compiled_with_header(self, text: str, options: list[str]) -> Any:
        """Return the program of a text that relies on the declarations of the driver."""
        try:
            return _built_silently(self.cl.Program(self.context, text), options)
        except self.cl.Error as error:
            fault = explain_cache([self.device.platform.name.strip()])
            if fault is not None:
                raise fault from error
            raise

    def key(self, text: str, options: list[str]) -> str:
        """Return the key of what depends on a text, options, the device and its driver."""
        device = self.device
        parts = (device.platform.name, device.platform.version, device.name, device.version, device.driver_version)
        return store.key("opencl", *parts, " ".join(options), text)

    def kernel(self, program: Any, name: str, args: Sequence[Any] = ()) -> Any:
        """Return a new kernel object, to be told often of arguments of the kinds of `args`, or once.

        pyopencl asks of each argument whether it is a buffer, unless it knows that beforehand: microseconds of CPU to
        set six of them, of which four are numbers, 0.7 for 35. The object itself then takes 150 more to make. Numbers
        are passed as bytes, since pyopencl would make a float of a float, and a NaN may lose bits.
        """
        kernel, buffer = self.cl.Kernel(program, name), self.cl.MemoryObjectHolder
        if args:
            types = [None if a is None or isinstance(a, buffer) else np.dtype((np.void, a.nbytes)) for a in args]
            kernel.set_arg_types(types)
        return kernel

    def take(self, size: int) -> Any:
        """Return a buffer of at least `size` bytes; the caller gives it back."""
        return self.take_of(kind_of(size))

    def take_of(self, kind: Kind) -> Any:
        """Return a buffer of a kind of `kind_of`."""
        return self.pool.take(kind, lambda: new_buffer(self, kind.bytes))

    def give_back(self, buffers: list[Any]) -> None:
        """Return buffers to the pool, after the device has finished with them."""
        self._uploads.clear()
        for buffer in buffers:
            self.pool.give_back(Kind(buffer.size), buffer)

    @cached_property
    def shares_memory(self) -> bool:
        """Return whether the device uses the host's memory, so that arrays need not be copied."""
        return self.is_cpu and bool(self.device.host_unified_memory)

    def lend(self, array: Array, size: int, *, write: bool = False) -> Any:
        """Return a buffer that is the array's own memory; None if it has to be copied.

        `size`: the components of an element, to whose size a kernel may expect memory to be aligned.
        """
        aligned = array.itemsize * (4 if size == 3 else size)
        place = array.__array_interface__["data"][0]
        if not self.shares_memory or array.nbytes < self.worth_lending or place % aligned:
            return None
        flags = self.cl.mem_flags
        access = flags.READ_WRITE if write else flags.READ_ONLY
        return self.cl.Buffer(self.context, access | flags.USE_HOST_PTR, hostbuf=array)

    def settle(self, *, copies: bool = False) -> None:
        """Wait until all runs over streams that were started have ended; Ctrl-C ends the wait.

        `copies`: the caller copies to the host next, which waits for brief runs by itself. Nothing runs for a process
        that was forked from the one that opened the device.
        """
        if not self.started or _DRIVER.is_elsewhere:
            return
        with self.lock:
            if self.started <= _FEW and not self.may_take_long:
                if not copies:
                    self.queue.finish()  # to wake the thread that waits would take as long as these runs
            else:
                self.waiter.wait(self.cl.enqueue_marker(self.queue))
            self.started, self.may_take_long = 0, False  # not after Ctrl-C: what was started still runs

    def outlive(self, things: Sequence[Any]) -> None:
        """Hold memory without another owner until the runs over streams that may read it have ended."""
        if self.started:
            self._uploads.extend(things)

    def finish(self, lent: list[Any]) -> None:
        """Wait until the queue is empty, and make results visible in lent arrays."""
        for buffer in lent:
            access = self.cl.map_flags.READ
            mapped, _ = self.cl.enqueue_map_buffer(self.queue, buffer, access, 0, (buffer.size,), np.uint8)
            mapped.base.release(self.queue)
        self.queue.finish()

    def abandon(self, things: Any) -> None:
        """Hold the memory of an interrupted run until the device has finished with it."""
        self.waiter.keep(self.cl.enqueue_marker(self.queue), (things, self._uploads))
        self._uploads = []

    def upload(self, array: Array) -> Any:
        """Return a buffer that holds the array."""
        buffer = self.take(array.nbytes)
        self._uploads.append(self.cl.enqueue_copy(self.queue, buffer, array, is_blocking=False))
        return buffer

    def download(self, array: Array, buffer: Any, offset: int = 0) -> None:
        """Read the buffer, from a byte on, into the array."""
        self.cl.enqueue_copy(self.queue, array, buffer, src_offset=offset)

    @property
    def lanes(self) -> int:
        """The elements of a CPU's vector register; 1 on any other device."""
        native = self.device.native_vector_width_float if self.is_cpu else 1
        return max((w for w in WIDTHS if w <= native), default=1)

    @once_of_each
    def wrong(self) -> frozenset[str]:
        """Return the operations with wrong results on this device: probed once."""
        return self._answered(EXACTNESS, FAULTS, self._asked)

    def _answered(self, text: str, possible: Container[str], ask: Callable[[], frozenset[str]]) -> frozenset[str]:
        """Return what a probe's text tells, stored on disk.

        Where another library makes threads flush denormals, the driver's threads may flush them too; the result then
        holds for this process alone.
        """
        return ask() if was_flushing() else store.known_names(self.key(text, self._options), possible, ask)

    def target(self, lanes: int, math: Math) -> Target:
        """Return the target of packets, or of single elements, with the abilities of this device.

        Only strict mode uses those in binary64, so other modes do not wait for their probe.
        """
        doubles = self.binary64 if math == "strict" else frozenset()
        target = PACKET_TARGET if lanes > 1 else TARGET
        return replace(target, wrong=self.wrong & CORRECTABLE, doubles="exact" in doubles, fuses="fused" in doubles)

    @property
    def notes(self) -> tuple[str, ...]:
        """Return facts about this device for the user."""
        return notes_of(self.wrong, binary64="exact" in self.binary64)

    @in_ieee_arithmetic
    def _asked(self) -> frozenset[str]:
        """Probe the device: return the names of its faults; BackendUnavailable if it refuses the kernel."""
        lanes = self.lanes
        text = EXACTNESS.replace("WIDE", str(lanes) if lanes > 1 else "")
        results, ints = np.empty((7, COUNT), np.float32), np.empty((4, COUNT), np.int32)
        try:
            self.probe(text, (*hard_inputs(), np.full(COUNT, np.nan, np.float32)), (results, ints))
        except self.cl.Error as error:
            name = self.device.name.strip()
            raise BackendUnavailable(f"{name} refuses a small kernel of OpenCL C 1.2 ({error})") from error
        wrong = wrong_operations({**dict(zip(PROBED, results, strict=False)), "convert": ints[0]})
        others = zip(("convert_nan", "zeros", "exits"), ints[1:], strict=True)
        return wrong | {name for name, differences in others if differences.any()}

    @in_ieee_arithmetic
    def probe(self, text: str, arrays: Sequence[Array], results: Sequence[Array]) -> None:
        """Run the kernel `probe` of a text over COUNT elements in packets; return the output arrays."""
        with self.lock:
            program = self._compiled(text, self._options)
            kernel = self.cl.Kernel(program, "probe")
            inputs, outputs = [self.upload(array) for array in arrays], [self.take(array.nbytes) for array in results]
            kernel.set_args(*inputs, *outputs)
            self.cl.enqueue_nd_range_kernel(self.queue, kernel, (COUNT // self.lanes,), None)
            for array, buffer in zip(results, outputs, strict=True):
                self.download(array, buffer)
            self.queue.finish()
            self.give_back([*inputs, *outputs])

    @once_of_each
    def binary64(self) -> frozenset[str]:
        """Return the abilities of this device in binary64, of ABILITIES: probed once."""
        if not self.doubles:
            return frozenset()
        ask = partial(abilities_in_binary64, self.probe, lanes=self.lanes, flushed="denormals" in self.wrong)
        return self._answered(BINARY64, ABILITIES, ask)

    @once_of_each
    def _succeeded(self) -> frozenset[str]:
        """Return the names of the TRIALS that succeed: run once for each driver version, and stored on disk."""
        reads_header = self._is_pocl  # again for each program
        trials = {name: trial for name, trial in TRIALS.items() if reads_header or name != DECLARES}
        return self._tried(trials, trials)

    @once_of_each
    def _holds(self) -> int:
        """Return the most bytes of private memory of the trials in MEMORY: tried when a kernel has local arrays."""
        largest = max((size for size in SIZES if size <= (thread_stack() or 0) * 3 // 4), default=None)
        names = self._tried(MEMORY, {} if largest is None else {name_of(largest): MEMORY[name_of(largest)]})
        return max((size for size in SIZES if name_of(size) in names), default=0)

    def _tried(self, trials: Mapping[str, Trial], harmless: Mapping[str, Trial]) -> frozenset[str]:
        """Return the names of the trials that succeed, stored on disk.

        Those that are `harmless` with PoCL run in this process; another one runs all if none of them succeeds.
        """
        texts = "".join(t.declarations + t.text(name) for name, t in trials.items())
        key = self.key(f"{texts} in threads of {thread_stack()} bytes", self._options)

        def ask() -> frozenset[str]:
            names = None
            if harmless and self._is_pocl and self._may_try(key):
                with self.lock:
                    names = outcomes_here(self.cl, self.context, self._options, harmless)
            return names or works(self._place(), self._options, trials)

        try:
            return store.known_names(key, trials, ask)
        except Unfinished as error:  # not cached: the next process tries again
            warn(
                f"kernels on {self.device.name.strip()} may be slower than they could be: what its compiler can do was "
                f"not found out ({error})"
            )
            return frozenset()

    def _may_try(self, key: str) -> bool:
        """Return whether this process may run trials itself, which no process has begun before without an answer.

        PoCL 3.1 passes all of them. Its versions 6.0, 7.1 and that of PyPI have run kernels of the same forms
        (docs/drivers.md). If another version ends the process, the next one finds the key in the list on disk, and
        runs the trials in a process of their own.
        """
        if store.is_remembered(_TRIED_HERE, key):
            return False
        store.remember(_TRIED_HERE, key)
        return store.is_remembered(_TRIED_HERE, key)

    @property
    def hurries(self) -> bool:
        """Return whether a build that is not optimized takes half the time and has the same bits: measured of PoCL.

        Other drivers are not asked. The kernel of the trials takes .08 s of CPU to build optimized and .06 to .08 s
        not, which tells nothing; both builds of one that is large enough (boxes) take 1.03 s, to save .33 s.
        """
        return self._is_pocl and self.is_cpu

    @property
    def _is_pocl(self) -> bool:
        return bool(self.device.platform.name.strip() == POCL)

    @cached_property
    def abilities(self) -> Abilities:
        """The functions that the compiler has besides OpenCL C."""
        names = self._succeeded
        kinds = {"signs": SIGNS, "wide": WIDER, "guess": GUESSES, "truncation": TRUNCATIONS}
        widths = (frozenset(n for n in tried if f"{kind}{n}" in names) for kind, tried in kinds.items())
        return Abilities("reduce" in names, "elementwise" in names, "shuffle" in names, *widths)

    @once_of_each
    def most_private(self) -> int:
        """Return the most bytes of local arrays: of a work group on a CPU, else of a work item.

        A CPU's driver ends the process where a stack does not hold them; a GPU's refuses the kernel.
        """
        return most_private(self._holds, thread_stack()) if self.is_cpu else max(self._holds, SIZES[0])

    @property
    def orders_stores(self) -> bool:
        """Return whether a work group that sees a counter sees what was stored before it counted.

        OpenCL 1.2 promises it for no device. x86 processors keep the order of stores, and so of `mem_fence`.
        """
        return self.is_cpu and architecture().lower() in ("x86_64", "amd64", "i386", "i686")

    @property
    def is_cpu(self) -> bool:
        """Return whether it is a processor, which has the local arrays of a work group on the stack of one thread."""
        return bool(self.device.type & self.cl.device_type.CPU)

    @property
    def widths(self) -> tuple[int, ...]:
        """The widths that packets may have on this device: those of OpenCL C's vectors, and of clang's."""
        return (*WIDTHS, *sorted(self.abilities.wider))

    def _place(self) -> tuple[int, int]:
        """Return the indices of the platform and of its device, as the driver lists them."""
        platform = self.device.platform
        return self.cl.get_platforms().index(platform), platform.get_devices().index(self.device)
