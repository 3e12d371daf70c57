"""The protocol of a backend, between `Kernel` (above) and the targets (below).

Stage: emit, compile, run. A backend takes a verified module as it was recorded, prepares it with `passes`, prints it
and runs it. It does not see the user's arrays: `Kernel` checks and flattens them, and gives the results their shape.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyError
from shpy.ir.nodes import Loc, Module, Status
from shpy.ir.tabledata import TableData
from shpy.ir.types import Type
from shpy.passes.modes import Math, Precision

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Options:
    """The options of a compilation.

    `loop_limit` None means no limit; `device` is an index into `Backend.devices()`.

    `lanes` is the number of elements in a packet; targets without packets take only "auto" and 1. `math` is the mode of
    arithmetic, which decides the accuracy of functions: see docs/numerics.md. With `fuse` the module is one that
    `passes.fuse` has contracted, and composite operations are to be contracted too.
    """

    precision: Precision = "f32"
    loop_limit: int | None = 1_048_576
    device: int | None = None
    lanes: int | Literal["auto"] = "auto"
    math: Math = "strict"
    fuse: bool = False


@dataclass(frozen=True, slots=True)
class Device:
    """One device of a backend: its name, driver version, and what it can do, in words (`f64`, `images`, ...)."""

    name: str
    version: str
    features: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(slots=True)
class Call:
    """One run over `shape` elements (n of them in C order). Nothing changes it; to freeze it takes 0.6 µs a call.

    `inputs` follow the entry's: each C-contiguous, (n, size) or (n,) for scalars, or with 1 instead of n for a
    uniform. `outputs` likewise with n, to be written in place, only where the element's status is WRITTEN. dtypes are
    those of `ir.constants.DTYPES` at the working precision (f is float64 at f64; float16 at f16).
    `params` are arrays of shape () or (size,) by name; `tables` by name. `fresh` outputs hold zeros that nobody else
    reads: other elements may be written too, as long as they are zeros again when the run ends.
    """

    shape: tuple[int, ...]
    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    params: dict[str, Array]
    tables: dict[str, TableData]
    fresh: bool = False

    @property
    def count(self) -> int:
        """The number of elements."""
        return math.prod(self.shape)


class Memory(Protocol):
    """`count` elements of a scalar or vector `type` on a device, in C order: one leaf of a stream.

    On the host they are an array (count, size), or (count,) for scalars, of `dtype`. The device's memory is free again
    once the object is gone.
    """

    @property
    def count(self) -> int:
        """The number of elements."""

    @property
    def type(self) -> Type:
        """The type of an element."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """The dtype of a component on the host."""

    @property
    def native(self) -> Any:
        """The object of the device's own library: an array of numpy or pyopencl, a texture of moderngl.

        The device's memory is not used for anything else as long as somebody holds it.
        """

    @property
    def extent(self) -> tuple[Any, int, int]:
        """The device memory of which this is a part, its first byte there, and the byte after its last one."""

    def write(self, array: Array) -> None:
        """Copy a host array of `dtype` to the device."""

    def read(self, begin: int = 0, end: int | None = None) -> Array:
        """Copy the elements, from `begin` up to `end`, into a new host array, once all that was started has ended."""


def too_large(count: int, type: Type, dtype: np.dtype[Any]) -> ShpyError:
    """Return the error for `count` elements, which take more memory than a device has."""
    size = count * type.size * dtype.itemsize
    return ShpyError(f"{count:,} elements need {size:,} bytes, which is more than there are", cure="fewer elements")


def overlap(one: Memory, other: Memory) -> bool:
    """Return whether two memories of a space have a byte in common."""
    if one is other:
        return True
    whole, begin, end = one.extent
    others_whole, others_begin, others_end = other.extent
    return bool(whole == others_whole and max(begin, others_begin) < min(end, others_end))


@dataclass(slots=True)
class TableMemory:
    """Data of a table that lie in a stream: `shape` elements of `memory`. Nothing changes it, see `Call`."""

    memory: Memory
    shape: tuple[int, ...]


@dataclass(slots=True)
class DeviceCall:
    """One run over `shape` elements, all in memory of the device. Nothing changes it, see `Call`.

    `inputs` are in the entry's order, each with n elements, or with one that all share; `outputs` have n. An executable
    that does not write all elements needs `status`, n ints: an output is undefined where the status is not WRITTEN. An
    output may be an input where the space says so, but not the data of a table.
    """

    shape: tuple[int, ...]
    inputs: tuple[Memory, ...]
    outputs: tuple[Memory, ...]
    status: Memory | None
    params: dict[str, Array]
    tables: dict[str, TableData | TableMemory]


@dataclass(frozen=True, slots=True)
class Counts:
    """The counts of a run: elements written, elements stopped in loops, and the status of the first such loop or 0."""

    written: int
    stopped: int = 0
    first: int = 0

    @classmethod
    def of(cls, status: Array) -> Counts:
        """Count the statuses of an array."""
        stopped = status[(status >= Status.FIRST_LOOP) | (status == Status.DEVICE_STOPPED)]
        limited = stopped[stopped >= Status.FIRST_LOOP]
        first = int(limited.min()) if limited.size else 0
        return cls(int(np.count_nonzero(status == Status.WRITTEN)), stopped.size, first)


FoldPlaces = Callable[[Sequence[Any], Any, Sequence[Any]], None]
"""fold(values, index, targets): combine the leaves of the values of each place in their order; store it in `targets`.

