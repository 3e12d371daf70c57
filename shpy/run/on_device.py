"""Runs of a kernel over streams: inputs are copied to the device if need be, and outputs stay there.

Stage: run. Discarded elements keep the old value in `out`, or zero without `out`, as with arrays. So a kernel that may
discard or stop elements writes to separate memory, and only its written elements are copied to the outputs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shpy.backend.base import Array, DeviceCall, Executable, Memory, Space, TableMemory, overlap
from shpy.errors import ShpyTypeError
from shpy.ir.constants import dtypes_at
from shpy.ir.tabledata import TableData
from shpy.ir.types import Base, vec
from shpy.lang.data.tables import Table
from shpy.lang.programs.record import RecordedProgram
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Group, Layout, build_group, leaves
from shpy.run import host
from shpy.streams.elements import InputLeaf, Shape
from shpy.streams.stream import Place, Stream, StreamLeaf, memory_of_table, streams_in


def check_places(values: Iterable[Any], place: Place, name: str) -> None:
    """Raise ShpyTypeError for a stream that lies elsewhere than where the kernel runs."""
    for stream in streams_in(iter(values)):
        if stream.place != place:
            raise ShpyTypeError(
                f"{name} is compiled for {place}, and {stream!r} is not there", loc=here(), cure=stream.way_to(place)
            )


@dataclass(slots=True)
class PreparedCall:
    """The call, and the leaves of the outputs with the memory that the call writes for each. Nothing changes it."""

    call: DeviceCall
    targets: tuple[StreamLeaf, ...]
    fresh: bool
    place: Place
    space: Space
    outputs: Any

    def run(self, executable: Executable) -> tuple[Any, Shape, Memory | None, Place]:
        """Start the run, store its results in the outputs, and return the parts of a `Result`."""
        call = self.call
        if math.prod(call.shape):
            space = self.space
            space.start([executable.ready(call, once=True)])
            for target, new in zip(self.targets, call.outputs, strict=True):
                kept = new
                if call.status is not None:
                    kept = space.merge(call.status, new, None if self.fresh else target.memory)
                if kept is not target.memory:
                    target.replace(kept)
        return self.outputs, call.shape, call.status, self.place


def prepare(
    recorded: RecordedProgram,
    executable: Executable,
    inputs: Sequence[Memory],
    tables: Mapping[str, Table],
    params: dict[str, Array],
    place: Place,
    common: Shape,
    out: Any,
) -> PreparedCall:
    """Return the call with the memory for its outputs.

    The call writes directly to the outputs' memory unless that is also read or may have to keep old elements. In these
    cases it writes to separate memory.
    """
    targets, outputs = _targets(recorded.output, place, common, out)
    if out is not None:
        _check_apart(targets, tables)
    space, dtypes = place.space, dtypes_at(place.precision)
    read = {name: _table(table, dtypes) for name, table in tables.items()}
    direct = out is None or (executable.writes_all and not _reads_others(inputs, targets, itself=space.overwrites))
    written = tuple(t.memory if direct else _like(t.memory, place) for t in targets)
    status = None if executable.writes_all else space.allocate(math.prod(common), vec(Base.I), np.dtype(np.int32))
    call = DeviceCall(common, tuple(inputs), written, status, params, read)
    return PreparedCall(call, tuple(targets), out is None, place, space, outputs)


def _reads_others(inputs: Sequence[Memory], targets: Sequence[StreamLeaf], *, itself: bool) -> bool:
    """Return whether a target overwrites memory of an input.

    With `itself`, an input with the same memory and layout as the target does not count.
    """
    return any(
        overlap(read, target.memory) and not (itself and _same(read, target.memory))
        for target in targets
        for read in inputs
    )


def _same(one: Memory, other: Memory) -> bool:
    """Return whether two memories that overlap have each element in the same place."""
    return one is other or (one.extent == other.extent and one.type.size == other.type.size)


def has_elements_of(shape: Shape, common: Shape) -> bool:
    """Return whether a run over `common` can read a stream of this shape as it is."""
    return shape == common or math.prod(shape) == 1


def memory_of(leaf: InputLeaf | host.DeviceLeaf, common: Shape, place: Place) -> Memory:
    """Return the memory of an input, before a stream is expanded; an array is copied to the device."""
    if isinstance(leaf, host.DeviceLeaf):
        memory: Memory = leaf.entry.memory
        return memory
    flat = leaf.flat(common)
    copy = place.space.allocate(len(flat), leaf.type, flat.dtype)
    copy.write(flat)
    return copy


def _table(table: Table, dtypes: Mapping[Base, Any]) -> TableData | TableMemory:
    memory = memory_of_table(table)
    if memory is not None:
        return TableMemory(memory, table.shape)
    return table.data(dtypes[table.type.base])


def _like(memory: Memory, place: Place) -> Memory:
    return place.space.allocate(memory.count, memory.type, memory.dtype)


def _targets(layout: Layout, place: Place, shape: Shape, out: Any) -> tuple[list[StreamLeaf], Any]:
    """Return the stream leaf to write for each output leaf, and the streams in the structure of the outputs."""
    if out is None:
        result = build_streams(layout, place, shape)
        return [entry for stream in streams_in(iter([result])) for entry in stream.leaf_entries()], result
    entries = []
    for entry, (name, _, cls) in zip(host.entries_of_input(layout, out, "out"), leaves(layout, "out"), strict=True):
        if not isinstance(entry, StreamLeaf):
            raise ShpyTypeError(
                f"{name} is an array and other data of this run are streams",
                loc=here(),
                cure=f"sh.Stream.empty({shape}, sh.{cls.__name__}, {place.backend!r})",
            )
        if entry.shape != shape or entry.memory.type is not cls.type:
            raise ShpyTypeError(
                f"{name} is {entry.stream!r}, not of sh.{cls.__name__} and the shape {shape}",
                loc=here(),
                cure=f"sh.Stream.empty({shape}, sh.{cls.__name__}, {place.backend!r})",
            )
        entries.append(entry)
    return entries, out


def build_streams(layout: Layout, place: Place, shape: Shape) -> Any:
    """Make a stream for each output: structs and matrices are one stream, tuples and dicts have one for each part."""
    if isinstance(layout, Group) and layout.form != "struct":
        return build_group(layout, [build_streams(part, place, shape) for part in layout.parts])
    return Stream.fresh(shape, layout.cls, place)


def _check_apart(targets: Sequence[StreamLeaf], tables: Mapping[str, Table]) -> None:
    """Raise ShpyTypeError for memory of an output that is read by index, or that belongs to another output too."""
    for target, table in itertools.product(targets, tables.values()):
        memory = memory_of_table(table)
        if memory is not None and overlap(target.memory, memory):
            raise ShpyTypeError(
                f"out is memory that the Table {table.name or ''} reads: an element would read what others wrote",
                loc=here(),
                cure="another stream for out, or a chain, which keeps two",
            )
    for one, other in itertools.combinations(targets, 2):
        if overlap(one.memory, other.memory):
            raise ShpyTypeError(
                "two outputs have the same memory, and each needs its own",
                loc=here(),
                cure="sh.Stream.empty for each",
            )
