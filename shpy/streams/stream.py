"""Stream: the elements of an input or output, kept in the memory of one device.

Stage: run. A stream of a type with several leaves, a struct or a matrix, has one memory for each leaf.

    x = sh.Stream(points, sh.Point3f, backend="opencl")    # uploaded once
    y = kernel(x, 2.0)                                     # a Stream on the same device: nothing is copied to the host
    np.asarray(y)                                          # copied to the host
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shpy.backend.base import Memory, Space
from shpy.backend.registry import NAMES, backend as backend_named, default_place
from shpy.display.png import png
from shpy.display.screen import pixels
from shpy.errors import ShpyTypeError
from shpy.ieee import in_ieee_arithmetic
from shpy.ir.constants import dtypes_at, is_int
from shpy.ir.tabledata import TableData
from shpy.ir.types import Type
from shpy.lang.data.sources import Source
from shpy.lang.data.tables import Table, fits_type
from shpy.lang.data.textures import Texture2D
from shpy.lang.recording.location import caller, here, located
from shpy.lang.values.structure import Layout, build_arrays, flatten, layout_of, leaves, outside, spoken_type, type_of
from shpy.passes.modes import Precision
from shpy.streams.elements import InputLeaf, Shape, completed, given_shape
from shpy.streams.fields import StreamFields, field_of, rows_of
from shpy.streams.methods import StreamReductions
from shpy.streams.wrapping import extents_of, owner_of


class Place(NamedTuple):
    """A device of a backend, and the working precision of the floats that lie there."""

    backend: str
    device: int
    precision: Precision

    @property
    def space(self) -> Space:
        """The device's memory."""
        return backend_named(self.backend).space(self.device)

    def __str__(self) -> str:
        at = f", device {self.device}" if self.device else ""
        return f"{self.backend}{at}{'' if self.precision == 'f32' else f', {self.precision}'}"


