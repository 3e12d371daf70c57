"""Runs of a kernel over streams: all of its inputs are brought to the device, and its outputs stay there.

Stage: run. Elements that are discarded keep what `out` held, zeros without it, as with arrays: a kernel that may
discard or stop elements writes memory of its own, of which the elements that were written are taken over.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from shpy.backends.base import Array, Counts, DeviceCall, Executable, Memory, TableData, TableMemory, overlap
from shpy.errors import ShpyTypeError
from shpy.ir.types import Base, vec
from shpy.lang.data.tables import Table
from shpy.lang.programs.record import Recorded
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Group, Layout, build_group, leaves
from shpy.lang.values.types import Attrib1b
from shpy.run import host
from shpy.streams.stream import Place, Stream, StreamLeaf, StreamTable, streams_in

Shape = tuple[int, ...]


def check_places(values: Iterable[Any], place: Place, name: str) -> None:
    """Raise ShpyTypeError for a stream that lies elsewhere than where the kernel runs."""
    for stream in streams_in(iter(values)):
        if stream.place != place:
            raise ShpyTypeError(
                f"{name} is compiled for {place}, and {stream!r} is not there", loc=here(), cure=stream.way_to(place)
            )


@dataclass(frozen=True, slots=True)
class Prepared:
    """The call, and the leaves of the outputs with the memory that the call writes for each."""

    call: DeviceCall
    targets: tuple[StreamLeaf, ...]
    fresh: bool
    place: Place
    outputs: Any


@dataclass(eq=False)
class StreamResult:
    """The result of a run over streams: `outputs` are Streams; `written` and `count` are computed on first access."""

    outputs: Any
    shape: Shape
    place: Place
    status: Memory | None

    @cached_property
    def counts(self) -> Counts:
        """The numbers of elements that were written, and that a loop limit stopped."""
        if self.status is None:
            return Counts(math.prod(self.shape))
        return self.place.space.count(self.status)

    @property
    def count(self) -> int:
        """The number of elements that were written."""
        return self.counts.written

    @cached_property
    def written(self) -> Stream:
        """A Stream of bools, of the shape of the run: which elements were written."""
        full = Stream.fresh(self.shape, Attrib1b, self.place)
        (leaf,) = full.leaf_entries()
        leaf.memory.write(np.ones(leaf.memory.count, np.bool_))
        if self.status is not None and leaf.memory.count:
            leaf.replace(self.place.space.keep(self.status, leaf.memory, None))
        return full


def prepare(
    recorded: Recorded,
    executable: Executable,
    tables: Mapping[str, Table],
    params: dict[str, Array],
    place: Place,
    dtypes: Mapping[Base, Any],
    inputs: Sequence[host.InputLeaf | host.DeviceLeaf],
    common: Shape,
    out: Any,
) -> Prepared:
    """Bring every array among the inputs to the device, and make what the outputs are written to."""
    memories = [_memory(leaf, common, place) for leaf in inputs]
    read = {name: _table(table, dtypes) for name, table in tables.items()}
    targets, outputs = _targets(recorded.output, place, common, out)
    if out is not None:
        _check_apart(targets, tables)
    return _prepared(executable, params, place, memories, read, targets, outputs, common, fresh=out is None)


def signature_of_streams(streams: Sequence[Any]) -> tuple[Any, ...] | None:
    """Return the shapes, types and places of streams of one leaf each; None where there is anything else."""
    found = []
    for stream in streams:
        if type(stream) is not Stream or len(stream._memories) != 1:
            return None
        found.append((stream._shape, stream._type, stream.place))
    return tuple(found)


def prepare_known(
    recorded: Recorded,
    executable: Executable,
    params: dict[str, Array],
    place: Place,
    streams: Sequence[Stream],
    common: Shape,
    out: Any,
) -> Prepared:
    """Make what the outputs are written to, for streams of a signature with which a run went well, and no tables."""
    memories = [stream._memories[0] for stream in streams]
    targets, outputs = _targets(recorded.output, place, common, out)
    if out is not None:
        _check_apart(targets, {})
    return _prepared(executable, params, place, memories, {}, targets, outputs, common, fresh=out is None)


def _prepared(
    executable: Executable,
    params: dict[str, Array],
    place: Place,
    inputs: Sequence[Memory],
    tables: dict[str, TableData | TableMemory],
    targets: Sequence[StreamLeaf],
    outputs: Any,
    common: Shape,
    *,
    fresh: bool,
) -> Prepared:
    """Return the call: it writes the outputs' memory, or its own where theirs is still read or may have to stay."""
    space = place.space
    direct = fresh or (executable.writes_all and not _reads_others(inputs, targets, itself=space.overwrites))
    written = tuple(t.memory if direct else _like(t.memory, place) for t in targets)
    status = None if executable.writes_all else space.allocate(math.prod(common), vec(Base.I), np.dtype(np.int32))
    call = DeviceCall(common, tuple(inputs), written, status, params, tables)
    return Prepared(call, tuple(targets), fresh, place, outputs)


