"""Bound calls: the first call with a signature finds the steps of a run, and later calls repeat them.

Stage: run. Most calls of a kernel are like the call before: contiguous arrays of the same shapes, in the dtypes that
the kernel works with, or streams of the same shapes and types. These need no check or conversion again. All other calls
go through `host`.

    known[signature(inputs)] = bound_of(recorded, executable, dtypes, inputs, common, place)
    outputs, shape, status, place = known[signature(inputs)].run(inputs, params, tables, out)
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from shpy.backend.base import Array, Call, Executable, Memory
from shpy.ir.types import Base
from shpy.lang.data.tables import Table, TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.programs.record import InputType, RecordedProgram
from shpy.lang.values.structure import Leaf, build_arrays, layout_of, leaves
from shpy.run.on_device import check_places, has_elements_of, prepare
from shpy.streams.elements import Shape
from shpy.streams.stream import Place, Stream, StreamSource

KEPT: Final = 64
"""The most bound calls that a kernel keeps."""
_LARGEST: Final = float(np.finfo(np.float16).max)
"""The bound of floats that a bound call converts: each precision can represent these."""

Ran = tuple[Any, Shape, Any, Place | None]
"""The parts of a `Result`: outputs, shape, status, place."""


def signature(inputs: Sequence[Any]) -> tuple[Any, ...] | None:
    """Return the key of a bound call, with an entry for each input; None if an input has no entry.

    The entry of a contiguous array is its shape and dtype; of a number `float`; of a stream, and of a Table of scalars
    or vectors in a stream, its shape, type and place. Other inputs have no entry.
    """
    entries: list[Any] = []
    for value in inputs:
        if type(value) is np.ndarray and value.flags.c_contiguous:
            entries.append((value.shape, value.dtype))
        elif type(value) is float and -_LARGEST < value < _LARGEST:
            entries.append(float)
        elif type(value) is Stream:
            entries.append((value._shape, value._type, value.place))
        elif type(value) is Table and type(value.source) is StreamSource and not value._parts:
            stream = value.source.stream
            entries.append((value.leaf, stream._shape, stream._type, stream.place))
        else:
            return None
    return tuple(entries)


@dataclass(frozen=True, slots=True)
class Bound(ABC):
    """A call of one signature over elements of a shape."""

    recorded: RecordedProgram
    executable: Executable
    shape: Shape

    @abstractmethod
    def run(self, inputs: Sequence[Any], params: dict[str, Array], tables: Mapping[str, Table], out: Any) -> Ran | None:
        """Run over inputs of the signature; None where `out` needs more checks."""


@dataclass(frozen=True, slots=True)
class BoundArrays(Bound):
    """A call over arrays: the flat shape and dtype of each input; the shape, flat shape and dtype of each output.

    `flat_inputs` and `flat_outputs` tell that all of them have their flat shape already.
    """

    inputs: tuple[tuple[Shape, Any], ...]
    flat_inputs: bool
    outputs: tuple[tuple[Shape, Shape, Any], ...]
    flat_outputs: bool
    dtypes: Mapping[Base, Any]

    def run(self, inputs: Sequence[Any], params: dict[str, Array], tables: Mapping[str, Table], out: Any) -> Ran | None:
        """Run over arrays of the signature."""
        flat = inputs if self.flat_inputs else self._flattened(inputs)
        layout = self.recorded.output
        if out is None:
            make: Any = np.empty if self.executable.writes_all else np.zeros
            arrays = [make(shape, dtype) for shape, _, dtype in self.outputs]
        else:
            shape, _, dtype = self.outputs[0]
            fits = type(out) is np.ndarray and type(layout) is Leaf and out.shape == shape and out.dtype == dtype
            if not fits or not out.flags.carray or any(np.may_share_memory(out, array) for array in flat):
                return None
            arrays = [out]
        written = arrays
        if not self.flat_outputs:
            written = [array.reshape(shape) for array, (_, shape, _) in zip(arrays, self.outputs, strict=True)]
        data = {name: table.data(self.dtypes[table.type.base]) for name, table in tables.items()}
        call = Call(self.shape, tuple(flat), tuple(written), params, data, fresh=out is None)
        status = self.executable.run(call)
        # Only now: the rows of a matrix are copied into one array.
        result = arrays[0] if type(layout) is Leaf else build_arrays(layout, iter(arrays))
        return result, self.shape, status, None

    def _flattened(self, inputs: Sequence[Any]) -> list[Array]:
        return [
            array.reshape(shape) if type(array) is np.ndarray else np.full(shape, array, dtype)
            for array, (shape, dtype) in zip(inputs, self.inputs, strict=True)
        ]


@dataclass(frozen=True, slots=True)
class BoundStreams(Bound):
    """A call over streams at a place; `tables` has the name of each input that is read by index, and None for others.

    Microseconds of CPU for 64 elements of a struct of two leaves beside a Table on OpenCL: 87 for 147.
    """

    place: Place
    tables: tuple[str | None, ...]

    def run(self, inputs: Sequence[Any], params: dict[str, Array], tables: Mapping[str, Table], out: Any) -> Ran:
        """Run over streams of the signature; `out` is checked."""
        recorded, executable, place = self.recorded, self.executable, self.place
        if out is not None:
            check_places([out], place, recorded.module.name)
        memories: list[Memory] = []
        by_name = dict(tables)
        for value, name in zip(inputs, self.tables, strict=True):
            if name is None:
                memories += value._memories
            else:
                by_name[name] = value if type(value) is Table else Table(value, name=name)
        return prepare(recorded, executable, memories, by_name, params, place, self.shape, out).run(executable)


def bound_of(
    recorded: RecordedProgram,
    executable: Executable,
    dtypes: Mapping[Base, Any],
    inputs: Sequence[Any],
    common: Shape,
    place: Place | None,
) -> Bound | None:
    """Return the bound call for `inputs`, over which a call has just succeeded, at the place of streams or over arrays.

    Returns None if each such call needs its checks: an input is left at its default, is a texture or a Table of
    structs, is converted or broadcast, or is an array beside streams; an array is a Table or has several leaves.
    """
    types = recorded.inputs
    if not inputs or len(inputs) != len(types):
        return None
    if place is not None:
        tables = tuple(name if isinstance(type_, TableType | TextureType) else None for name, type_ in types.items())
        entries = zip(inputs, types.values(), strict=True)
        repeats = all(_repeats(value, type_, common) for value, type_ in entries)
        return BoundStreams(recorded, executable, common, place, tables) if repeats else None
    if not common or 0 in common or not all(isinstance(type_, Leaf) for type_ in types.values()):
        return None
    flat = []
    for array, type_ in zip(inputs, types.values(), strict=True):
        assert isinstance(type_, Leaf)
        cls = type_.cls
        tail = (cls.size,) if cls.size > 1 else ()
        dtype = np.dtype(dtypes[cls.base])
        if isinstance(array, float):
            if tail or cls.base is not Base.F:
                return None
            flat.append(((1,), dtype))
            continue
        shape = array.shape[: array.ndim - len(tail)]
        count = math.prod(shape)
        if array.dtype != dtype or array.shape[len(shape) :] != tail or (shape != common and count != 1):
            return None
        flat.append(((count, *tail), dtype))
    outputs = []
    for _, _, cls in leaves(recorded.output, ""):
        tail = (cls.size,) if cls.size > 1 else ()
        outputs.append(((*common, *tail), (math.prod(common), *tail), np.dtype(dtypes[cls.base])))
    flat_inputs = all(getattr(array, "shape", None) == shape for array, (shape, _) in zip(inputs, flat, strict=True))
    return BoundArrays(recorded, executable, common, tuple(flat), flat_inputs, tuple(outputs), len(common) == 1, dtypes)


def _repeats(value: Any, type_: InputType, common: Shape) -> bool:
    """Return whether a call over streams can take such a value as it is: elements, or a Table of scalars or vectors."""
    if isinstance(type_, TableType):
        return isinstance(value, Table | Stream) and isinstance(layout_of(type_.cls, ""), Leaf)
    return isinstance(value, Stream) and not isinstance(type_, TextureType) and has_elements_of(value.shape, common)