class Stream(StreamReductions, StreamFields):
    """`Stream(array, type, backend=None, device=None)`: elements (*S, N), or (*S,) for N = 1, on one device.

    The type may be a matrix, from an array (*S, N, N), or a struct or NamedTuple, from a dict of fields, a structured
    array, or an object with these attributes. `backend` None is the default backend; `precision`, "f16", "f32" or
    "f64", is that of the kernels that run over the stream. Each element of a kernel's run reads its own element.

    Raises ShpyTypeError for arrays that do not fit the type; BackendUnavailable, with the command that mends it.
    """

    @in_ieee_arithmetic
    @located
    def __init__(
        self,
        array: Any,
        type: Any,
        backend: str | None = None,
        device: int | None = None,
        precision: Precision = "f32",
    ) -> None:
        place, layout = _place(backend, device, precision), _layout(type)
        parts = _checked(array, layout, place)
        memories = []
        for leaf in parts:
            memory = place.space.allocate(math.prod(leaf.shape), leaf.type, leaf.array.dtype)
            memory.write(leaf.flat(leaf.shape))
            memories.append(memory)
        self._hold(type, layout, parts[0].shape, place, memories)

    def _hold(self, type: Any, layout: Layout, shape: Shape, place: Place, memories: Sequence[Memory]) -> None:
        self._type, self._layout, self._shape = type, layout, shape
        self.place = place
        self._memories = list(memories)
        self._reductions: dict[str, tuple[Any, Callable[[], Any]]] = {}
        self._owned = True

    @classmethod
    def over(cls, element: Any, shape: Shape, place: Place, memories: Sequence[Memory]) -> Stream:
        """Return a stream over memory that is there already."""
        stream = cls.__new__(cls)
        stream._hold(element, _layout(element), shape, place, memories)
        return stream

    @classmethod
    def empty(
        cls,
        shape: int | Sequence[int],
        type: Any,
        backend: str | None = None,
        device: int | None = None,
        precision: Precision = "f32",
    ) -> Stream:
        """Return a stream of zeros with this shape and type of elements, for a kernel to write."""
        stream = cls.fresh(given_shape(shape), type, _place(backend, device, precision))
        for memory in stream._memories:
            memory.write(np.zeros((memory.count, *_tail(memory)), memory.dtype))
        return stream

    @classmethod
    @located
    def fresh(cls, shape: Shape, element: Any, place: Place) -> Stream:
        """Return a stream of a shape at a place whose elements are not set, for a kernel that writes all of them."""
        space, count = place.space, math.prod(shape)
        memories = [space.allocate(count, *kind) for kind in _kinds(element, place.precision)]
        return cls.over(element, shape, place, memories)

    @classmethod
    @located
    def wrap(cls, native: Any, type: Any = None, backend: str | None = None) -> Stream:
        """Make a stream over a numpy array, a `pyopencl.array.Array` or a `moderngl.Texture`, without a copy.

        (*S, N) for N components, (*S,) for one; a texture is (height, width). `type` None is an Attrib of that many
        components. Raises ShpyTypeError for memory that is not contiguous, of another dtype, of another context, or of
        another backend than `backend`.
        """
        owner = backend_named(owner_of(native, backend))
        device = next((k for k in range(len(owner.devices())) if owner.space(k).owns(native)), 0)
        shape, element, precision = extents_of(native, type)
        place = Place(owner.name, device, precision)
        memory = place.space.wrap(native, element.type, np.dtype(dtypes_at(place.precision)[element.base]))
        stream = cls.over(element, shape, place, [memory])
        stream._owned = False
        return stream

    # What it is

    @property
    def shape(self) -> Shape:
        """The shape S of its elements."""
        return self._shape

    @property
    def type(self) -> Any:
        """The type of an element."""
        return self._type

    @property
    def backend(self) -> str:
        """The name of the backend whose device holds it."""
        return self.place.backend

    @property
    def device(self) -> int:
        """The position of its device in `Backend.devices()`."""
        return self.place.device

    @property
    def precision(self) -> Precision:
        """The working precision of its floats."""
        return self.place.precision

    @property
    def size(self) -> int:
        """The number of elements."""
        return math.prod(self._shape)

    @property
    def nbytes(self) -> int:
        """The bytes of its elements on the host."""
        return sum(m.count * m.type.size * m.dtype.itemsize for m in self._memories)

    def __len__(self) -> int:
        if not self._shape:
            raise TypeError("a stream of one element without axes has no len()")
        return self._shape[0]

    def _repr_png_(self) -> bytes | None:
        """Return the picture that a notebook shows, of colours in rows; None for others, which show their text."""
        is_picture = len(self.shape) == 2 and getattr(self.type, "kind", "") == "Color"
        return png(pixels(self.numpy())) if is_picture else None

    def __repr__(self) -> str:
        return f"<Stream {self._shape} of {self._type.__name__} on {self.place}>"

    def __bool__(self) -> bool:
        raise ShpyTypeError("a stream is neither true nor false", loc=here(), cure="stream.any() or stream.all()")

    def __eq__(self, other: object) -> bool:
        if other is not self and isinstance(other, int | float | np.ndarray | np.generic):
            cure = "stream.numpy() == x, or a program of the comparison"
            raise ShpyTypeError("a stream is not compared element by element", loc=here(), cure=cure)
        return self is other

    __hash__ = object.__hash__

    # To the host and back

    def numpy(self) -> Any:
        """Copy the elements to the host: (*S, N), of matrices (*S, N, N), of structs a named tuple of arrays."""
        return self[...]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("a stream's elements are copied to the host")
        elements = self.numpy()
        if not isinstance(elements, np.ndarray):
            raise ShpyTypeError(
                f"a stream of {self._type.__name__} is several arrays", loc=here(), cure="stream.numpy(), a named tuple"
            )
        return elements if dtype is None else elements.astype(dtype)

    def __getitem__(self, key: Any) -> Any:
        """Return the elements of an index, a slice or a mask, on the host; a struct's field by name is a Stream."""
        if isinstance(key, str):
            return field_of(self, key)
        entry = np.asarray(key) if isinstance(key, Stream) else key
        rows = rows_of(entry, self._shape[0]) if self._shape else None
        if rows is None:
            arrays = [memory.read().reshape(self._shape + _tail(memory))[entry] for memory in self._memories]
        else:  # other rows stay on the device
            each = math.prod(self._shape[1:])
            shape = (len(rows), *self._shape[1:]) if isinstance(entry, slice) else self._shape[1:]
            read = (m.read(rows.start * each, rows.stop * each).reshape(shape + _tail(m)) for m in self._memories)
            arrays = [array if array.ndim else array[()] for array in read]
        return build_arrays(self._layout, iter(arrays))

    @in_ieee_arithmetic
    def update(self, array: Any) -> None:
        """Copy new elements to the device; the shape stays. Raises ShpyTypeError for another shape."""
        parts = _checked(array, self._layout, self.place)
        if parts[0].shape != self._shape:
            raise ShpyTypeError(
                f"update of a stream keeps its shape: {self._shape}, not {parts[0].shape}",
                loc=here(),
                cure="a new sh.Stream",
            )
        for memory, leaf in zip(self._memories, parts, strict=True):
            memory.write(leaf.flat(self._shape))

    def copy(self) -> Stream:
        """Return a stream with the same elements on the same device."""
        copy = Stream.fresh(self._shape, self._type, self.place)
        for memory, copied in zip(self._memories, copy._memories, strict=True):
            self.place.space.copy(memory, copied)
        return copy

    def reshape(self, *shape: Any) -> Stream:
        """Return a view of another shape, in C order: a write to the stream or the view changes both. No copy is made.

        `shape`: an int, several, or a tuple; one of them may be -1, which stands for what is left. Raises ShpyTypeError
        for a shape of another number of elements.
        """
        extents = given_shape(completed(shape[0] if len(shape) == 1 else shape, self.size))
        if math.prod(extents) != self.size:
            cure = f"a shape of {self.size:,} elements"
            raise ShpyTypeError(f"{self!r} has no view of the shape {extents}", loc=here(), cure=cure)
        view = Stream.over(self._type, extents, self.place, self._memories)
        self._owned = view._owned = False  # as in `_shared`: the stream and its view share this memory
        return view

    def __copy__(self) -> Stream:
        return self.copy()

    def __deepcopy__(self, memo: Any) -> Stream:
        return self.copy()

    def __reduce__(self) -> Any:
        return _sent, (self._layout, self._shape, self.place, [memory.read() for memory in self._memories])

    def to(self, backend: str, device: int | None = None) -> Stream:
        """Return a stream with these elements on another device, copied through the host; itself if it is there."""
        place = _place(backend, device, self.place.precision)
        if place == self.place:
            return self
        if place.space.on_host:  # an array that is read from a device belongs to nobody else
            arrays = [np.require(memory.read(), memory.dtype, ["C", "W"]) for memory in self._memories]
            kinds = _kinds(self._type, place.precision)
            memories = [place.space.wrap(a, *kind) for a, kind in zip(arrays, kinds, strict=True)]
            return Stream.over(self._type, self._shape, place, memories)
        copy = Stream.fresh(self._shape, self._type, place)
        for memory, copied in zip(self._memories, copy._memories, strict=True):
            copied.write(memory.read())
        return copy

    def native(self) -> Any:
        """Return the array of numpy or pyopencl, or the texture of moderngl, that holds it; a list for several leaves.

        Its memory stays as long as somebody holds it, and later runs that write the stream write it, too. A texture
        holds rows of 4096 elements; only `on_device` may use it, and on another thread it raises ShpyTypeError.
        """
        arrays = self._shared()
        return arrays[0] if len(arrays) == 1 else arrays

    def on_device(self, function: Callable[..., Any]) -> Any:
        """Call `function` with the native object of each leaf as an argument (see `native`), and return its result.

        It runs on the thread that may use the device's library: for GLSL that is a thread of shpy, since an OpenGL
        context belongs to one thread. There it may use moderngl, also `texture.ctx`, and other streams.

            stream.on_device(lambda texture: texture.read())
        """
        return self.place.space.on_device(function, [m.native for m in self._memories])

    def __dlpack__(self, **options: Any) -> Any:
        if self.backend != "numpy" or len(self._memories) != 1:
            raise BufferError(f"{self!r} is not in the host's memory: stream.numpy().__dlpack__()")
        (array,) = self._shared()
        return array.reshape(self._shape + _tail(self._memories[0])).__dlpack__(**options)

    def _shared(self) -> list[Any]:
        """Return the native object of each leaf; from now on runs write into this memory and never replace it."""
        self._owned = False
        return [m.native for m in self._memories]

    def __dlpack_device__(self) -> tuple[int, int]:
        return (1, 0)  # kDLCPU

    def way_to(self, place: Place) -> str:
        """Return the expression that brings it to another place, as messages spell it."""
        if self.precision != place.precision:
            type_, told = spoken_type(self._type), f'"{place.backend}", precision="{place.precision}"'
            return f"sh.Stream(stream.numpy(), {type_}, {told})"
        return f"stream.to({place.backend!r}{f', {place.device}' if place.device else ''})"

    # What kernels ask

    def leaf_entries(self) -> list[StreamLeaf]:
        """Return an entry for each leaf: its memory and shape."""
        return [StreamLeaf(self, k) for k in range(len(self._memories))]

    def table_source(self, type: Any) -> StreamSource:
        """Return the source of a Table of this type over the stream; ShpyTypeError where the stream does not fit."""
        if type is not None and not fits_type(type, self.type):
            raise ShpyTypeError(
                f"{self!r} is no Table of {getattr(type, '__name__', type)}",
                loc=here(),
                cure=f"a stream of {spoken_type(type)}",
            )
        if len(self.shape) not in (1, 2, 3):
            raise ShpyTypeError(
                f"a Table has 1 to 3 axes, and this stream, {self.shape}, has {len(self.shape)}",
                loc=here(),
                cure="a stream of 1 to 3 axes",
            )
        if not self.size:
            raise ShpyTypeError("a Table cannot be empty", loc=here(), cure="a stream of one element or more")
        return StreamSource(self)


