"""Kernels: a program compiled for a target, run on arrays.

Stage: compile and run, seen from above: checks and flattens the user's arrays, calls the backend, shapes the results.
"""

from __future__ import annotations

import itertools
import math
import sys
from dataclasses import replace
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from shpy.backend.base import Backend, Call, Device, Executable, Memory, Options
from shpy.backend.device.listed import ListedKernel
from shpy.backend.dump import dump
from shpy.backend.registry import AUTO, backend as backend_named
from shpy.backend.slow import announced
from shpy.errors import BackendUnavailable, LoopLimitExceeded, ShpyError, ShpyTypeError
from shpy.ieee import ieee_arithmetic, in_ieee_arithmetic
from shpy.ir.collector import uncollected
from shpy.ir.constants import dtypes_at
from shpy.ir.digest import digest
from shpy.ir.metadata import NOTHING
from shpy.ir.nodes import Let, Module, Status
from shpy.ir.traverse import grid_rank, walk
from shpy.lang.data.tables import Table
from shpy.lang.data.textures import Texture2D, TextureType
from shpy.lang.programs.joined import guarded
from shpy.lang.programs.record import RecordedProgram
from shpy.lang.recording.location import here
from shpy.lang.recording.pickling import Unchanging
from shpy.lang.values.structure import build_arrays
from shpy.passes.fuse import fuse
from shpy.passes.known import Ranges
from shpy.run import host
from shpy.run.bound import KEPT, Bound, Ran, bound_of, signature
from shpy.run.expanding import axes, expanding
from shpy.run.on_device import PreparedCall, check_places, has_elements_of, memory_of, prepare
from shpy.run.result import Result
from shpy.run.tiers import QUICK, TieredExecutable, auto
from shpy.streams.elements import InputLeaf
from shpy.streams.stream import Place, Stream, streams_in

_executables: dict[tuple[str, bytes, Options], Executable] = {}
_KEPT = 512
_shared_modules: WeakKeyDictionary[RecordedProgram, tuple[Module, bytes]] = WeakKeyDictionary()
"""The results of `_without_data`: a program is compiled for several backends, and again with other options."""


def forget_data(module: Module) -> Module:
    """Return the module without values of params and without shapes of tables that a kernel's text does not depend on.

    So programs that differ only in these share a kernel; a run passes the values and shapes:

        param sky: Color f3 = (0.2, 0.4, 1.0)   ->   param sky: Color f3 = (0.0, 0.0, 0.0)
        table heights: f[64, 64]                ->   table heights: f[?, ?]
        table steps: f[40]                      ->   table steps: f[8]              (read at `%i & 7`: at least 8)

    A shape that the program reads by `table_size` stays, since `fold` makes it a constant. If an index of a table with
    one axis is known to be in range, the least size for which it is in range stays, so that printers omit the clamp.
    """
    sizes = {table.name: table.size for table in module.tables}
    kept: dict[str, tuple[int, ...]] = {}
    for function in module.functions:
        ranges = Ranges(function)
        for let in walk(function.body):
            if not isinstance(let, Let) or let.op not in ("table", "table_size"):
                continue
            name = str(let.attr)
            size = sizes[name]
            if size is None:
                continue
            if let.op == "table_size":
                kept[name] = size
            elif len(size) == 1:
                low, high = ranges.span(let.args[0])
                if 0 <= low and high < size[0]:
                    kept[name] = (max(high + 1, *kept.get(name, (0,))),)
    params = tuple(replace(p, value=(0,) * len(p.value), about=NOTHING) for p in module.params)
    tables = tuple(replace(t, size=kept.get(t.name)) for t in module.tables)
    return replace(module, params=params, tables=tables)


def _without_data(recorded: RecordedProgram) -> tuple[Module, bytes]:
    """Return the module without what no kernel's text depends on, and its digest, by which kernels are shared."""
    entry = _shared_modules.get(recorded)
    if entry is None:
        module = forget_data(recorded.module)
        entry = _shared_modules[recorded] = module, digest(module)
    return entry