Places without a value stay as they are, and values whose index is out of range are dropped.
"""


@dataclass(frozen=True, slots=True)
class Collectives:
    """Collective operations that a device does itself; programs do those that are None.

    Indices and counts are ints. Keys are scalars; NaN is the greatest number, and -0 and +0 are equal.
    """

    select: Callable[[Any], Any] | None = None
    """select(mask): the indices of the elements that are true, in ascending order."""
    take: Callable[[Sequence[Any], Any], list[Any]] | None = None
    """take(sources, index): the element of each source at each index, the nearest where it is out of range.

    All sources have the same number of elements.
    """
    put: Callable[[Any, Any, Any], None] | None = None
    """put(values, index, target): write each value to its place; the last of several values for one place remains."""
    place: Callable[[Any, Any, Any], None] | None = None
    """place(values, index, target): write each value to its place, where no place occurs twice.

    None also where a kernel with a condition is as fast as a list of elements.
    """
    mark: Callable[[Any, Any], None] | None = None
    """mark(mask, status): set the status WRITTEN where the mask is True, and DISCARDED elsewhere."""
    sort: Callable[[Any, bool], Any] | None = None
    """sort(keys, descending): the keys in order, equal ones in the order they had."""
    order: Callable[[Any, bool, int | None], Any] | None = None
    """order(keys, descending, below): the indices that sort them, ints clamped to [0, below) unless that is None."""
    tally: Callable[[Any, int], Any] | None = None
    """tally(numbers, bins): how often each number from 0 to bins - 1 occurs among ints, signed or not."""
    tree: Callable[[Module, NodeTypes, Precision], Tree | None] | None = None
    """tree(module, types, precision): the tree of a recorded program of two elements; None where programs do better.

    Its inputs are the leaves of two elements of `types.part`, and its outputs those of one. With `types.lifted`, the
    leaves of an element of the stream and its index come before the inputs, and what these give before the outputs.
    """
    fold_places: Callable[[Module, Precision], FoldPlaces | None] | None = None
    """fold_places(module, precision): a fold by place with a recorded program of two elements; None where programs do.

    Its inputs are the leaves of two elements, and its outputs those of one.
    """


@dataclass(frozen=True, slots=True)
class NodeTypes:
    """The types of the leaves of a stream's elements, and of what is combined; elements are lifted if these differ."""

    element: tuple[Type, ...]
    part: tuple[Type, ...]
    lifted: bool


