"""The numpy backend: compiles the printed Python text and runs it over arrays, a tile of lanes at a time.

Stage: compile, run. It is always available. A tile is small enough to stay in a core's cache, and large enough that
Python's own time does not matter. Tiles are read before they are written, so an output may be an input.

    executable = NumpyBackend().compile(module, Options())
    status = executable.run(call)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np

from shpy.backend.base import Array, Call, Device, DeviceCall, Options
from shpy.backend.device.listed import few, is_worth_a_list, run_some
from shpy.backend.device.probe import EMULATED
from shpy.backend.dump import dump
from shpy.backend.numpy.device.collective import COLLECTIVES
from shpy.backend.numpy.device.memory import NumpySpace, over_arrays
from shpy.backend.numpy.tables import ElementList, Place, TableView, places_of
from shpy.backend.numpy.text.apart import ApartLayout, lay_out
from shpy.backend.numpy.text.module import PrintedModule, print_python
from shpy.errors import BackendUnavailable, CompileError
from shpy.ir import exact
from shpy.ir.constants import DTYPES
from shpy.ir.nodes import Let, Loc, Module, Status, Value
from shpy.ir.ops import OPS
from shpy.ir.tabledata import TableData
from shpy.ir.traverse import walk
from shpy.ir.types import Type
from shpy.passes.neighbours import find_neighbours
from shpy.passes.pipeline import PreparedModule, Target, prepare
from shpy.passes.private import private_memory
from shpy.passes.rejecting import find_rejection

SPACE: Final = NumpySpace(COLLECTIVES)
"""The host's memory."""
TILE: Final = 32_768
"""Lanes that run together."""
LARGE_TILE: Final = 65_536
"""Lanes that run together where that is better, see `PrintedModule.large`."""
_MOST_PRIVATE: Final = 1 << 26
"""Bytes of the local arrays of a tile."""
_FEWEST: Final = 64
"""Lanes of a tile whose arrays take more, so that Python's own time stays in proportion."""
_OF_PLACE: Final[dict[tuple[str, str], Callable[[Place], Any]]] = {
    ("place", ""): lambda place: place,
    ("grid_index", ""): attrgetter("index"),
    ("lanes", ""): attrgetter("lanes"),
}
"""The arguments of a text that depend on the tile."""
_KEPT_MEMORY: Final = 1 << 24
# Far out and beside a multiple of pi / 2, numpy's own sine and cosine of binary64 lose up to half of the digits.
LACKING: Final = frozenset({"exp10", "erf", "erfc", "sinpi", "cospi"})
"""Functions that numpy has not, and computes by their formulas in every mode."""
TARGET: Final = Target(
    "numpy", native=frozenset(OPS) - {"rsqrt"} - LACKING, bounded=frozenset({"sin", "cos", "tan"}), vector=True
)

EXACT: Final = frozenset(exact.FUNCTIONS) - {"sin", "cos"} - LACKING
"""Functions that numpy does faster than a formula: its sine and cosine of binary64 take one element at a time."""


class NumpyBackend:
    """The backend: see `base.Backend`."""

    name = "numpy"

    def __init__(self) -> None:
        # glibc gives memory back to the system as soon as more than 128 KiB are free, and a tile's arrays would be
        # mapped anew at every operation. After a large block was freed it keeps twice its size. Nothing writes to it.
        np.empty(_KEPT_MEMORY, np.uint8)

    def devices(self) -> list[Device]:
        """Return the one device: the processor."""
        return [Device("numpy", np.__version__, ("f64",))]

    def compile(self, module: Module, options: Options, tile: int | None = None) -> NumpyExecutable:
        """Prepare, vectorise, print and compile; CompileError naming the user's line. `tile` is for tests."""
        if options.device not in (None, 0):
            raise BackendUnavailable(f"numpy has one device, not a device {options.device}", cure="device=0")
        if options.lanes not in ("auto", 1):
            what = f"lanes={options.lanes!r} is for OpenCL: numpy runs tiles of elements"
            raise CompileError(what, cure='program.compile("numpy")')
        functions = _functions(module) if options.math == "strict" else frozenset()
        trusted = frozenset(filter(exact.trusted, functions))
        prepared = prepare(module, options, replace(TARGET, exact=trusted))
        layout = lay_out(prepared.module)
        vector = find_neighbours(layout.vector)
        dump("vector", module.name, lambda: str(vector.module))
        printed = print_python(vector, exact=trusted)
        tile = tile or _tile_of(prepared.module, LARGE_TILE if printed.large else TILE)
        shorter = find_rejection(module)
        rejection = None if shorter is None else self.compile(shorter, options)
        notes = _notes(functions - trusted)
        if options.fuse:
            notes = (*notes, EMULATED)
        return NumpyExecutable(prepared, layout, printed, tile, _compiled(printed, module), notes, rejection)

    def space(self, device: int | None) -> NumpySpace:
        """Return the host's memory."""
        return SPACE


