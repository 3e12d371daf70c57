"""Jobs that workers run for blocks. A job is sent as bytes, and each thread of a worker keeps its program.

Stage: cluster, on the workers. A thread has Params of its own, so that it can set a block's place without a lock;
compiled kernels are shared by all threads of a process.
"""

from __future__ import annotations

import pickle
import threading
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from shpy.chains.chain import Chain, repeat
from shpy.chains.member import Member
from shpy.lang.data.params import Param
from shpy.lang.data.tables import Table, TableType
from shpy.lang.programs.record import RecordedProgram
from shpy.lang.values.structure import Layout, build_arrays, flatten, layout_of, leaves
from shpy.lang.values.types import TYPES
from shpy.passes.placing import ORIGIN, PERIOD, WHOLE, place_blocks
from shpy.programs import Program
from shpy.run.kernel import Kernel

_ENDLESS = 1 << 30
"""The modulus of indices that do not wrap around: larger than any."""
_KEPT = 16
"""Jobs that a thread keeps."""


class Job(ABC):
    """The work that a worker does for each block."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_ready"}  # each thread makes its own

    @abstractmethod
    def run(
        self, origin: tuple[int, ...], kept: tuple[slice, ...], blocks: list[Any], joined: Mapping[str, list[Any]]
    ) -> list[Any]:
        """Run on one block, which begins at `origin` of the grid, with the parts of the cut inputs.

        `joined` has the whole arrays of each Table that is one of Dask. Returns the array of each leaf of the outputs,
        for the elements of the block that are `kept`.
        """


class _Thread(threading.local):
    def __init__(self) -> None:
        self.unpacked = lru_cache(_KEPT)(pickle.loads)


_thread = _Thread()


def run_job(*blocks: Any, packed: bytes, rank: int, joined: Mapping[str, list[Any]]) -> Any:
    """Run a job on a block; several arrays are one tuple. The last `rank` blocks say where the block lies."""
    job = _thread.unpacked(packed)
    places = [tuple(map(int, np.asarray(table).reshape(3))) for table in blocks[len(blocks) - rank :]]
    kept = tuple(slice(low, high) for _, low, high in places)
    arrays = job.run(tuple(start for start, _, _ in places), kept, list(blocks[: len(blocks) - rank]), joined)
    return arrays[0] if len(arrays) == 1 else tuple(arrays)


def piece(block: tuple[Any, ...], k: int) -> Any:
    """Return one of the arrays of a block."""
    return block[k]


class Grid:
    """The place of a block in the whole grid, as Params of the programs that ask for it."""

    def __init__(self, shape: tuple[int, ...], wraps: Sequence[bool] = ()) -> None:
        self.shape, self.wraps = shape, any(wraps)
        self.uniforms: dict[str, Any] = {}
        """Empty for a rank that no `sh.grid_index` has."""
        kind = TYPES.get(f"Attrib{len(shape)}i")
        if kind is not None:
            self.uniforms[ORIGIN] = Param(kind, _vector((0,) * len(shape)), ORIGIN)
            self.uniforms[WHOLE] = Param(kind, _vector(shape), WHOLE)
        if kind is not None and self.wraps:
            period = tuple(n if wrap else _ENDLESS for n, wrap in zip(shape, wraps, strict=True))
            self.uniforms[PERIOD] = Param(kind, _vector(period), PERIOD)

    def placed(self, recorded: RecordedProgram, cut: Collection[str], reach: Sequence[int] = ()) -> RecordedProgram:
        """Return the program with a block's place added to its indices, unchanged if it reads none (`place_blocks`)."""
        module, rank = recorded.module, len(self.shape)
        if self.uniforms:
            module = place_blocks(module, cut, rank, reach if self.wraps else None)
        if module is recorded.module:
            return recorded
        return replace(recorded, module=module, params={**recorded.params, **self.uniforms})

    def move(self, origin: tuple[int, ...]) -> None:
        """Set the place of the block that runs next."""
        if self.uniforms:
            self.uniforms[ORIGIN].value = _vector(origin)


def _vector(components: tuple[int, ...]) -> Any:
    """Return components as the value of a Param: a number if there is one, else a tuple."""
    return components if len(components) > 1 else components[0]


def again(kernel: Program | Kernel, recorded: RecordedProgram) -> Program | Kernel:
    """Return a program or kernel of another recording, with the options of this one."""
    if recorded is kernel.recorded:
        return kernel
    return Kernel.on(recorded, kernel.backend, kernel.options) if isinstance(kernel, Kernel) else Program(recorded)