@dataclass(slots=True, eq=False)
class StreamLeaf:
    """One leaf of a stream, as an input or output of a run."""

    stream: Stream
    index: int

    @property
    def memory(self) -> Memory:
        """The memory that holds its elements now."""
        return self.stream._memories[self.index]

    @property
    def shape(self) -> Shape:
        """The shape of the stream."""
        return self.stream.shape

    def replace(self, memory: Memory) -> None:
        """Replace the leaf's memory; if another library shares that, copy the elements into it instead."""
        stream = self.stream
        if stream._owned:
            stream._memories[self.index] = memory
            stream._reductions.clear()  # afterwards: a thread that prepares one looks at the memory once it is there
        else:
            stream.place.space.copy(memory, self.memory)


@dataclass(frozen=True, eq=False)
class StreamSource(Source):
    """The elements of a Table that lie in the memory of a stream, wherever that is."""

    stream: Stream

    @property
    def layout(self) -> Layout:  # type: ignore[override]
        """The layout of the stream's elements."""
        return self.stream._layout

    @property
    def rank(self) -> int:  # type: ignore[override]
        """The number of axes."""
        return len(self.stream.shape)

    @property
    def shape(self) -> Shape:
        """The shape of the stream."""
        return self.stream.shape

    def memory(self, leaf: int) -> Memory:
        """Return the memory that holds a leaf's elements at present."""
        return self.stream._memories[leaf]

    def data(self, leaf: int, dtype: Any) -> TableData:
        """Return a leaf's elements on the host."""
        return TableData(self.array(leaf).astype(dtype, copy=False))

    def array(self, leaf: int) -> NDArray[Any]:
        """Return a leaf's elements on the host."""
        memory = self.memory(leaf)
        return memory.read().reshape(self.shape + _tail(memory))

    def update(self, array: Any, start: int | None) -> None:
        """Replace the elements of the stream; a stream is updated whole: ShpyTypeError for a part."""
        if start is not None:
            raise ShpyTypeError(
                f"{self.stream!r} is updated whole", loc=here(), cure="table.update(array), without start"
            )
        self.stream.update(array)


