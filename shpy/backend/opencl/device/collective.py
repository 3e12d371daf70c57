"""Collective operations on an OpenCL device: lists of marked elements, gathers, scatters, sorting, counting and trees.

Stage: run. Each work item takes a chunk of neighbouring elements, and there are a few chunks for each compute unit:
a CPU runs each chunk as a loop. Sorting is by digits of the keys, the lowest first, with stable passes. Folds and scans
on a processor are a dispatch of parts, each of which is a work item's: few elements are one part (see `prologue_trees`
for the text).

    operations = collectives(space)
    operations.sort(memory, False)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from importlib import resources
from itertools import chain
from typing import Any, Final

import numpy as np

from shpy.backend.base import Array, Collectives, FoldPlaces, NodeTypes, Options
from shpy.backend.device.probe import refuse_wrong
from shpy.backend.opencl.device.compiler_trials import thread_stack
from shpy.backend.opencl.device.driver import LOCAL_SIZE, Machine
from shpy.backend.opencl.device.memory import WORDS, OpenCLMemory, OpenCLSpace, buffer_dtype
from shpy.backend.opencl.packets.prologue_trees import FOLD, JOIN, SCAN, print_trees, tree_block
from shpy.backend.opencl.text.kernel import KernelText
from shpy.backend.opencl.text.prologue_places import PLACES, print_places
from shpy.errors import warn
from shpy.ir.constants import dtypes_at
from shpy.ir.nodes import Loop, Module, Status
from shpy.ir.traverse import walk
from shpy.ir.types import Base, vec
from shpy.passes.modes import Precision
from shpy.passes.pipeline import PreparedModule, prepare
from shpy.passes.precision import rebased
from shpy.passes.private import private_memory
from shpy.passes.size import inlined_sizes

_CPU_DIGIT: Final = 13
_DIGIT: Final = 8
"""The most bits of a digit, on a CPU whose threads have room, and elsewhere: a CPU's caches hold larger tables, so that
there are fewer passes.

All digits of a key have about as many, an argument of the kernels, since a table of half the size takes less time.
65,536 keys below 4,096 take one pass, and 0.76 of the CPU time of two with 11 bits.
"""
_BLOCK: Final = 64
"""The digits that a processor computes at once, in vectors: .78 of the time of 65,536 keys below 4,096."""
_TABLES: Final = 12
"""Bytes of private tables for each digit, three of ints: they lie on the stack of a CPU's thread."""
_LEAST: Final = 1 << 16
"""Elements of a chunk at least: tables of its own and two further dispatches for a digit cost as much as they save.

With 1 << 14, to sort 50,000 ints takes 2.6 times the CPU time (1.7 times the time on two cores), 65,536 2.0 times, and
131,072 1.1 times; to count 65,536 numbers takes 1.3 times.
"""
_MOST_COUNTERS: Final = 1 << 22
"""Counters of all chunks together."""
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
_LEAVES: Final = 16
"""The most leaves that a kernel gathers: drivers limit the arguments of a kernel."""
_READING: Final = 4
"""The cost, in statements, of reading an element and shuffling it beside its neighbour."""

# In these files WORD is the unsigned word of a component, KEY one of _KEYS.
_ORDER, _SELECT, _MOVE, _TALLY = (
    (resources.files(__package__) / f"{name}.cl").read_text() for name in ("order", "select", "move", "tally")
)
_MARK: Final = f"""\
__kernel void mark(__global const uchar *mask, uint n, __global int *status) {{
    size_t i = get_global_id(0);
    if (i < n)
        status[i] = mask[i] ? {Status.WRITTEN} : {Status.DISCARDED};
}}
"""
_TAKE: Final = """\
__kernel void take(__global const INDEX *indices, uint n, INDEX last, LEAVES) {
    size_t i = get_global_id(0);
    if (i < n) {
        size_t from = clamp(indices[i], (INDEX)0, last);
        MOVES
    }
}
"""
_KEYS: Final = {
    # NaN, the greatest; both zeros alike; then negative numbers with their bits inverted, so that the least is first.
    "f4": "(x & 0x7fffffffu) > 0x7f800000u ? 0xffffffffu : (x & 0x7fffffffu) == 0 ? 0x80000000u"
    " : x ^ ((uint)((int)x >> 31) | 0x80000000u)",
    "f8": "(x & 0x7ffffffffffffffful) > 0x7ff0000000000000ul ? 0xfffffffffffffffful"
    " : (x & 0x7ffffffffffffffful) == 0 ? 0x8000000000000000ul"
    " : x ^ ((ulong)((long)x >> 63) | 0x8000000000000000ul)",
    "i4": "x ^ 0x80000000u",
    "u4": "x",
    "u1": "x != 0",
}
"""An expression of the word x, by the kind and size of what it holds, whose unsigned order is that of the numbers."""


