"""Kernels: a program compiled for a target, run on arrays.

Stage: compile and run, seen from above: checks and flattens the user's arrays, calls the backend, shapes the results.
"""

from __future__ import annotations

import itertools
import math
import sys
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from shpy.backends.base import Backend, Call, Counts, Executable, Options
from shpy.backends.device.listed import Listed
from shpy.backends.dump import dump
from shpy.backends.registry import backend as backend_named
from shpy.backends.slow import announced
from shpy.errors import LoopLimitExceeded, ShpyError, ShpyTypeError
from shpy.ieee import ieee_arithmetic, in_ieee_arithmetic
from shpy.ir.collector import uncollected
from shpy.ir.nodes import Status
from shpy.ir.text import print_module
from shpy.ir.traverse import grid_rank
from shpy.lang.data.tables import Table
from shpy.lang.data.textures import Texture2D, TextureType
from shpy.lang.programs.guarded import guarded
from shpy.lang.programs.record import Recorded
from shpy.lang.recording.location import here
from shpy.lang.recording.pickling import OfOneProcess
from shpy.lang.values.structure import Leaf, build_arrays
from shpy.passes.forget import forget_data
from shpy.run import host
from shpy.run.plans import KEPT, Plan, plan_of, signature
from shpy.streams.running import (
    Prepared,
    StreamResult,
    check_places,
    prepare,
    prepare_known,
    run_prepared,
    signature_of_streams,
)
from shpy.streams.stream import Place, streams_in

_executables: dict[tuple[str, str, Options], Executable] = {}
_KEPT = 512


class Result(Protocol):
    """The result of a run: `outputs` in the function's structure, `written` (bool, S), `count` elements written."""

    @property
    def outputs(self) -> Any:
        """Arrays, or Streams where data of the run were Streams."""

    @property
    def written(self) -> Any:
        """True for each element that was written: bools of the run's shape, an array or a Stream."""

    @property
    def count(self) -> int:
        """The number of elements that were written."""


@dataclass(eq=False)
class ArrayResult:
    """The result of a run over arrays. `status` is None where every element was written."""

    outputs: Any
    shape: tuple[int, ...]
    status: NDArray[np.int32] | None = None

    @cached_property
    def written(self) -> NDArray[np.bool_]:
        """True for each element that was written: bools of the run's shape."""
        return np.ones(self.shape, np.bool_) if self.status is None else self.status == Status.WRITTEN

    @cached_property
    def count(self) -> int:
        """The number of elements that were written."""
        return math.prod(self.shape) if self.status is None else int(np.count_nonzero(self.written))