class Kernel(Unchanging):
    """A compiled program. Call it with arrays (*S, N), or numbers; outputs come back in the function's structure.

    `source` is the emitted text, `notes` are remarks on this target, `options` those of the compilation.
    """

    recorded: RecordedProgram
    """The program's module, with the facts that the host needs to run it."""

    def __init__(self, recorded: RecordedProgram, backend: Backend, options: Options) -> None:
        self.recorded = recorded
        self.backend, self._target = backend.name, backend
        self.options = options
        module, shared = _without_data(recorded)
        key = (backend.name, shared, options)
        dump("ir", recorded.module.name, lambda: str(recorded.module))
        executable = _executables.get(key)
        if executable is None:
            with ieee_arithmetic(), uncollected(), announced(module, backend.name):
                executable = backend.compile(fuse(module) if options.fuse else module, options)
            _executables[key] = executable
            # Other threads compile meanwhile: the names are listed at once, and each may be gone already.
            for oldest in list(_executables)[: max(0, len(_executables) - _KEPT)]:
                _executables.pop(oldest, None)
        self._executable = executable
        self._dtypes = dtypes_at(options.precision)
        self._bound_calls: dict[tuple[Any, ...] | None, Bound | None] = {}
        """Calls by the signature of their inputs."""
        self._repeats = next(streams_in(iter(recorded.tables.values())), None) is None
        dump("source", f"{recorded.module.name} on {backend.name}", lambda: self.source)
        self._rank = grid_rank(recorded.module)

    @classmethod
    def on(cls, recorded: RecordedProgram, name: str, options: Options) -> Kernel:
        """Compile for a backend by its name; BackendUnavailable where it, or the device, is not there."""
        target: Backend = auto if name == AUTO else backend_named(name)
        device = options.device
        if device is not None:
            count = len(target.devices())
            if not 0 <= device < count:
                raise BackendUnavailable(f"{name} has no device {device}, only {count}", loc=here(), cure="device=0")
        return cls(recorded, target, options)

    def __reduce__(self) -> Any:
        return Kernel.on, (self.recorded, self.backend, self.options)

    @property
    def device(self) -> Device:
        """The device that it runs on. Its facts, which a probe may have to find first, are in `notes`."""
        return backend_named(self.runs_on).devices()[self.options.device or 0]

    @property
    def runs_on(self) -> str:
        """The name of the backend in use: `backend`, or the one that an "auto" kernel uses now."""
        if self.backend != AUTO:
            return self.backend
        return self._executable.runs_on if isinstance(self._executable, TieredExecutable) else QUICK

    @property
    def source(self) -> str:
        """The emitted text. Where the target chooses between two texts by measurement, the one in use."""
        return self._executable.source

    @property
    def notes(self) -> tuple[str, ...]:
        """Facts about this target and about the way that was chosen."""
        return self._executable.notes

    @in_ieee_arithmetic
    def __call__(self, /, *arrays: Any, shape: Any = None, **named: Any) -> Any:
        """Run on arrays; return the outputs, zeros where elements were discarded.

        With a Stream among the inputs, or in a Table, the outputs are Streams on the same device.
        Raises ShpyTypeError for inputs that do not fit, LoopLimitExceeded where a loop ran out of iterations.
        """
        ran = self._run(arrays, None, shape, named)
        return ran[0] if ran[2] is None else self._checked(Result(*ran)).outputs

    @in_ieee_arithmetic
    def run(self, /, *arrays: Any, out: Any = None, shape: Any = None, where: Any = None, **named: Any) -> Result:
        """Run on arrays; return a Result. `out` matches the outputs' dtypes and shapes and is written in place.

        Discarded elements keep the values of `out` (zeros without it); `out` may be one of the inputs. With a Stream
        among the inputs, in a Table or as `out`, outputs and `written` are Streams on the same device. `where`, bools
        of the shape of the elements in an array or a Stream, tells which elements run; the others count as discarded.
        """
        if where is not None:
            values = host.bind(self.recorded, arrays, named)
            return self._guarded.run(*(values[name] for name in self.recorded.inputs), where, out=out, shape=shape)
        return self._checked(Result(*self._run(arrays, out, shape, named)))

    def _run(self, inputs: tuple[Any, ...], out: Any, shape: Any, named: dict[str, Any]) -> Ran:
        """Run as an earlier call of this signature did, or else check everything."""
        recorded = self.recorded
        key = None if named or shape is not None else signature(inputs)
        bound_call = self._bound_calls.get(key)
        if bound_call is not None:
            params = self._params({}) if recorded.params else {}
            try:
                ran = bound_call.run(inputs, params, recorded.tables, out)
                if ran is not None:
                    return ran
            except MemoryError:
                pass  # the path with all checks explains this error, as it does faults of `out`
        values = host.bind(recorded, inputs, named)
        if self._holds_streams(values, out):
            ran = self.prepare_on_device(values, out, shape).run(self._executable)
        else:
            ran = self._run_over_arrays(values, out, shape)
        if key is not None and key not in self._bound_calls and self._repeats:
            if len(self._bound_calls) >= KEPT:
                self._bound_calls.clear()
            self._bound_calls[key] = bound_of(recorded, self._executable, self._dtypes, inputs, ran[1], ran[3])
        return ran

    def _checked(self, result: Result) -> Result:
        """Return a result; raises LoopLimitExceeded if a loop ran out of iterations."""
        if result.status is not None and self._executable.loops and result.counts.stopped:
            raise self.limit_error(result.counts.stopped, result.counts.first, result)
        return result

    @cached_property
    def _guarded(self) -> Kernel:
        """The kernel with one more input, `where`, that discards the elements for which it is False."""
        kernel = Kernel(guarded(self.recorded, None, "where"), self._target, self.options)
        if self._rank is None:  # a list of elements has no grid index
            kernel._executable = ListedKernel(kernel._executable, self._executable, self.place.space)
        return kernel

    def _holds_streams(self, arguments: dict[str, Any], out: Any) -> bool:
        values = itertools.chain(arguments.values(), (out,), self.recorded.tables.values())
        return next(streams_in(values), None) is not None

    @property
    def place(self) -> Place:
        """The device on which it runs, and its working precision: where its streams have to be."""
        name = QUICK if self.backend == AUTO else self.backend
        return Place(name, self.options.device or 0, self.options.precision)

    def prepare_on_device(self, values: dict[str, Any], out: Any, shape: Any) -> PreparedCall:
        """Check the arguments of a run over streams, and copy host arrays to the device."""
        recorded, place = self.recorded, self.place
        check_places([*values.values(), out, *recorded.tables.values()], place, recorded.module.name)
        inputs = host.inputs(recorded.inputs, values, self.options.precision, self.options.math)
        common = host.common_shape(inputs, _shape_of(out) if shape is None and not inputs else shape)
        self._check_rank(common)
        tables = host.tables(recorded.inputs, values, recorded.tables)
        self._check_sizes(tables)
        memories = [self._expanded(leaf, memory_of(leaf, common, place), common) for leaf in inputs]
        return prepare(recorded, self._executable, memories, tables, self._params(values), place, common, out)

    def _expanded(self, leaf: host.DeviceLeaf | InputLeaf, memory: Memory, common: tuple[int, ...]) -> Memory:
        """Return the memory of an input of the run, in which a stream of another shape is broadcast on the device."""
        if isinstance(leaf, InputLeaf) or has_elements_of(leaf.shape, common) or not math.prod(common):
            return memory
        options = Options(device=self.options.device, precision=self.options.precision)
        kernel = Kernel.on(expanding(leaf.cls), self.place.backend, options)
        elements = Stream.over(leaf.cls, (math.prod(leaf.shape),), self.place, [memory])
        expanded: Stream = kernel(Table(elements, name="data"), axes(leaf.shape, common), shape=(math.prod(common),))
        return expanded.leaf_entries()[0].memory

    def _run_over_arrays(self, values: dict[str, Any], out: Any, shape: Any) -> Ran:
        """Check what a run over arrays is given, and run."""
        recorded, dtypes = self.recorded, self._dtypes
        inputs = host.streams(recorded.inputs, values, self.options.precision, self.options.math)
        common = host.common_shape(inputs, shape)
        self._check_rank(common)
        each = host.bytes_each(inputs, recorded.output, dtypes)
        try:
            if each * math.prod(common) > sys.maxsize:
                raise MemoryError
            outputs, status = self._run_over(common, values, inputs, out)
            return outputs, common, status, None
        except MemoryError as error:
            raise ShpyError(
                f"{recorded.module.name} over the shape {common} needs {each * math.prod(common):,} bytes for its "
                f"inputs and outputs, {each} for each element, which is more than there are",
                loc=here(),
                cure="a smaller shape, or several runs over parts of it",
            ) from error

    def _run_over(
        self, common: tuple[int, ...], values: dict[str, Any], inputs: list[InputLeaf], out: Any
    ) -> tuple[Any, NDArray[np.int32] | None]:
        """Run over the elements; return the outputs, and the statuses unless all elements were written."""
        recorded, dtypes = self.recorded, self._dtypes
        tables = host.tables(recorded.inputs, values, recorded.tables)
        self._check_sizes(tables)
        targets = host.targets(recorded.output, dtypes, common, out, zeros=not self._executable.writes_all)
        flat = [s.flat(common) for s in inputs]
        if out is not None:
            flat = [a.copy() if any(np.may_share_memory(a, t.array) for t in targets) else a for a in flat]
        call = Call(
            common,
            tuple(flat),
            tuple(t.flat for t in targets),
            self._params(values),
            {name: t.data(dtypes[t.type.base]) for name, t in tables.items()},
            fresh=out is None,
        )
        status = self._executable.run(call) if math.prod(common) else None
        for target in targets:
            target.finish()
        if out is None:
            results = (t.array if t.array.ndim else t.array[()] for t in targets)
            out = build_arrays(recorded.output, results)
        return out, status

    def _check_sizes(self, tables: dict[str, Table]) -> None:
        """Raise ShpyTypeError for data of another size than the declared one, which is folded into the text."""
        for declared in self.recorded.module.tables:
            shape = tuple(int(n) for n in tables[declared.name].shape)
            if declared.size not in (None, shape):
                raise ShpyTypeError(
                    f"{declared.name} is declared with the shape {declared.size}, and this table has {shape}",
                    loc=here(),
                    cure="data of that shape, or a program recorded with a Table of this one",
                )

    def _params(self, arguments: dict[str, Any]) -> dict[str, NDArray[Any]]:
        values = host.uniforms(self.recorded.params, self.options.precision, self.options.math)
        for name, type_ in self.recorded.inputs.items():
            if isinstance(type_, TextureType) and f"{name}.mode" in values:
                texture = arguments[name] if isinstance(arguments[name], Texture2D) else Texture2D(arguments[name])
                values[f"{name}.mode"] = np.asarray(texture.mode, np.int32)
        return values

    def _check_rank(self, shape: tuple[int, ...]) -> None:
        if self._rank is not None and self._rank != len(shape):
            extents = ("(h,)", "(h, w)", "(h, w, d)", "(h, w, d, n)")[self._rank - 1]
            raise ShpyTypeError(
                f"{self.recorded.module.name} uses grid_index({self._rank}) and is run over the shape {shape}",
                loc=here(),
                cure=f"shape={extents}, of rank {self._rank}",
            )

    def limit_error(self, count: int, first: int, result: Any) -> LoopLimitExceeded:
        """Return the error for a number of elements that stopped in loops; `first` is the least of their statuses."""
        elements = f"{count} element{'s' if count > 1 else ''}"
        loops = self._executable.loops
        if first < Status.FIRST_LOOP:
            loc = next((loc for loc in loops if loc is not None), self.recorded.module.entry.loc)
            return LoopLimitExceeded(
                f"the device stopped a loop of {elements} of its own accord",
                loc=loc,
                cure="fewer iterations, or another backend: what a device allows is its own",
                result=result,
                count=count,
            )
        return LoopLimitExceeded(
            f"this loop took more than {self.options.loop_limit} iterations in {elements}",
            loc=loops[first - Status.FIRST_LOOP],
            cure="a condition that ends it, or compile(loop_limit=N) if it needs more (None: no limit)",
            result=result,
            count=count,
        )

    def __repr__(self) -> str:
        return f"<Kernel {self.recorded.module.name} on {self.backend}, {self.device.name}>"


def _shape_of(out: Any) -> tuple[int, ...] | None:
    """Return the element shape of streams that a run writes."""
    stream = next(streams_in(iter([out])), None)
    return None if stream is None else stream.shape