def memory_of_table(table: Table) -> Memory | None:
    """Return the memory of a stream in which a leaf's elements lie; None for other tables."""
    return table.source.memory(table.leaf) if isinstance(table.source, StreamSource) else None


def _tail(memory: Memory) -> Shape:
    return (memory.type.size,) if memory.type.size > 1 else ()


def _place(backend: Any, device: Any, precision: Any) -> Place:
    name = default_place() if backend is None else backend
    if name not in NAMES:
        cure = " or ".join(f'backend="{n}"' for n in NAMES)
        raise ShpyTypeError(f"backend={name!r} names no backend", loc=caller(), cure=cure)
    if precision not in ("f16", "f32", "f64"):
        raise ShpyTypeError(f"precision={precision!r} is unknown", loc=here(), cure='precision="f32", "f64" or "f16"')
    count = len(backend_named(name).devices())
    if device is not None and not (is_int(device) and 0 <= device < count):
        raise ShpyTypeError(f"{name} has no device {device!r}, only {count}", loc=here(), cure="device=0")
    return Place(name, int(device or 0), precision)


@lru_cache(maxsize=256)
def _layout(type: Any) -> Layout:
    return outside(layout_of(type, "a stream"), "a stream")


@lru_cache(maxsize=256)
def _kinds(type: Any, precision: Precision) -> tuple[tuple[Type, np.dtype[Any]], ...]:
    """Return the type and the dtype of each leaf."""
    dtypes = dtypes_at(precision)
    return tuple((leaf.type, np.dtype(dtypes[leaf.base])) for _, _, leaf in leaves(_layout(type), ""))