def _tile_of(module: Module, most: int) -> int:
    """Return the lanes of a tile: `most`, or as many as the memory for local arrays has room for."""
    each = private_memory(module).size
    return most if each == 0 else min(most, max(_FEWEST, _MOST_PRIVATE // each))


def _functions(module: Module) -> frozenset[str]:
    """Return the operations of a module that numpy's functions of binary64 can compute."""
    lets = (s for f in module.functions for s in walk(f.body) if isinstance(s, Let))
    return EXACT.intersection(let.op for let in lets)


def _notes(distrusted: frozenset[str]) -> tuple[str, ...]:
    """Describe this version of numpy, where it has functions that are not close enough."""
    if not distrusted:
        return ()
    names = " and ".join(sorted(distrusted))
    return (f"numpy {np.__version__} gets {names} of binary64 wrong: strict mode has formulas in their place",)


def _compiled(printed: PrintedModule, module: Module) -> Callable[..., Any]:
    """Return the entry of the text, which is our own: names were made by `emit/names`, all else is numbers."""
    scope: dict[str, Any] = {"__name__": module.name}
    try:
        exec(compile(printed.text, f"<{printed.entry}, as numpy>", "exec"), scope)
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise CompileError(f"Python cannot take the text of {module.name}: {error}", loc=module.entry.loc) from error
    entry: Callable[..., Any] = scope[printed.entry]
    return entry


@dataclass(slots=True, eq=False)
class NumpyExecutable:
    """A compiled module: see `base.Executable`."""

    prepared: PreparedModule
    layout: ApartLayout
    printed: PrintedModule
    tile: int
    entry: Callable[..., Any]
    notes: tuple[str, ...] = ()
    """The functions that this version of numpy gets wrong; it keeps denormals and has every precision."""
    rejection: NumpyExecutable | None = None
    views: WeakKeyDictionary[TableData, tuple[int, TableView]] = field(default_factory=WeakKeyDictionary)
    ports: tuple[tuple[bool, Any], ...] = field(init=False)
    """For each input: whether it is a vector, and its dtype."""
    of_place: tuple[tuple[tuple[str, str], Callable[[Place], Any]], ...] = field(init=False)
    """The arguments of the text that depend on the tile."""

    def __post_init__(self) -> None:
        """Derive the ports and the arguments."""
        types = (port.type for port in self.prepared.module.entry.inputs if isinstance(port, Value))
        self.ports = tuple((type.size > 1, np.dtype(DTYPES[type.base])) for type in types)
        self.of_place = tuple((key, _OF_PLACE[key]) for key in self.printed.arguments if key in _OF_PLACE)

    @property
    def source(self) -> str:
        """The Python text."""
        return self.printed.text

    @property
    def loops(self) -> tuple[Loc | None, ...]:
        """The lines of the limited loops."""
        return self.prepared.loops

    @property
    def writes_all(self) -> bool:
        """Return whether no element has a status."""
        return not self.prepared.status

    def run(self, call: Call) -> Array | None:
        """Run it; return the status of each element, or None when every element was written."""
        return self.run_until(call, _never)[1]

    @np.errstate(all="ignore")
    def run_until(self, call: Call, stop: Callable[[int], bool], first: int | None = None) -> tuple[bool, Array | None]:
        """Run it, unless `stop`, called with the elements done so far between two tiles, returns True.

        Tiles grow from `first` elements, so that `stop` has its say soon. Return whether all elements have run, and the
        statuses as `run` does.
        """
        status = np.empty(call.count, np.int32) if self.prepared.status else None
        uniforms = self._uniforms(call)
        live = None if status is None else self._live(call)
        if live is not None:
            return self._run_listed(call, live, uniforms, stop, first)
        for place in places_of(call.shape, self.tile, grid=self.layout.grid, first=first):
            if place.start and stop(place.start):
                return False, None
            self._run_tile(call, place, uniforms, status)
        return True, None if status is None or np.all(status == Status.WRITTEN) else status

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over arrays of the host: see `base.Executable`."""
        return over_arrays(self.run, call)

    def _live(self, call: Call) -> Array | None:
        """Return the indices of the elements that are not discarded at the start, if they are few; None: all run."""
        if self.rejection is None or not is_worth_a_list(call.count):
            return None
        rejected = np.empty(call.count, np.bool_)
        self.rejection.run(replace(call, outputs=(rejected,)))
        return few(~rejected)

    def _run_listed(
        self,
        call: Call,
        live: Array,
        uniforms: dict[tuple[str, str], Any],
        stop: Callable[[int], bool],
        first: int | None,
    ) -> tuple[bool, Array | None]:
        """Run some elements, in tiles whose lanes are these elements; return the same as `run_until`."""
        status = np.full(call.count, Status.DISCARDED, np.int32)
        for tile in places_of(live.shape, self.tile, grid=False, first=first):
            if tile.start and stop(tile.start * call.count // len(live)):
                return False, None
            elements = live[tile.part]
            run_some(call, elements, status, partial(self._run_list, ElementList.of(elements, call.shape), uniforms))
        return True, status

    def _run_list(self, place: Place, uniforms: dict[tuple[str, str], Any], call: Call) -> Array:
        ended = np.empty(call.count, np.int32)
        self._run_tile(call, place, uniforms, ended)
        return ended

    def _run_tile(self, call: Call, place: Place, uniforms: dict[tuple[str, str], Any], status: Array | None) -> None:
        part, extents = place.part, place.extents
        outputs = self._outputs(call, place)
        inputs = [_tile(x, *port, place, outputs) for x, port in zip(call.inputs, self.ports, strict=True)]
        if place.block:
            inputs = [tile.reshape(*tile.shape[:-1], *extents) for tile in inputs]
        for key, function in self.of_place:
            uniforms[key] = function(place)
        results = self.entry(*inputs, *map(uniforms.__getitem__, self.printed.arguments))
        results = results if isinstance(results, tuple) else (results,)
        written: Array | None = None
        if status is not None:
            *results, ended = results
            status[part].reshape(extents)[...] = ended
            written = status[part] == Status.WRITTEN
            if written.all():
                written = None
        for out, result in zip(outputs, results, strict=True):
            _write(out, result, written, extents)

    def _outputs(self, call: Call, place: Place) -> Sequence[Array]:
        """Return the arrays for the results: one for an output, or one for each component of it."""
        outputs = call.outputs if call.shape == place.extents else [out[place.part] for out in call.outputs]
        if not self.layout.apart:
            return outputs
        return [column for out in outputs for column in ([out] if out.ndim == 1 else out.T)]

    def _uniforms(self, call: Call) -> dict[tuple[str, str], Any]:
        """Params, tables and the grid's shape, by the argument that they are for."""
        module = self.prepared.module
        arguments: dict[tuple[str, str], Any] = {}
        for param in module.params:
            arguments["param", param.name] = _uniform(call.params[param.name], param.type)
        for table in module.tables:
            arguments["table", table.name] = self._view(call.tables[table.name], table.rank, table.type)
        if ("grid_shape", "") in self.printed.arguments:
            extents = np.array(call.shape, np.int32)
            arguments["grid_shape", ""] = extents[0] if len(extents) == 1 else extents[:, None]
        return arguments

    def _view(self, data: TableData, rank: int, type: Type) -> TableView:
        entry = self.views.get(data)
        if entry is not None and entry[0] == data.version:
            return entry[1]
        if entry is not None and entry[1].looks_into(data.array):
            view = entry[1]
            view.renew()
        else:
            view = TableView(np.asarray(data.array, DTYPES[type.base]), rank)
        self.views[data] = data.version, view
        return view


def _never(done: int) -> bool:
    """Return False: no run is to stop."""
    return False


def _uniform(value: Array, type: Type) -> Any:
    typed = np.asarray(value).astype(DTYPES[type.base])
    return typed.reshape(())[()] if type.size == 1 else typed.reshape(type.size, 1)


def _tile(array: Array, vector: bool, dtype: Any, place: Place, outputs: Sequence[Array]) -> Array:
    """Return the tile of an input: (lanes,) or (size, lanes).

    A result may be a view of a tile. Where a tile has several results, writing the first must not change the second.
    """
    part = place.part
    if len(array) != part.stop:
        array = array[part] if len(array) != 1 else np.broadcast_to(array, (part.stop - part.start, *array.shape[1:]))
    elif part.start:
        array = array[part]
    tile = np.ascontiguousarray(array.T, dtype) if vector else array if array.dtype == dtype else array.astype(dtype)
    return tile.copy() if len(outputs) > 1 and any(np.may_share_memory(tile, out) for out in outputs) else tile


def _write(out: Array, result: Any, written: Array | None, extents: tuple[int, ...]) -> None:
    """Put a result, (size, lanes), a block or uniform, where it belongs."""
    if out.ndim == 2:
        rows, where = np.asarray(result).T, None if written is None else written[:, None]
    else:
        out = out if out.shape == extents else out.reshape(extents)
        rows, where = result, None if written is None else written.reshape(extents)
    if where is None:
        out[...] = rows
    else:
        np.copyto(out, rows, where=where, casting="same_kind")


backend = NumpyBackend()