class Blockwise(Job):
    """Runs a kernel on each block.

    `inputs` has for each input by name its layout and its leaves; a leaf of None is cut into blocks, the others are
    whole arrays. `joined` has the types of the Tables whose arrays come with each block.
    """

    def __init__(
        self,
        kernel: Program | Kernel,
        shape: tuple[int, ...],
        inputs: Mapping[str, tuple[Layout, list[Any]]],
        tables: Mapping[str, Any],
        joined: Mapping[str, TableType],
    ) -> None:
        self.kernel, self.shape, self.inputs, self.tables, self.joined = kernel, shape, inputs, tables, joined

    @cached_property
    def _ready(self) -> tuple[Grid, Kernel, dict[str, tuple[list[Any], Table]]]:
        grid = Grid(self.shape)
        copy = again(self.kernel, grid.placed(self.kernel.recorded, ()))
        return grid, copy if isinstance(copy, Kernel) else copy.compile(), {}

    def _joined_table(self, name: str, arrays: list[Any]) -> Table:
        """Return the Table of arrays that a worker holds; it is made, and copied to a device, once."""
        kept = self._ready[2].get(name)
        if kept is None or any(old is not new for old, new in zip(kept[0], arrays, strict=True)):
            cls = self.joined[name].cls
            data = build_arrays(layout_of(cls, "an element"), iter(arrays))
            kept = self._ready[2][name] = arrays, Table(data, cls, name)
        return kept[1]

    def run(
        self, origin: tuple[int, ...], kept: tuple[slice, ...], blocks: list[Any], joined: Mapping[str, list[Any]]
    ) -> list[Any]:
        """Run the kernel."""
        grid, kernel, _ = self._ready
        grid.move(origin)
        cut = iter(blocks)
        arguments = {**self.tables, **{name: self._joined_table(name, arrays) for name, arrays in joined.items()}}
        for name, (layout, entries) in self.inputs.items():
            arguments[name] = build_arrays(layout, (next(cut) if entry is None else entry for entry in entries))
        shape = tuple(part.stop for part in kept)
        result = kernel(*(arguments[name] for name in kernel.recorded.inputs), shape=shape)
        return [np.asarray(leaf) for leaf in flatten(kernel.recorded.output, result, "output")]


class Stencil(Job):
    """A chain, several times, over blocks with a halo; `cut` has the layout of each stream that is cut, by name.

    `wraps` says along which axes reads wrap around, `distances` how far each kernel of the chain reads.
    """

    def __init__(
        self, chain: Chain, steps: int, shape: tuple[int, ...], cut: Mapping[str, Layout], whole: Mapping[str, Any],
        outputs: Mapping[str, Layout], wraps: Sequence[bool], distances: Sequence[Sequence[int]],
    ) -> None:  # fmt: skip
        self.chain, self.steps, self.shape = chain, steps, shape
        self.cut, self.whole, self.outputs, self.wraps, self.distances = cut, whole, outputs, wraps, distances

    @cached_property
    def _ready(self) -> tuple[Grid, Chain]:
        grid = Grid(self.shape, self.wraps)
        local = {*self.cut, *self.outputs}
        return grid, repeat(_placed(self.chain, grid, local, iter(self.distances)), self.steps)

    def run(
        self, origin: tuple[int, ...], kept: tuple[slice, ...], blocks: list[Any], joined: Mapping[str, list[Any]]
    ) -> list[Any]:
        """Run the chain over the block and its halo; the part that is kept has the values of the whole grid."""
        grid, chain = self._ready
        grid.move(origin)
        cut = iter(blocks)
        streams = {
            name: build_arrays(layout, (next(cut) for _ in leaves(layout, name))) for name, layout in self.cut.items()
        }
        shape = blocks[0].shape[: len(self.shape)]
        results = chain.run(shape=shape, **streams, **self.whole).streams
        arrays = []
        for name, layout in self.outputs.items():
            parts = flatten(layout, results[name].numpy(), name)
            arrays += [np.ascontiguousarray(np.asarray(part)[kept]) for part in parts]
        return arrays


def _placed(node: Chain | Member, grid: Grid, local: set[str], distances: Iterator[Sequence[int]]) -> Any:
    """Return a chain for blocks; `distances` are those of its kernels in order."""
    if isinstance(node, Chain):
        return node.with_members(tuple(_placed(member, grid, local, distances) for member in node.members))
    tables = cut_tables(node.recorded, local)
    return replace(node, kernel=again(node.kernel, grid.placed(node.recorded, tables, next(distances))))


def cut_tables(recorded: RecordedProgram, local: Collection[str]) -> frozenset[str]:
    """Return the names in the module of the tables that are cut: an input of structs is a table for each leaf."""
    names: set[str] = set()
    for name, type_ in recorded.inputs.items():
        if name in local and isinstance(type_, TableType):
            names |= {path for path, _, _ in leaves(layout_of(type_.cls, name), name)}
    return frozenset(names)