def collectives(space: OpenCLSpace) -> Collectives:
    """Return the collective operations that run on this device."""
    own = _OpenCLCollectives(space)
    tree = partial(tree_of, space) if space.machine.is_cpu else None
    fold_places = partial(places_of, space) if space.machine.is_cpu else None
    return Collectives(
        own.select, own.take, own.put, own.place, own.mark, own.sort, own.order, own.tally, tree, fold_places
    )


class _OpenCLCollectives:
    def __init__(self, space: OpenCLSpace) -> None:
        self._space = space
        machine = self._machine = space.machine
        has_room = (thread_stack() or 0) >= 8 * (_TABLES << _CPU_DIGIT)
        self._digit = _CPU_DIGIT if machine.is_cpu and has_room else _DIGIT
        self._block = _BLOCK if machine.is_cpu else 1

    def select(self, mask: Any) -> OpenCLMemory:
        """Return the indices of the elements whose mark is set, in order, as ints."""
        n = mask.count
        chunks, chunk = self._chunks(n)
        counts = self._allocate(chunks, Base.U)
        text = _SELECT.replace("BLOCK", "256")
        self._run(text, "count_marks", chunks, mask, n, chunk, counts)
        sizes = counts.read()
        counts.write(np.cumsum(sizes, dtype=np.uint32) - sizes)
        listed = self._allocate(int(sizes.sum()), Base.I)
        if listed.count:
            self._run(text, "list_marks", chunks, mask, n, chunk, counts, listed)
        return listed

    def take(self, sources: Sequence[Any], index: Any) -> list[OpenCLMemory]:
        """Gather elements; an index out of range is clamped.

        A kernel takes several leaves: 65,536 elements of two leaves take 0.88 of the CPU time of two kernels.
        """
        gathered = [self._space.allocate(index.count, source.type, source.dtype) for source in sources]
        for first in range(0, len(sources), _LEAVES):
            part = slice(first, first + _LEAVES)
            text = _taking(tuple((_word(s), s.type.size) for s in sources[part]), _index(index))
            n, last = index.count, index.dtype.type(sources[0].count - 1)
            leaves = chain.from_iterable(zip(sources[part], gathered[part], strict=True))
            self._run(text, "take", n, index, n, last, *leaves, group=LOCAL_SIZE)
        return gathered

    def put(self, values: Any, index: Any, target: Any) -> None:
        """Scatter elements; of several at one place the last one stays."""
        n, places, text = index.count, target.count, self._moving(values, index)
        winners = self._allocate(places, Base.I)
        self._run(text, "forget", places, winners, places, group=LOCAL_SIZE)
        self._run(text, "compete", n, index, n, places, winners, group=LOCAL_SIZE)
        self._run(text, "put", places, values, winners, places, target, group=LOCAL_SIZE)

    def place(self, values: Any, index: Any, target: Any) -> None:
        """Scatter elements to places that are all different."""
        self._run(
            self._moving(values, index), "place", index.count, values, index, index.count, target, group=LOCAL_SIZE
        )

    def mark(self, mask: Any, status: Any) -> None:
        """Set the status of each element to WRITTEN where it is marked."""
        self._run(_MARK, "mark", mask.count, mask, mask.count, status, group=LOCAL_SIZE)

    def sort(self, keys: Any, descending: bool) -> OpenCLMemory:
        """Sort scalars."""
        words: OpenCLMemory = self._sorted(keys, descending, None, indexed=False)
        return words

    def order(self, keys: Any, descending: bool, below: int | None) -> OpenCLMemory:
        """Return the indices that sort scalars."""
        indices: OpenCLMemory = self._sorted(keys, descending, below, indexed=True)
        return indices

    def tally(self, numbers: Any, bins: int) -> OpenCLMemory:
        """Count how often each number below `bins` occurs."""
        n = numbers.count
        chunks, chunk = self._chunks(n, max(1, _MOST_COUNTERS // bins))
        counts = self._allocate(chunks * bins, Base.I)
        self._run(_TALLY, "tally", chunks, numbers, n, chunk, bins, counts)
        if chunks == 1:
            return counts
        self._run(_TALLY, "add_tallies", bins, counts, bins, chunks, group=LOCAL_SIZE)
        return self._space.view(counts, counts.type, bins)

    def _sorted(self, keys: Any, descending: bool, below: int | None, *, indexed: bool) -> Any:
        """Sort scalars digit by digit; return them or, if `indexed`, the indices that they had.

        By the last digit the indices move alone. One chunk takes a dispatch for a digit, not three.
        """
        text, bits = self._ordering(keys, descending, below)
        last = 0 if below is None else below - 1  # an argument, so that each bound takes the same kernel
        chunks, chunk = self._chunks(keys.count)
        digit = -(-bits // -(-bits // self._digit))
        counts = self._allocate(chunks << digit, Base.U) if chunks > 1 else None
        source, indices = keys, None
        for shift in range(0, bits, digit):
            alone = indexed and shift + digit >= bits
            moved = None if alone else self._like(keys)
            moved_indices = self._allocate(keys.count, Base.I) if indexed else None
            sizes, to = (shift, 1 << digit, last), (moved, indices, moved_indices)
            if counts is None:
                self._run(text, "sort_digit", 1, source, keys.count, *sizes, *to)
            else:
                self._run(text, "count_digits", chunks, source, keys.count, chunk, *sizes, counts)
                self._run(text, "sum_before", 1, counts, 1 << digit, chunks)
                self._run(text, "move_digits", chunks, source, keys.count, chunk, *sizes, counts, *to)
            source, indices = moved, moved_indices
        return indices if indexed else source

    def _ordering(self, keys: Any, descending: bool, below: int | None) -> tuple[str, int]:
        """Return the kernel text that sorts keys of this type, and the bits of a key."""
        kept = buffer_dtype(keys.type, keys.dtype)
        word = WORDS[kept.itemsize]
        key = _KEYS[kept.str[1:]]
        if below is not None:
            key = "(uint)clamp((int)x, 0, (int)last)" if keys.type.base is Base.I else "min(x, last)"
        if descending:
            key = f"({word})~({key})"
        text = _filled(_ORDER, KEY=key, MOST=str(1 << self._digit), BLOCK=str(self._block), WORD=word)
        return text, 8 * kept.itemsize if below is None else max(1, (below - 1).bit_length())

    def _moving(self, moved: Any, index: Any) -> str:
        return _filled(_MOVE, WORD=_word(moved), SIZE=str(moved.type.size), INDEX=_index(index))

    def _chunks(self, n: int, most: int = 1 << 31) -> tuple[int, int]:
        """Return the number of chunks, and the elements of each chunk."""
        each = 4 if self._machine.is_cpu else 128
        chunks = max(1, min(self._machine.device.max_compute_units * each, n // _LEAST, most))
        return chunks, -(-n // chunks)

    def _allocate(self, count: int, base: Base) -> OpenCLMemory:
        return self._space.allocate(count, vec(base), np.dtype(np.int32 if base is Base.I else np.uint32))

    def _like(self, memory: Any) -> OpenCLMemory:
        return self._space.allocate(memory.count, memory.type, memory.dtype)

    def _run(self, text: str, name: str, items: int, *args: Any, group: int = 1) -> None:
        """Start a kernel over this number of work items, rounded up to whole groups by idle items."""
        arguments = [np.uint32(a) if isinstance(a, int) else getattr(a, "buffer", a) for a in args]
        self._space.enqueue(text, name, items, arguments, group=group)


def _word(memory: Any) -> str:
    """Return the unsigned type of a component."""
    return WORDS[buffer_dtype(memory.type, memory.dtype).itemsize]


def _index(index: Any) -> str:
    return "int" if index.dtype.kind == "i" else "uint"


@lru_cache(maxsize=64)
def _taking(leaves: tuple[tuple[str, int], ...], index: str) -> str:
    """Return the text that gathers leaves of these words and sizes."""
    places = [f"__global const {word} *given{k}, __global {word} *taken{k}" for k, (word, _) in enumerate(leaves)]
    moves = [
        f"vstore{size}(vload{size}(from, given{k}), i, taken{k});" if size > 1 else f"taken{k}[i] = given{k}[from];"
        for k, (_, size) in enumerate(leaves)
    ]
    return _filled(_TAKE, INDEX=index, LEAVES=", ".join(places), MOVES="\n        ".join(moves))


@lru_cache(maxsize=64)
def _filled(text: str, **words: str) -> str:
    """Return a text in which words are replaced, in this order. It is kept, since it is looked up for each dispatch."""
    for word, meant in words.items():
        text = text.replace(word, meant)
    return text


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
    program: Any
    """The driver's program of the text, which is there as long as somebody holds it."""

    def each(self, count: int) -> int:
        """Return the number of elements of a part, for this number of elements in all."""
        if count <= _ALONE:
            return max(self.block, 1 << (count - 1).bit_length())
        return max(self.block, 1 << (count // (_PARTS * self.cores)).bit_length())

    def fold(self, elements: Sequence[Any], totals: Sequence[Any]) -> None:
        """Reduce each part to one element."""
        self._run(*self._folding(elements, totals, None, totals))

    def reducing(self, elements: Sequence[Any]) -> Callable[[], list[Array]]:
        """Prepare the reduction of all elements. One dispatch does it: another costs a tenth of a sum of 10**7.

        Where a work group may not see what another has stored, there are two.
        """
        count = elements[0].count
        parts = -(-count // self.each(count))
        if parts == 1:
            runs = [self._folding(elements, self.results, None, self.results)]
        elif self.space.machine.orders_stores:
            runs = [self._folding(elements, self.parts, self.done.buffer, self.results)]
        else:
            args = [*_buffers(self.parts), np.uint32(parts), *_buffers(self.results)]
            runs = [self._folding(elements, self.parts, None, self.parts), (JOIN, 1, parts, args)]

        def reduce() -> list[Array]:
            with self.space.machine.lock:
                for run in runs:
                    self._run(*run)
                return [memory.read() for memory in self.results]

        return reduce

    def _folding(self, elements: Sequence[Any], parts: Sequence[Any], done: Any, totals: Sequence[Any]) -> Any:
        """Return the arguments of `_run` for the fold of each part."""
        count = elements[0].count
        each = self.each(count)
        sizes = [np.uint64(count), np.uint64(each)]
        args = [*_buffers(elements), *sizes, *_buffers(parts), done, *_buffers(totals)]
        return FOLD, -(-count // each), count, args

    def scan(
        self, elements: Sequence[Any], above: Sequence[Any] | None, prefixes: Sequence[Any], exclusive: bool
    ) -> None:
        """Compute all prefixes; `above` holds the prefixes that end with each part."""
        count = elements[0].count
        each, parts = self.each(count), 1 if above is None else above[0].count
        sizes = [np.uint64(count), np.uint64(each), np.int32(parts), np.int32(exclusive)]
        args = [*_buffers(elements), *sizes, *_buffers(elements if above is None else above), *_buffers(prefixes)]
        self._run(SCAN, parts, count, args)

    def scanning(self, elements: Sequence[Any], exclusive: bool) -> Callable[[], list[OpenCLMemory]]:
        """Prepare the prefixes of elements that are one part."""
        count = elements[0].count
        sizes = [np.uint64(count), np.uint64(self.each(count)), np.int32(1), np.int32(exclusive)]
        args, kinds = [*_buffers(elements), *sizes, *_buffers(elements)], [(m.type, m.dtype) for m in elements]

        def scan() -> list[OpenCLMemory]:
            prefixes = [self.space.allocate(count, *kind) for kind in kinds]
            self._run(SCAN, 1, count, args + _buffers(prefixes))
            return prefixes

        return scan

    def _run(self, name: str, parts: int, count: int, args: list[Any]) -> None:
        self.space.enqueue(self.text, name, parts, args, brief=count <= self.brief)


def tree_of(space: OpenCLSpace, module: Module, types: NodeTypes, precision: Precision) -> OpenCLTree | None:
    """Print and build the kernels that fold and scan with a program.

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
    if not _is_small(prepared, statements):
        return None
    refuse_wrong(prepared.module, machine.wrong, machine.device.name.strip())
    joins = not machine.orders_stores
    kernel = print_trees(prepared.module, types, lanes, machine.abilities, joins=joins, faults=machine.wrong)
    program = _build(machine, kernel, module, "reduces slower on OpenCL: the driver refuses the kernel of its tree")
    if kernel is None or program is None:
        return None
    dtypes = dtypes_at(precision)
    cores = machine.device.max_compute_units
    parts, results = (
        tuple(space.allocate(count, t, np.dtype(dtypes[t.base])) for t in types.part) for count in (_PARTS * cores, 1)
    )
    done = space.allocate(1, vec(Base.U), np.dtype(np.uint32))
    done.write(np.zeros(1, np.uint32))
    brief = _most_brief(prepared, statements)
    return OpenCLTree(space, kernel.text, tree_block(types), cores, brief, parts, results, done, program)


def places_of(space: OpenCLSpace, module: Module, precision: Precision) -> FoldPlaces | None:
    """Print and build the kernel that combines the values of each place with a program; None where `tree_of` is None.

    65,536 numbers for 4,096 places take 0.04 of the CPU time of a sort and a fold of each place.
    """
    machine = space.machine
    prepared = prepare(module, Options(precision=precision), machine.target(1, "strict"))
    statements = inlined_sizes(prepared.module)[prepared.module.entry.name]
    if not _is_small(prepared, statements):
        return None
    refuse_wrong(prepared.module, machine.wrong, machine.device.name.strip())
    kernel = print_places(prepared.module, faults=machine.wrong)
    program = _build(machine, kernel, module, "scatters slower on OpenCL: the driver refuses the kernel of its places")
    if kernel is None or program is None:
        return None
    brief = _most_brief(prepared, statements)

    def fold_places(values: Sequence[Any], index: Any, targets: Sequence[Any], program: Any = program) -> None:
        # `program` is held by this function, since the driver's program is there as long as somebody holds it.
        places = targets[0].count
        seen = space.allocate(places, vec(Base.B), np.dtype(np.bool_))
        args = [np.uint64(index.count), np.uint64(places), index.buffer, seen.buffer]
        args += [*_buffers(values), *_buffers(targets)]
        space.enqueue(kernel.text, PLACES, 1, args, brief=index.count + places <= brief)

    return fold_places


def _is_small(prepared: PreparedModule, statements: int) -> bool:
    """Return whether a program of two elements always gives an element, and is small enough for kernels around it."""
    return not prepared.status and statements <= _LARGE and private_memory(prepared.module).size <= _SMALL_ARRAYS


def _most_brief(prepared: PreparedModule, statements: int) -> int:
    """Return the most elements that a program combines in a few milliseconds."""
    loops = any(isinstance(s, Loop) for f in prepared.module.functions for s in walk(f.body))
    return _ALONE if loops else max(_ALONE, _BRIEF // (statements + _READING))


def _build(machine: Machine, kernel: KernelText | None, module: Module, slower: str) -> Any:
    """Return the driver's program; None without a kernel, and where the driver refuses it, with a warning."""
    if kernel is None or (kernel.doubles and not machine.doubles):
        return None
    try:
        with machine.lock:
            return machine.build(kernel.text)
    except machine.cl.Error:  # the general program runs instead, and its error explains a refusal
        warn(f"{module.entry.loc}: {module.name} {slower}")
        return None


def _buffers(memories: Sequence[Any]) -> list[Any]:
    return [memory.buffer for memory in memories]