class Kernel(OfOneProcess):
    """A compiled program. Call it with arrays (*S, N), or numbers; outputs come back in the function's structure.

    `source` is the emitted text, `notes` what there is to know about this target, `options` how it was compiled.
    """

    recorded: Recorded
    """The program's module, with what the host must know to run it."""

    _instead_of_pickle = "program.compile(backend) in the other process"

    def __init__(self, recorded: Recorded, backend: Backend, options: Options) -> None:
        self.recorded = recorded
        self.backend = backend.name
        self.options = options
        module = forget_data(recorded.module)
        key = (backend.name, print_module(module), options)
        dump("ir", recorded.module.name, lambda: str(recorded.module))
        found = _executables.get(key)
        if found is None:
            with ieee_arithmetic(), uncollected(), announced(module, backend.name):
                found = backend.compile(module, options)
            _executables[key] = found
            # Other threads compile meanwhile: the names are listed at once, and each may be gone already.
            for oldest in list(_executables)[: max(0, len(_executables) - _KEPT)]:
                _executables.pop(oldest, None)
        self._executable = found
        self._plans: dict[tuple[Any, ...] | None, Plan | None] = {}
        self._known_shapes: dict[tuple[Any, ...] | None, tuple[int, ...]] = {}
        self._reads_leaves = not recorded.tables and all(isinstance(t, Leaf) for t in recorded.inputs.values())
        self._plans_hold = next(streams_in(iter(recorded.tables.values())), None) is None
        dump("source", f"{recorded.module.name} on {backend.name}", lambda: self.source)
        devices = backend.devices()
        self.device = devices[options.device or 0]
        self._rank = grid_rank(recorded.module)

    @property
    def source(self) -> str:
        """The emitted text. Where the target chooses between two texts by measurement, the one in use."""
        return self._executable.source

    @property
    def notes(self) -> tuple[str, ...]:
        """Facts about this target and about the way that was chosen."""
        return self._executable.notes

    @in_ieee_arithmetic
    def __call__(self, *arrays: Any, shape: Any = None, **named: Any) -> Any:
        """Run on arrays; gives the outputs, zeros where elements were discarded.

        With a Stream among the inputs, or in a Table, the outputs are Streams on the same device.
        Raises ShpyTypeError for inputs that do not fit, LoopLimitExceeded where a loop ran out of iterations.
        """
        if not named and shape is None:
            known = self._run_planned(arrays, None)
            if known is not None:
                common, outputs, status = known
                return outputs if status is None else self._result(common, outputs, status).outputs
            over_streams = self._run_known_streams(arrays, None)
            if over_streams is not None:
                return over_streams.outputs
        given = host.bind(self.recorded, arrays, named)
        if self._holds_streams(given, None):
            return self._run_on_streams(given, None, shape, () if named else arrays).outputs
        common, outputs, status = self._execute(given, None, shape)
        self._plan(arrays, common, named, shape)
        return outputs if status is None else self._result(common, outputs, status).outputs

    @in_ieee_arithmetic
    def run(self, *arrays: Any, out: Any = None, shape: Any = None, where: Any = None, **named: Any) -> Result:
        """Run on arrays; gives a Result. `out` matches the outputs' dtypes and shapes and is written in place.

        Discarded elements keep what `out` held (zeros without it); `out` may be one of the inputs. With a Stream among
        the inputs, in a Table or as `out`, outputs and `written` are Streams on the same device. `where`, bools of the
        shape of the elements in an array or a Stream, tells which elements run; the others count as discarded.
        """
        if where is not None:
            given = host.bind(self.recorded, arrays, named)
            return self._guarded.run(*(given[name] for name in self.recorded.inputs), where, out=out, shape=shape)
        planned = not named and shape is None
        known = self._run_planned(arrays, out) if planned else None
        if known is not None:
            common, outputs, status = known
        else:
            over_streams = self._run_known_streams(arrays, out) if planned else None
            if over_streams is not None:
                return over_streams
            given = host.bind(self.recorded, arrays, named)
            if self._holds_streams(given, out):
                return self._run_on_streams(given, out, shape, () if named else arrays)
            common, outputs, status = self._execute(given, out, shape)
            self._plan(arrays, common, named, shape)
        if status is None:
            return ArrayResult(outputs, common)
        return self._result(common, outputs, status)

    @cached_property
    def _guarded(self) -> Kernel:
        """The kernel with one more input, `where`, that discards the elements for which it is False."""
        made = Kernel(guarded(self.recorded, None, "where"), backend_named(self.backend), self.options)
        if self._rank is None:  # else an element has to know its place among all
            made._executable = Listed(made._executable, self._executable, self.place.space)
        return made

    def _holds_streams(self, given: dict[str, Any], out: Any) -> bool:
        values = itertools.chain(given.values(), (out,), self.recorded.tables.values())
        return next(streams_in(values), None) is not None

    @property
    def place(self) -> Place:
        """The device on which it runs, and its working precision: where its streams have to be."""
        return Place(self.backend, self.options.device or 0, self.options.precision)

    def _run_on_streams(self, given: dict[str, Any], out: Any, shape: Any, arrays: tuple[Any, ...]) -> StreamResult:
        """Run over streams; once it went well, other runs over streams of this signature are not checked again."""
        prepared = self.prepare_on_device(given, out, shape)
        result = self._run_on_device(prepared)
        key = signature_of_streams(arrays) if arrays and shape is None and self._reads_leaves else None
        if key is not None:
            if len(self._known_shapes) >= KEPT:
                self._known_shapes.clear()
            self._known_shapes[key] = prepared.call.shape
        return result

    def _run_known_streams(self, streams: tuple[Any, ...], out: Any) -> StreamResult | None:
        """Run over streams of a signature with which a run went well; None where there was none."""
        common = self._known_shapes.get(signature_of_streams(streams)) if self._known_shapes else None
        if common is None:
            return None
        recorded, place = self.recorded, streams[0].place
        if out is not None:
            check_places([out], place, recorded.module.name)
        params = self._params({}) if recorded.params else {}
        return self._run_on_device(prepare_known(recorded, self._executable, params, place, streams, common, out))

    def _run_on_device(self, prepared: Prepared) -> StreamResult:
        """Run over streams; raises LoopLimitExceeded as soon as a loop can have run out of iterations."""
        result = run_prepared(self._executable, prepared)
        if result.status is not None and self._executable.loops and result.counts.stopped:
            raise self.limit_error(result.counts.stopped, result.counts.first, result)
        return result

    def prepare_on_device(self, given: dict[str, Any], out: Any, shape: Any) -> Prepared:
        """Check what a run over streams is given, and bring to the device what is not there yet."""
        recorded, place = self.recorded, self.place
        check_places([*given.values(), out, *recorded.tables.values()], place, recorded.module.name)
        dtypes = host.dtypes_at(self.options.precision)
        inputs = host.inputs(recorded.inputs, given, dtypes, self.options.math)
        common = host.common_shape(inputs, _shape_of(out) if shape is None and not inputs else shape)
        self._check_rank(common)
        tables = host.tables(recorded.inputs, given, recorded.tables)
        self._check_sizes(tables)
        params = self._params(given)
        return prepare(recorded, self._executable, tables, params, place, dtypes, inputs, common, out)

    def _plan(self, arrays: tuple[Any, ...], common: tuple[int, ...], named: Any, shape: Any) -> None:
        """Keep what a call of this signature has to do, once it went well."""
        key = None if named or shape is not None or not self._plans_hold else signature(arrays)
        if key is not None and key not in self._plans and 0 not in common:
            dtypes = host.dtypes_at(self.options.precision)
            if len(self._plans) >= KEPT:
                self._plans.clear()
            self._plans[key] = plan_of(self.recorded, dtypes, arrays, common, zeros=not self._executable.writes_all)

    def _run_planned(
        self, arrays: tuple[Any, ...], out: Any
    ) -> tuple[tuple[int, ...], Any, NDArray[np.int32] | None] | None:
        """Run as an earlier call of this signature did; None where there was none."""
        plan = self._plans.get(signature(arrays)) if self._plans else None
        if plan is None:
            return None
        recorded = self.recorded
        tables = recorded.tables
        data: dict[str, Any] = {}
        if tables:
            dtypes = host.dtypes_at(self.options.precision)
            data = {name: self._data(table, dtypes) for name, table in tables.items()}
        try:
            begun = plan.begin(arrays, self._params({}) if recorded.params else {}, data, out)
            if begun is None:
                return None
            call, outputs = begun
            return plan.shape, outputs, self._executable.run(call)
        except MemoryError:  # which is explained by the way that checks everything
            return None

    def _execute(
        self, given: dict[str, Any], out: Any, shape: Any
    ) -> tuple[tuple[int, ...], Any, NDArray[np.int32] | None]:
        """Run; gives the element shape, the outputs, and the statuses unless all elements were written."""
        recorded = self.recorded
        dtypes = host.dtypes_at(self.options.precision)
        inputs = host.streams(recorded.inputs, given, dtypes, self.options.math)
        common = host.common_shape(inputs, shape)
        self._check_rank(common)
        each = host.bytes_each(inputs, recorded.output, dtypes)
        try:
            if each * math.prod(common) > sys.maxsize:
                raise MemoryError
            return common, *self._run_over(common, given, inputs, dtypes, out)
        except MemoryError as error:
            raise ShpyError(
                f"{recorded.module.name} over the shape {common} needs {each * math.prod(common):,} bytes for its "
                f"inputs and outputs, {each} for each element, which is more than there are",
                loc=here(),
                cure="a smaller shape, or several runs over parts of it",
            ) from error

    def _run_over(
        self, common: tuple[int, ...], given: dict[str, Any], inputs: list[host.InputLeaf], dtypes: Any, out: Any
    ) -> tuple[Any, NDArray[np.int32] | None]:
        """Run over the elements; gives the outputs, and the statuses unless all elements were written."""
        recorded = self.recorded
        tables = host.tables(recorded.inputs, given, recorded.tables)
        self._check_sizes(tables)
        targets = host.targets(recorded.output, dtypes, common, out, zeros=not self._executable.writes_all)
        flat = [s.flat(common) for s in inputs]
        if out is not None:
            flat = [a.copy() if any(np.may_share_memory(a, t.array) for t in targets) else a for a in flat]
        call = Call(
            common,
            tuple(flat),
            tuple(t.flat for t in targets),
            self._params(given),
            {name: self._data(t, dtypes) for name, t in tables.items()},
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

    def _data(self, table: Table, dtypes: Any) -> Any:
        return table.data(dtypes[table.type.base])

    def _params(self, given: dict[str, Any]) -> dict[str, NDArray[Any]]:
        held = host.uniforms(self.recorded.params, self.options.precision, self.options.math)
        for name, type_ in self.recorded.inputs.items():
            if isinstance(type_, TextureType) and f"{name}.mode" in held:
                texture = given[name] if isinstance(given[name], Texture2D) else Texture2D(given[name])
                held[f"{name}.mode"] = np.asarray(texture.mode, np.int32)
        return held

    def _check_rank(self, shape: tuple[int, ...]) -> None:
        if self._rank is not None and self._rank != len(shape):
            raise ShpyTypeError(
                f"{self.recorded.module.name} uses grid_index({self._rank}) and is run over the shape {shape}",
                loc=here(),
                cure=f"shape=({', '.join('hwdn'[: self._rank])}), of rank {self._rank}",
            )

    def _result(self, shape: tuple[int, ...], outputs: Any, status: NDArray[np.int32]) -> Result:
        status = status.reshape(shape)
        counts = Counts.of(status)
        result = ArrayResult(outputs, shape, status)
        if counts.stopped:
            raise self.limit_error(counts.stopped, counts.first, result)
        return result

    def limit_error(self, count: int, first: int, result: Any) -> LoopLimitExceeded:
        """Return the error for so many elements stopped in loops; `first` is the least of their statuses."""
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
    found = next(streams_in(iter([out])), None)
    return None if found is None else found.shape
