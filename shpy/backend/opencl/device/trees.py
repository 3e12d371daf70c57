"""Folds and scans on an OpenCL device that is a processor: a dispatch of parts, each of which is a work item's.

Stage: compile and run. Few elements are one part, so a sum of them is one dispatch; see `prologue_trees` for the text.

    tree = tree_of(space, module, NodeTypes((F,), (F,), lifted=False), "f32")
    tree.fold([memory], [sums])
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from shpy.backend.base import Array, NodeTypes, Options
from shpy.backend.device.probe import refuse_wrong
from shpy.backend.opencl.device.memory import OpenCLMemory, OpenCLSpace
from shpy.backend.opencl.packets.prologue_trees import FOLD, JOIN, SCAN, tree_block
from shpy.backend.opencl.packets.trees import print_trees
from shpy.errors import warn
from shpy.ir.constants import dtypes_at
from shpy.ir.nodes import Loop, Module
from shpy.ir.traverse import walk
from shpy.ir.types import Base, vec
from shpy.passes.modes import Precision
from shpy.passes.pipeline import prepare
from shpy.passes.precision import rebased
from shpy.passes.private import private_memory
from shpy.passes.size import inlined_sizes

_ALONE: Final = 1 << 16
"""The most elements for a single work item: to start a second one would take longer than it saves."""
_PARTS: Final = 32
"""Parts for each core, enough for all cores to end at nearly the same time."""
_LARGE: Final = 400
"""Statements above which `folding` and `scanning` run a program instead, in dispatches of bounded length."""
_SMALL_ARRAYS: Final = 256
"""Bytes of local arrays above which the program runs, since its copies in the kernel of a tree each have their own."""
_BRIEF: Final = 1 << 26
"""Statements, those that read elements included, that run in a few milliseconds, too short to be interruptible."""
_READING: Final = 4
"""The cost, in statements, of reading an element and shuffling it beside its neighbour."""


@dataclass(frozen=True, slots=True)
class OpenCLTree:
    """A program of two elements in kernels of its own: see `base.Tree`."""

    space: OpenCLSpace
    text: str
    block: int
    cores: int
    brief: int
    """The most elements for which the wait need not be interruptible."""
    parts: tuple[OpenCLMemory, ...]
    """Memory for the leaves of the result of each part."""
    results: tuple[OpenCLMemory, ...]
    """Memory for the leaves of the final result; the lock is held until it is read."""
    done: OpenCLMemory
    """The number of finished parts of the current run; 0 between runs."""

    def each(self, count: int) -> int:
        """Return the number of elements of a part, for this number of elements in all."""
        if count <= _ALONE:
            return max(self.block, 1 << (count - 1).bit_length())
        return max(self.block, 1 << (count // (_PARTS * self.cores)).bit_length())

    def fold(self, elements: Sequence[Any], totals: Sequence[Any]) -> None:
        """Reduce each part to one element."""
        self._fold(elements, totals, None, totals)

    def reduce(self, elements: Sequence[Any]) -> list[Array]:
        """Reduce all elements and read the result. One dispatch does it: another costs a tenth of a sum of 10**7.

        Where a work group may not see what another has stored, there are two.
        """
        count = elements[0].count
        with self.space.machine.lock:
            if count <= self.each(count):
                self.fold(elements, self.results)
            elif self.space.machine.orders_stores:
                self._fold(elements, self.parts, self.done.buffer, self.results)
            else:
                self.fold(elements, self.parts)
                parts = np.uint32(-(-count // self.each(count)))
                self._run(JOIN, 1, int(parts), [*_buffers(self.parts), parts, *_buffers(self.results)])
            return [memory.read() for memory in self.results]

    def _fold(self, elements: Sequence[Any], parts: Sequence[Any], done: Any, totals: Sequence[Any]) -> None:
        count = elements[0].count
        each = self.each(count)
        sizes = [np.uint64(count), np.uint64(each)]
        args = [*_buffers(elements), *sizes, *_buffers(parts), done, *_buffers(totals)]
        self._run(FOLD, -(-count // each), count, args)

    def scan(
        self, elements: Sequence[Any], above: Sequence[Any] | None, prefixes: Sequence[Any], exclusive: bool
    ) -> None:
        """Compute all prefixes; `above` holds the prefixes that end with each part."""
        count = elements[0].count
        each, parts = self.each(count), 1 if above is None else above[0].count
        sizes = [np.uint64(count), np.uint64(each), np.int32(parts), np.int32(exclusive)]
        args = [*_buffers(elements), *sizes, *_buffers(elements if above is None else above), *_buffers(prefixes)]
        self._run(SCAN, parts, count, args)

    def _run(self, name: str, parts: int, count: int, args: list[Any]) -> None:
        self.space.enqueue(self.text, name, parts, args, brief=count <= self.brief)


def tree_of(space: OpenCLSpace, module: Module, types: NodeTypes, precision: Precision) -> OpenCLTree | None:
    """Print and build the kernels.

    Return None for a large program, for one that may discard or reads more, and if the driver refuses the kernels.
    """
    machine = space.machine
    lanes = machine.lanes
    if lanes == 1:
        return None
    options = Options(precision=precision)
    if precision == "f64":  # at f16 the buffers of the working float have 32 bits, as at f32
        element, part = (tuple(rebased(t, Base.F, Base.D) for t in side) for side in (types.element, types.part))
        types = replace(types, element=element, part=part)
    prepared = prepare(module, options, machine.target(lanes, options.math))
    statements = inlined_sizes(prepared.module)[prepared.module.entry.name]
    if prepared.status or statements > _LARGE or private_memory(prepared.module).size > _SMALL_ARRAYS:
        return None
    refuse_wrong(prepared.module, machine.wrong, machine.device.name.strip())
    joins = not machine.orders_stores
    kernel = print_trees(prepared.module, types, lanes, machine.abilities, joins=joins, faults=machine.wrong)
    if kernel is None or (kernel.doubles and not machine.doubles):
        return None
    try:
        with machine.lock:
            space.kernel(kernel.text, FOLD)
    except machine.cl.Error:  # the program itself, which runs otherwise, explains a refusal
        warn(f"{module.entry.loc}: {module.name} reduces slower on OpenCL: the driver refuses the kernel of its tree")
        return None
    dtypes = dtypes_at(precision)
    cores = machine.device.max_compute_units
    parts, results = (
        tuple(space.allocate(count, t, np.dtype(dtypes[t.base])) for t in types.part) for count in (_PARTS * cores, 1)
    )
    done = space.allocate(1, vec(Base.U), np.dtype(np.uint32))
    done.write(np.zeros(1, np.uint32))
    loops = any(isinstance(s, Loop) for f in prepared.module.functions for s in walk(f.body))
    brief = _ALONE if loops else max(_ALONE, _BRIEF // (statements + _READING))
    return OpenCLTree(space, kernel.text, tree_block(types), cores, brief, parts, results, done)


def _buffers(memories: Sequence[Any]) -> list[Any]:
    return [memory.buffer for memory in memories]
