"""Runs of chains: each kernel is bound once to the memory that it reads and writes, and then only started.

Stage: run. A stream that the chain writes has up to two memories of its own, so that a kernel can read the old elements
by index while it writes new ones. The user's data is only read. After a few rounds the same assignment of memories
recurs: the runs bound to it are kept and started again on the device's queue. The host waits only where a loop has to
know whether a round has written anything.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from shpy.backend.base import DeviceCall, Executable, Memory
from shpy.chains.counter import Counter
from shpy.chains.member import Member, Node, Watch, element_layout, is_gathered
from shpy.chains.merging import COUNT, merge_of
from shpy.chains.places import check_names, place_of
from shpy.chains.share import Share
from shpy.errors import ShpyTypeError
from shpy.lang.data.tables import Table, TableType
from shpy.lang.data.textures import Texture2D
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Layout, Leaf, leaves, spoken_type
from shpy.passes.modes import Precision
from shpy.run import host
from shpy.run.kernel import Kernel
from shpy.streams.elements import Shape, given_shape
from shpy.streams.stream import Stream

_AHEAD = 256
"""The most runs that are collected before they are started together."""


@dataclass(eq=False)
class ChainResult:
    """The result of a chain: the `streams` that it wrote, by name, and the `executions` of each kernel, by program."""

    streams: dict[str, Stream]
    executions: dict[str, int]
    _full: dict[str, int]
    _times: dict[str, list[Stream]]

    @cached_property
    def counts(self) -> dict[str, int]:
        """The elements that each kernel wrote in all executions; after SH_DISCARD they are counted on first access."""
        read = {name: sum(int(s.numpy().sum(dtype=np.int64)) for s in streams) for name, streams in self._times.items()}
        return {name: self._full[name] + read.get(name, 0) for name in self.executions}


@dataclass(slots=True, eq=False)
class _BoundRuns:
    """The runs bound to one assignment of memories, and the streams after them."""

    starts: list[Callable[[], None]] = field(default_factory=list)
    after: dict[Any, Stream] = field(default_factory=dict)
    statuses: list[tuple[Member, Memory]] = field(default_factory=list)
    sizes: list[tuple[Member, int]] = field(default_factory=list)
    calls: list[Any] = field(default_factory=list)
    times: int = 0


class Run:
    """One run of a chain. `perform` of its parts calls `play`; each loop that runs has a Watch in `watches`.

    A loop also tests `holds_back`: a kernel that has ready elements was held back. `open` lets such kernels run.
    `once` is true outside repeats and loops, where no bound run is kept for another execution. `numbers` has the
    numbers of passes, which take precedence over other streams of these names. `started` counts the kernels that were
    started, and `share` is the part of the chain that is done, 0 where that is unknown.
    """

    def __init__(
        self,
        node: Node,
        values: Mapping[str, Any],
        shape: Any,
        backend: str | None,
        device: int | None,
        precision: Precision | None,
    ) -> None:
        self._node = node
        self._members = tuple(node.kernels)
        self._shape = None if shape is None else given_shape(shape)
        check_names(node, values)
        self.place = place_of(self._members, values, backend, device, precision)
        self._kernels = {member: member.compiled(self.place) for member in self._members}
        self._constants: dict[str, Any] = {}
        self.current: dict[Any, Stream] = {}
        self.numbers: dict[Any, Stream] = {}
        self._counters: dict[Node, Counter] = {}
        for name, value in values.items():
            self._bring(name, value)
        if self._shape is not None:
            self._check_shape(self._shape)
        self._owned: dict[Any, list[Stream]] = {}
        self._plans: dict[Node, tuple[list[Any], dict[tuple[Any, ...], _BoundRuns]]] = {}
        self._pending: list[Callable[[], None]] = []
        self.watches: list[Watch] = []
        self.watch: Callable[[Run], None] | None = None
        """A function that is called after each start."""
        self.started, self.share, self._ahead = 0, 0.0, 1
        self.holds_back = False
        self.open = False
        self.once = True

    @property
    def kernels(self) -> list[Kernel]:
        """The compiled kernels."""
        return list(dict.fromkeys(self._kernels.values()))

    @property
    def elements(self) -> int:
        """The most elements of a stream, or of new streams."""
        return max(0 if self._shape is None else math.prod(self._shape), *(s.size for s in self.current.values()), 0)

    # Inputs of the chain

    def _bring(self, name: str, value: Any) -> None:
        """Copy an array or number to the device; data that is only read by index stays a Table or texture."""
        steps = [step for step in self._node.steps if name in step.inputs or name in dict(step.kernel.outputs)]
        inputs = [step.inputs[name] for step in steps if name in step.inputs]
        outputs = [layout for m in self._members for n, layout in m.outputs if n == name]
        gathered = all(is_gathered(type_) for type_ in inputs) and not outputs
        if isinstance(value, Table | Texture2D) or (gathered and not isinstance(value, Stream)):
            if not gathered:
                users = ", ".join(dict.fromkeys(step.kernel.signature for step in steps))
                raise ShpyTypeError(
                    f"{name} is given as a {type(value).__name__}, and kernels read or write it by element: {users}",
                    loc=here(),
                    cure=f"{name}=array, or a sh.Stream: a Table input reads that by index",
                )
            first = inputs[0]
            if not isinstance(value, Table | Texture2D):
                value = Table(value, first.cls, name) if isinstance(first, TableType) else Texture2D(value, name=name)
            self._constants[name] = value
        elif isinstance(value, Stream):
            self.current[name] = value
        else:
            elements = [type_ for type_ in inputs if not is_gathered(type_)]
            layout = elements[0] if elements else outputs[0] if outputs else element_layout(inputs[0])
            self.current[name] = self._uploaded(name, layout, value)

    def _uploaded(self, name: str, layout: Any, value: Any) -> Stream:
        """Return a stream of an array, of a number (one element), or of streams for the fields of a struct."""
        entries = host.inputs({name: layout}, {name: value}, self.place.precision)
        shape = host.common_shape(entries, None)
        memories: list[Memory] = []
        for leaf in entries:
            if isinstance(leaf, host.DeviceLeaf):
                memories.append(leaf.entry.memory)
                continue
            flat = leaf.flat(shape)
            memory = self.place.space.allocate(len(flat), leaf.type, flat.dtype)
            memory.write(flat)
            memories.append(memory)
        return Stream.over(_class_of(layout), shape, self.place, memories)

    def _check_shape(self, shape: Shape) -> None:
        """Raise ShpyTypeError for a shape that no kernel uses, since all have other shapes from their streams."""
        shapes = {name: stream.shape for name, stream in self.current.items()}
        for step in self._node.steps:
            member = step.kernel
            read = [name for name, type_ in step.inputs.items() if not is_gathered(type_)]
            written = [name for name, _ in member.outputs]
            many = [name for name in (*read, *written) if math.prod(shapes.get(name, ())) != 1]
            if not many or shapes[many[0]] == shape:
                return
            shapes.update((name, shapes[many[0]]) for name in written)
        raise ShpyTypeError(
            f"shape={shape}, and {member.signature} runs over the stream {many[0]} of the shape {shapes[many[0]]}",
            loc=here(),
            cure="no shape=: it is for kernels that read no stream by element",
        )

    # Playing

    def play(self, node: Node) -> None:
        """Run each kernel of a part once."""
        entry = self._plans.get(node)
        if entry is None:
            keys: dict[Any, None] = {}
            for member in node.kernels:
                named = (*member.inputs, *(name for name, _ in member.outputs))
                keys.update(dict.fromkeys((*named, ("times", member), ("stop", member))))
            entry = self._plans[node] = list(keys), {}
        names, plans = entry
        current = self.current
        before = current | self.numbers if self.numbers else current
        state = (object(),) if self.once else tuple([before.get(name) for name in names])
        plan = plans.get(state)
        if plan is None:
            plan = plans[state] = self._plan(node)
        else:
            current.update(plan.after)
        plan.times += 1
        self._pending += plan.starts
        for member, status in plan.statuses if self.watches else ():
            open_watches = [watch for watch in self.watches if watch.needs(member)]
            if open_watches:
                self.flush()
                written = self.place.space.count(status).written > 0
                for watch in open_watches:
                    watch.wrote = written
        if len(self._pending) >= (_AHEAD if self.watch is None else self._ahead):
            self.flush()

    @contextmanager
    def numbered(self, node: Node, index: str | None, first: int) -> Iterator[Callable[[], None]]:
        """Count the passes of a part from `first` in the stream `index`; give the function that begins the next one."""
        if index is None:
            yield lambda: None
            return
        if node not in self._counters:
            self._counters[node] = Counter(first, self.place)
        counter, outside = self._counters[node], self.numbers
        counter.restart()
        self.numbers = outside | {index: counter.stream}

        def advance() -> None:
            self._pending.append(counter.advance())
            self.numbers = outside | {index: counter.stream}

        try:
            yield advance
        finally:
            self.numbers = outside

    def admits(self, share: Share) -> bool:
        """Return whether enough elements are ready, or any if `open`; else `holds_back` is set if some are ready."""
        self.flush()
        count, is_enough = share.count(self.place, self.current | self.numbers)
        if is_enough or (count and self.open):
            return True
        self.holds_back |= count > 0
        return False

    def flush(self) -> None:
        """Start all collected runs."""
        pending, self._pending = self._pending, []
        if pending:
            self._start(pending)

    def passed(self, node: Node, share: float) -> None:
        """Note which share of a part is done, if it is the whole chain."""
        if node is self._node:
            self.share = share

    def _start(self, runs: list[Callable[[], None]]) -> None:
        """Start runs. Where each start is watched they become more and more, since the first may take long."""
        self.place.space.start(runs)
        self.started += len(runs)
        if self.watch is not None:
            self._ahead = min(2 * self._ahead, _AHEAD)
            self.watch(self)

    def _plan(self, node: Node) -> _BoundRuns:
        plan = _BoundRuns()
        for member in node.kernels:
            self._bind(member, plan)
        return plan

    def _bind(self, member: Member, plan: _BoundRuns) -> None:
        """Bind a kernel to the current memory of its streams, and add its run to the plan."""
        kernel = self._kernels[member]
        shape = self._shape_of(member)
        size = math.prod(shape)
        executable = kernel._executable
        values = host.bind(member.recorded, (), {n: self._input(n, member) for n in member.inputs if self._has(n)})
        after: dict[Any, Stream] = {}
        if executable.writes_all or not size:
            after = {name: self._target(name, layout, shape, member) for name, layout in member.outputs}
            if size:
                whole = len(after) == 1 and member.outputs[0][1] is member.recorded.output
                out = next(iter(after.values())) if whole else after
                prepared = kernel.prepare_on_device(values, out, shape)
                self._begin(executable, prepared.call, plan)
            plan.sizes.append((member, size))
        else:
            prepared = kernel.prepare_on_device(values, None, shape)
            self._begin(executable, prepared.call, plan)
            assert prepared.call.status is not None
            plan.statuses.append((member, prepared.call.status))
            plan.sizes.append((member, 0))
            after = self._merge(member, prepared.call, plan)
        self.current.update(after)
        plan.after.update(after)

    def _merge(self, member: Member, call: DeviceCall, plan: _BoundRuns) -> dict[Any, Stream]:
        """Add the run that merges written elements into the streams and counts them; return the new streams."""
        stops = bool(self._kernels[member]._executable.loops)
        counters = [("times", member), ("stop", member)][: 1 + stops]
        parts: list[tuple[Any, Layout]] = [*member.outputs, *((key, Leaf(COUNT)) for key in counters)]
        after = {key: self._target(key, layout, call.shape, None) for key, layout in parts}
        old = [m for key, layout in parts for m in self._memories(key, layout)]
        new = [entry.memory for stream in after.values() for entry in stream.leaf_entries()]
        classes = [cls for _, layout in member.outputs for _, _, cls in leaves(layout, "")]
        merge = merge_of(classes, stops)
        kernel = merge.compile_at(self.place)
        whole = DeviceCall(call.shape, (call.status, *call.outputs, *old), tuple(new), None, {}, {})  # type: ignore[arg-type]
        self._begin(kernel._executable, whole, plan)
        return after

    def _begin(self, executable: Executable, call: DeviceCall, plan: _BoundRuns) -> None:
        """Start a run that happens once; otherwise add it to the plan, which keeps its memory alive."""
        if self.once:
            self.flush()
            self._start([executable.ready(call, once=True)])
        else:
            plan.starts.append(executable.ready(call))
            plan.calls.append(call)

    def _memories(self, key: Any, layout: Layout) -> list[Memory]:
        """Return the memories of a stream before a kernel runs; a single zero, which broadcasts, if it is new."""
        stream = self.current.get(key)
        if stream is not None:
            return [entry.memory for entry in stream.leaf_entries()]
        zero = Stream.empty(1, _class_of(layout), *self.place)
        return [entry.memory for entry in zero.leaf_entries()]

    def _target(self, key: Any, layout: Layout, shape: Shape, member: Member | None) -> Stream:
        """Return the stream that a kernel (None: a merge) writes: the current one, or a second one if that is read."""
        space, now = self.place.space, self.current.get(key)
        if now is not None and now.size != 1 and now.shape != shape:
            raise ShpyTypeError(
                f"the stream {key} has the shape {now.shape}, and {member.signature if member else 'a kernel'} would "
                f"replace it by one of the shape {shape}",
                loc=here(),
                cure=f"another name for the output, or inputs of the shape {now.shape}",
            )
        owned = [stream for stream in self._owned.setdefault(key, []) if stream.shape == shape]
        type_ = None if member is None else member.inputs.get(key)
        is_read = member is None or type_ is not None
        apart = is_read and (not space.overwrites or (type_ is not None and is_gathered(type_)))
        if not apart and any(stream is now for stream in owned):
            return now  # type: ignore[return-value]
        beside = next((stream for stream in owned if stream is not now), None)
        if beside is None:
            beside = Stream.fresh(shape, _class_of(layout), self.place)
            self._owned[key].append(beside)
        return beside

    def _has(self, name: str) -> bool:
        return name in self.numbers or name in self._constants or name in self.current

    def _input(self, name: str, member: Member) -> Any:
        """Return the current stream, Table or number of an input."""
        if name in self.numbers:
            return self.numbers[name]
        if name in self._constants:
            return self._constants[name]
        stream, type_ = self.current[name], member.inputs[name]
        if isinstance(type_, TableType) and len(stream.shape) != type_.rank:
            raise ShpyTypeError(
                f"the stream {name} has the shape {stream.shape}, and {member.signature} reads it as a Table of "
                f"{type_.rank} axes",
                loc=here(),
                cure=f"sh.Table[{spoken_type(type_.cls)}, {len(stream.shape)}]"
                if len(stream.shape) in (1, 2, 3)
                else f"an array of {type_.rank} axes for {name}",
            )
        return stream

    def _shape_of(self, member: Member) -> Shape:
        """Return the shape of a run: of the streams it reads by element, of those it replaces, or `shape=` of `run`."""
        now = self.current | self.numbers
        read = {n: now[n].shape for n, t in member.inputs.items() if not is_gathered(t) and n in now}
        written = {name: self.current[name].shape for name, _ in member.outputs if name in self.current}
        for shapes in (read, written):
            many = {name: shape for name, shape in shapes.items() if math.prod(shape) != 1}
            if len(set(many.values())) > 1:
                listed = ", ".join(f"{name} {shape}" for name, shape in many.items())
                raise ShpyTypeError(
                    f"the streams of {member.signature} have several shapes: {listed}",
                    loc=here(),
                    cure="streams of one shape; a Table reads one of another shape by index",
                )
            if many:
                return next(iter(many.values()))
        if self._shape is not None:
            return self._shape
        for shapes in (read, written):  # of one element each; a number has no axes
            if any(shapes.values()):
                return max(shapes.values(), key=len)
        if read or written:
            return ()
        raise ShpyTypeError(
            f"{member.signature} reads no stream by element that would tell how many there are",
            loc=here(),
            cure="chain.run(shape=(h, w), …)",
        )

    # The result

    def result(self) -> ChainResult:
        """Run the chain; raises LoopLimitExceeded of the first kernel whose loop was stopped."""
        self._node.perform(self)
        result = self.so_far()
        for member in self._members:
            stop = self.current.get(("stop", member))
            if stop is not None:
                counts = self.place.space.count(stop.leaf_entries()[0].memory)
                if counts.stopped:
                    raise self._kernels[member].limit_error(counts.stopped, counts.first, result)
        return result

    def so_far(self) -> ChainResult:
        """Return the current streams and the counts."""
        self.flush()
        names = _labels(self._members)
        executions = dict.fromkeys(names.values(), 0)
        full = dict(executions)
        times: dict[str, list[Stream]] = {}
        for _, plans in self._plans.values():
            for plan in plans.values():
                for member, size in plan.sizes:
                    executions[names[member]] += plan.times
                    full[names[member]] += plan.times * size
        for member, label in names.items():
            stream = self.current.get(("times", member))
            if stream is not None:
                times.setdefault(label, []).append(stream)
        streams = {}
        for name in dict.fromkeys(name for member in self._members for name, _ in member.outputs):
            stream = self.current.get(name)
            if stream is not None:
                streams[name] = stream if any(stream is s for s in self._owned.get(name, ())) else stream.copy()
        return ChainResult(streams, executions, full, times)


def _class_of(layout: Layout) -> Any:
    return layout.cls


def _labels(members: Iterable[Member]) -> dict[Member, str]:
    """Return a label for each kernel: the name of its program, with a number if another program has this name."""
    programs: dict[str, Any] = {}
    labels = {}
    for member in members:
        label, count = member.name, 2
        while programs.setdefault(label, member.original) is not member.original:
            label, count = f"{member.name}_{count}", count + 1
        labels[member] = label
    return labels