def _checked(array: Any, layout: Layout, place: Place) -> list[InputLeaf]:
    """Return the leaves of host data, all of one shape."""
    dtypes = dtypes_at(place.precision)
    if isinstance(array, Stream):
        array = array.numpy()
    parts = [
        InputLeaf(path or "a stream", cls, entry, dtypes[cls.base])
        for (path, _, cls), entry in zip(leaves(layout, ""), flatten(layout, array, "a stream"), strict=True)
    ]
    if len({leaf.shape for leaf in parts}) > 1:
        listed = ", ".join(f"{leaf.name} {leaf.shape}" for leaf in parts)
        raise ShpyTypeError(
            f"the fields of a stream have one shape, not {listed}", loc=here(), cure="one element of each field a place"
        )
    return parts


def _sent(layout: Layout, shape: Shape, place: Place, arrays: Sequence[NDArray[Any]]) -> Stream:
    """Return a stream that was pickled in another process, on the device of this process with the same index."""
    stream = Stream.fresh(shape, type_of(layout), _place(*place))
    for memory, array in zip(stream._memories, arrays, strict=True):
        memory.write(array)
    return stream


def streams_in(values: Iterator[Any]) -> Iterator[Stream]:
    """Yield the streams among inputs, outputs and tables, whether alone or as fields."""
    for value in values:
        if isinstance(value, Stream):
            yield value
        elif isinstance(value, Table):
            if isinstance(value.source, StreamSource):
                yield value.source.stream
        elif isinstance(value, Texture2D):
            yield from streams_in(iter([value.table]))
        elif isinstance(value, dict):
            yield from streams_in(iter(value.values()))
        elif isinstance(value, tuple | list):
            yield from streams_in(iter(value))