class Tree(Protocol):
    """A program of two elements with which a device folds and scans streams, the leaves of which are memories."""

    def each(self, count: int) -> int:
        """Return the elements of a part of a stream of `count`: a power of two, so that a part is a tree."""

    def fold(self, elements: Sequence[Any], totals: Sequence[Any]) -> None:
        """Reduce each part of a stream to an element of `totals`."""

    def reducing(self, elements: Sequence[Any]) -> Callable[[], list[Array]]:
        """Prepare the reduction of a stream to one element, as its memory is at each call.

        A call returns the leaves, of shape (1,) or (1, size), once the device has ended.
        """

    def scan(
        self, elements: Sequence[Any], above: Sequence[Any] | None, prefixes: Sequence[Any], exclusive: bool
    ) -> None:
        """Give all prefixes, where `above` are those that end with each part, or None for only one part."""

    def scanning(self, elements: Sequence[Any], exclusive: bool) -> Callable[[], Sequence[Memory]]:
        """Prepare the scan of a stream of one part, as its memory is at each call, which returns the prefixes."""


class Space(Protocol):
    """The memory of one device, which runs work in the order in which it was started."""

    overwrites: bool
    """True if an output may be an input: each element has been read before it is written."""
    on_host: bool
    """True if `Memory.native` is an array of numpy, whose slices cost less than reads by index."""

    @property
    def flushes(self) -> bool:
        """Return whether the device takes denormals of binary32 for zeros, so that only their bits tell them apart."""

    @property
    def collectives(self) -> Collectives:
        """The collective operations that the device does itself."""

    def allocate(self, count: int, type: Type, dtype: np.dtype[Any]) -> Memory:
        """Return memory for `count` elements, not initialised; ShpyError if the device has not that much."""

    def owns(self, native: Any) -> bool:
        """Return whether an array or texture of another library lies on this device."""

    def wrap(self, native: Any, type: Type, dtype: np.dtype[Any]) -> Memory:
        """Return the memory of an array or texture of another library; ShpyTypeError if it has another dtype."""

    def view(self, memory: Any, type: Type, count: int) -> Memory | None:
        """Return the same memory as `count` scalars or vectors of another size, at most as many components.

        None where the device lays these out in another way. A vector of three is no type for it.
        """

    def copy(self, source: Any, target: Any) -> None:
        """Copy all elements of one memory to another one of the same type and count."""

    def merge(self, status: Any, new: Any, old: Any) -> Any:
        """Return memory with the elements of `new` where the status is WRITTEN, and of `old` elsewhere, or zeros.

        `new` may be used for it.
        """

    def count(self, status: Any) -> Counts:
        """Count the statuses, once all runs that were started have ended."""

    def on_device(self, function: Callable[..., Any], natives: list[Any]) -> Any:
        """Call a function with `Memory.native` of some memories, on the thread that may use them."""

    def start(self, runs: Iterable[Callable[[], None]]) -> None:
        """Start what `Executable.ready` gave, one after the other; waits for none of them."""

    def finish(self) -> None:
        """Wait until all runs that were started have ended."""


class Executable(Protocol):
    """A compiled module."""

    @property
    def source(self) -> str:
        """The emitted text, as it was given to the target."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Facts for the user: flushed denormals, for example."""

    @property
    def loops(self) -> tuple[Loc | None, ...]:
        """The lines of the limited loops, of which status FIRST_LOOP + k names the k-th; see `passes.exits.Ending`."""

    @property
    def writes_all(self) -> bool:
        """Return whether every element is written, whatever the data: no discard, and no loop that could be stopped."""

    def run(self, call: Call) -> Array | None:
        """Run it; return the int32 status of each element, (n,), or None when every element was written."""

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over memory of the device; return what `Space.start` calls, any number of times.

        With `once` the caller promises to call it once, before the executable's next run, which may save preparations.
        """


class Backend(Protocol):
    """A target."""

    name: str

    def devices(self) -> list[Device]:
        """Return every device; raises BackendUnavailable, with the command that mends it, when there is none."""

    def compile(self, module: Module, options: Options) -> Executable:
        """Prepare, print and build; raises CompileError naming the user's line."""

    def space(self, device: int | None) -> Space:
        """Return a device's memory, one object for each device; BackendUnavailable where there is no device."""