def _reads_others(inputs: Sequence[Memory], targets: Sequence[StreamLeaf], *, itself: bool) -> bool:
    """Return whether an input has memory that a target overwrites, but for the same elements if `itself` holds."""
    return any(
        overlap(read, target.memory) and not (itself and _same(read, target.memory))
        for target in targets
        for read in inputs
    )


def _same(one: Memory, other: Memory) -> bool:
    """Return whether two memories that overlap have each element in the same place."""
    return one is other or (one.extent == other.extent and one.type.size == other.type.size)


def run_prepared(executable: Executable, prepared: Prepared) -> StreamResult:
    """Start the run; what it wrote belongs to the outputs."""
    call = prepared.call
    if math.prod(call.shape):
        space = prepared.place.space
        space.start([executable.ready(call, once=True)])
        for target, new in zip(prepared.targets, call.outputs, strict=True):
            kept = new
            if call.status is not None:
                kept = space.keep(call.status, new, None if prepared.fresh else target.memory)
            if kept is not target.memory:
                target.replace(kept)
    return StreamResult(prepared.outputs, call.shape, prepared.place, call.status)


def _memory(leaf: host.InputLeaf | host.DeviceLeaf, common: Shape, place: Place) -> Memory:
    if isinstance(leaf, host.DeviceLeaf):
        if leaf.shape != common and math.prod(leaf.shape) != 1:
            raise ShpyTypeError(
                f"{leaf.name} is a stream of shape {leaf.shape} in a run over {common}: streams do not broadcast",
                loc=here(),
                cure="a stream of that shape or of one element, or a sh.Table of it, which a kernel reads by index",
            )
        memory: Memory = leaf.entry.memory
        return memory
    flat = leaf.flat(common)
    made = place.space.allocate(len(flat), leaf.type, flat.dtype)
    made.write(flat)
    return made


def _table(table: Table, dtypes: Mapping[Base, Any]) -> TableData | TableMemory:
    if isinstance(table, StreamTable):
        return TableMemory(table.memory, table.shape)
    return table.data(dtypes[table.type.base])


def _like(memory: Memory, place: Place) -> Memory:
    return place.space.allocate(memory.count, memory.type, memory.dtype)


def _targets(layout: Layout, place: Place, shape: Shape, out: Any) -> tuple[list[StreamLeaf], Any]:
    """Return the leaf of a stream for each output, and the streams in the structure of the outputs."""
    if out is None:
        made = build_streams(layout, place, shape)
        return [entry for stream in streams_in(iter([made])) for entry in stream.leaf_entries()], made
    found = []
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
        found.append(entry)
    return found, out


def build_streams(layout: Layout, place: Place, shape: Shape) -> Any:
    """Make a stream for each output: structs and matrices are one stream, tuples and dicts have one for each part."""
    if isinstance(layout, Group) and layout.form != "struct":
        return build_group(layout, [build_streams(part, place, shape) for part in layout.parts])
    return Stream.fresh(shape, layout.cls, place)


def _check_apart(targets: Sequence[StreamLeaf], tables: Mapping[str, Table]) -> None:
    """No memory of an output may be read by index, or belong to another output too."""
    read = [table for table in tables.values() if isinstance(table, StreamTable)]
    for target, table in itertools.product(targets, read):
        if overlap(target.memory, table.memory):
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
