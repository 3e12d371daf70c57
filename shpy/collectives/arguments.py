"""Checks of the arguments of collective operations, before anything runs.

Stage: run.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shpy.backend.base import Memory
from shpy.errors import ShpyTypeError
from shpy.lang.data.hostdata import as_array
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Leaf, is_lazy
from shpy.lang.values.types import Attrib1b, Attrib1i
from shpy.programs import Program
from shpy.streams.stream import Place, Stream

Shape = tuple[int, ...]


def check_stream(value: Any, name: str) -> Stream:
    """Return the stream; ShpyTypeError for anything else."""
    if not isinstance(value, Stream):
        lazy = is_lazy(value)
        raise ShpyTypeError(
            f"{name} takes a Stream, not {'a Dask array' if lazy else type(value).__name__}",
            loc=here(),
            cure=f"sh.Stream({'array.compute()' if lazy else 'array'}, type)",
        )
    return value


def element_of(program: Any, message: str, cure: str) -> Any:
    """Return the type of a program's first input; ShpyTypeError unless that is a scalar or vector."""
    types = list(program.recorded.inputs.values()) if isinstance(program, Program) else []
    if types and isinstance(types[0], Leaf):
        return types[0].cls
    raise ShpyTypeError(f"{message}, not {program!r}", loc=here(), cure=cure)


def check_place(stream: Stream, place: Place, name: str) -> None:
    """Raise ShpyTypeError for a stream at another place."""
    if stream.place != place:
        raise ShpyTypeError(
            f"{name} is {stream!r}, and the other stream lies on {place}",
            loc=here(),
            cure=stream.way_to(place),
        )


def indices_at(place: Place, index: Any, name: str) -> tuple[Memory, Shape]:
    """Return the memory and shape of indices, given as a stream of scalar ints or a host array of ints."""
    if isinstance(index, Stream):
        check_place(index, place, name)
        if index.type.__name__ not in ("Attrib1i", "Attrib1u"):
            raise ShpyTypeError(f"{name} is {index!r}", loc=here(), cure="a Stream of sh.Attrib1i")
        return index.leaf_entries()[0].memory, index.shape
    array = as_array(index, name)
    if not array.size:  # numpy makes floats of an empty list
        array = array.astype(np.int32)
    if array.dtype.kind not in "iu":
        raise ShpyTypeError(f"{name} takes ints, not {array.dtype}", loc=here(), cure=f"np.asarray({name}, np.int32)")
    # An index beyond the range of int is out of range of the stream, and so is the nearest int.
    bounds = np.iinfo(np.int32)
    indices = np.clip(array, max(bounds.min, np.iinfo(array.dtype).min), min(bounds.max, np.iinfo(array.dtype).max))
    stream = Stream(indices.astype(np.int32), Attrib1i, *place)
    return stream.leaf_entries()[0].memory, array.shape


def mask_at(place: Place, mask: Any, shape: Shape) -> Memory:
    """Return the memory of a mask with a shape, given as a stream of scalar bools or a host array of bools."""
    if not isinstance(mask, Stream):
        array = as_array(mask, "mask")
        if not array.size:
            array = array.astype(np.bool_)
        if array.dtype != np.bool_:
            raise ShpyTypeError(f"mask takes bools, not {array.dtype}", loc=here(), cure="np.asarray(mask) != 0")
        mask = Stream(array, Attrib1b, *place)
    check_place(mask, place, "mask")
    if mask.type.__name__ != "Attrib1b":
        raise ShpyTypeError(f"mask is {mask!r}", loc=here(), cure="a Stream of sh.Attrib1b")
    if mask.shape != shape:
        raise ShpyTypeError(
            f"mask has the shape {mask.shape}, and the stream {shape}", loc=here(), cure="a bool for each element"
        )
    memory: Memory = mask.leaf_entries()[0].memory
    return memory


def shaped(stream: Stream, memories: list[Memory], shape: Shape) -> Stream:
    """Return a stream over memory, with the type and place of another stream."""
    return Stream.over(stream.type, shape, stream.place, memories)
