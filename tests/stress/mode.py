"""The stress mode: every run is disturbed as first runs on slow, shared machines are, and its memory holds garbage.

A run that is warm, whole and alone takes one way through the runtimes. Under `stressed(seed)` a random choice, which
the seed repeats, takes the others, on every backend:

- runs are split into two, three and many dispatches, or not split, whatever their pace says;
- OpenCL kernels of any size are built without optimization first, and again, optimized, between any two dispatches;
- memory that a pool hands out is filled with a signalling NaN, and memory that it takes back is overwritten at once;
- a call is made twice, and the second one, which repeats the steps of the first, gives the result;
- whatever the runtimes choose by size or by measurement is chosen by chance: tiles, bands, lists of live elements,
  copies in place of lent memory, the number of runs under way;
- "auto" kernels change between numpy and OpenCL, also in the middle of a call;
- a device begins a run over streams only after the host has gone on, and meanwhile the tables that a chain reads hold
  other data.

    with stressed(seed=7):
        assert_same(kernel(x), expected)

The mode patches the few places where these decisions are made, and fails where one of them has moved. It says nothing
of speed. `SHPY_STRESS=7 pytest tests/...` runs any tests under it.
"""

from __future__ import annotations

import itertools
import random
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np

from shpy.backend.device import listed, pace, pool
from shpy.backend.glsl.device import memory as glsl_memory, run as glsl_runtime, textures as glsl_textures
from shpy.backend.numpy.device import run as numpy_runtime
from shpy.backend.opencl.device import (
    building,
    collective as opencl_collective,
    driver as opencl_device,
    memory as opencl_memory,
    run as opencl_runtime,
)
from shpy.backend.opencl.device.driver import _driver_devices, machine_of
from shpy.chains.chain import Chain
from shpy.lang.data.sources import HostArrays
from shpy.run import tiers
from shpy.run.kernel import Kernel
from shpy.run.tiers import TieredExecutable
from shpy.streams.methods import StreamReductions

TAKEN = np.uint32(0x7FA0DEAD)
"""A signalling NaN: what memory holds that a pool hands out."""
GIVEN_BACK = np.uint32(0x7FA0FEED)
"""Another one: what memory holds that a pool has taken back."""
_LATE = 0.01
"""Seconds by which a run begins late."""
MANY = 9
"""Dispatches of a run that is split into many."""
_EMPTY, _EMPTY_LIKE = np.empty, np.empty_like


def poison(array: np.ndarray[Any, Any], pattern: np.uint32 = TAKEN) -> np.ndarray[Any, Any]:
    """Fill an array of numbers with a pattern; arrays of objects stay."""
    if array.dtype.kind in "fiu" and array.flags.c_contiguous:
        flat = array.reshape(-1).view(np.uint8)
        whole = flat.size // 4 * 4
        flat[:whole].view(np.uint32)[...] = pattern
        flat[whole:] = 0xAD
    return array


def fill(thing: Any, pattern: np.uint32) -> Any:
    """Fill a buffer, a texture or all textures of a framebuffer with a pattern."""
    if hasattr(thing, "int_ptr"):
        machine = next(m for m in map(machine_of, range(len(_driver_devices()))) if m.context == thing.context)
        machine.cl.enqueue_fill_buffer(machine.queue, thing, pattern, 0, thing.size)
        return thing
    for texture in getattr(thing, "textures", (thing,)):
        width, height = texture.size
        count = width * height * texture.components * int(texture.dtype[1])
        texture.write(np.full(-(-count // 4), pattern).tobytes()[:count])
    return thing


class Stress:
    """The random choices of one stressed block."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)

    def chance(self, share: float = 0.5) -> bool:
        """Return True in this share of the calls."""
        return self.random.random() < share

    def parts(self, rows: int) -> list[tuple[int, int]]:
        """Return the first row and the number of rows of each dispatch: of one, two, three or many."""
        wanted = self.random.choice((1, 2, 2, 3, 3, MANY))
        cuts = sorted(self.random.sample(range(1, rows), min(wanted, rows) - 1)) if rows > 1 else []
        edges = [0, *cuts, rows]
        return [(a, b - a) for a, b in itertools.pairwise(edges) if b > a]

    # Splitting: `Pace` decides for OpenCL and GLSL, tiles and bands are the dispatches of numpy and of large draws.

    def split(self, stack: ExitStack) -> None:
        """Patch the limits that decide the size of a dispatch."""
        by_chance = lambda *_: self.chance()  # noqa: E731
        for name in ("fits", "is_brief", "was_brief"):
            stack.enter_context(patch.object(pace.Pace, name, by_chance))
        stack.enter_context(patch.object(pace.Pace, "parts", lambda _, rows, width=1, least=1: self.parts(rows)))
        places_of = numpy_runtime.places_of

        def small_places(shape: Any, tile: int, **options: Any) -> Any:
            count = max(1, int(np.prod(shape)))
            return places_of(shape, min(tile, -(-count // self.random.choice((1, 2, 3, MANY)))), **options)

        stack.enter_context(patch.object(numpy_runtime, "places_of", small_places))
        stack.enter_context(patch.object(listed, "_WORTH_A_LIST", self.random.choice((1, 64, 4096))))
        stack.enter_context(patch.object(glsl_runtime, "BAND", self.random.choice((1, 100, 1 << 11, 1 << 22))))
        stack.enter_context(patch.object(glsl_memory, "_AHEAD", self.random.choice((1, 2, 64))))
        stack.enter_context(patch.object(opencl_memory, "_AHEAD", self.random.choice((1, 2, 256))))
        stack.enter_context(
            patch.object(listed.ListedKernel, "_pays", lambda _, live, count: not live or self.chance())
        )
        stack.enter_context(patch.object(opencl_collective, "_LEAST", self.random.choice((1, 1 << 10, 1 << 16))))
        is_small = opencl_runtime.is_small
        staged = lambda call: is_small(call) and self.chance(0.8)  # noqa: E731
        stack.enter_context(patch.object(opencl_runtime, "is_small", staged))
        lend = opencl_device.Machine.lend

        def lend_sometimes(machine: Any, *args: Any, **named: Any) -> Any:
            return lend(machine, *args, **named) if self.chance() else None

        stack.enter_context(patch.object(opencl_device.Machine, "worth_lending", self.random.choice((1, 1 << 16))))
        stack.enter_context(patch.object(opencl_device.Machine, "lend", lend_sometimes))
        run = TieredExecutable.run

        def take_over_sometimes(executable: Any, call: Any) -> Any:
            executable._worth = self.random.choice((0.0, 1e9))
            if self.chance():
                executable._better = executable._refusal = None
            return run(executable, call)

        stack.enter_context(patch.object(building, "LARGE", self.random.choice((1, *[building.LARGE] * 3))))
        stack.enter_context(
            patch.object(pace.Watch, "pays", property(lambda watch: watch.watches and self.chance(0.2)))
        )
        stack.enter_context(patch.object(tiers, "_LOOK", 0.0))
        stack.enter_context(patch.object(tiers, "_COLD", (0.0, 0.0)))
        stack.enter_context(patch.object(tiers, "_START", 0.0))
        stack.enter_context(patch.object(tiers, "_COMPILER", 0.0))
        stack.enter_context(patch.object(TieredExecutable, "run", take_over_sometimes))

    # Lateness: what the host does after it has started a run comes before the run.

    def begin_late(self, stack: ExitStack) -> None:
        """Patch the start of runs over streams on OpenCL, and change the tables of chains while their runs wait."""
        start, run = opencl_memory.OpenCLSpace.start, Chain.run

        def start_late(space: Any, runs: Any) -> None:
            if self.chance():
                cl, machine = space.machine.cl, space.machine
                gate = cl.UserEvent(machine.context)
                # First of all: an interrupt behind the barrier would leave its gate closed.
                threading.Timer(_LATE, gate.set_status, [cl.command_execution_status.COMPLETE]).start()
                with machine.lock:
                    cl.enqueue_barrier(machine.queue, wait_for=[gate])
            start(space, runs)

        def run_and_change(chain: Any, **streams: Any) -> Any:
            result = run(chain, **streams)
            tables = {
                t
                for kernel in chain.kernels
                for t in kernel.recorded.tables.values()
                if isinstance(t.source, HostArrays)
            }
            for table in tables:
                data = table.host_array().copy()
                table.update(np.zeros_like(data), start=0)
                time.sleep(2 * _LATE)
                table.update(data, start=0)
            return result

        stack.enter_context(patch.object(opencl_memory.OpenCLSpace, "start", start_late))
        stack.enter_context(patch.object(Chain, "run", run_and_change))

    # Repetition: a second call of a signature takes a shorter way than the first.

    def call_again(self, stack: ExitStack) -> None:
        """Patch the calls of kernels over arrays that get their outputs from shpy, and reductions of streams."""
        run = Kernel._run

        def run_again(kernel: Kernel, inputs: Any, out: Any, shape: Any, named: Any) -> Any:
            if shape is None and named.keys() == kernel.recorded.inputs.keys():  # only calls by position are repeated
                inputs, named = tuple(named[name] for name in kernel.recorded.inputs), {}
            ran = run(kernel, inputs, out, shape, named)
            return run(kernel, inputs, out, shape, named) if out is None and ran[3] is None else ran

        reduced = StreamReductions._reduced

        def reduce_again(stream: Any, *args: Any) -> Any:
            reduced(stream, *args)
            return reduced(stream, *args)

        stack.enter_context(patch.object(Kernel, "_run", run_again))
        stack.enter_context(patch.object(StreamReductions, "_reduced", reduce_again))

    # Memory: every pool hands out garbage, and overwrites what it gets back.

    def poison_pools(self, stack: ExitStack) -> None:
        """Patch the pool of buffers and textures. Each device's runs one thread at a time."""
        take, give_back, make_texture = pool.Pool.take, pool.Pool.give_back, glsl_textures.Store._texture

        def given_back(one: Any, kind: Any, thing: Any) -> None:
            give_back(one, kind, fill(thing, GIVEN_BACK))

        stack.enter_context(patch.object(pool.Pool, "take", lambda *args: fill(take(*args), TAKEN)))
        stack.enter_context(patch.object(pool.Pool, "give_back", given_back))
        stack.enter_context(
            patch.object(glsl_textures.Store, "_texture", lambda *args: fill(make_texture(*args), TAKEN))
        )

    def poison_stages(self, stack: ExitStack) -> None:
        """Patch the arrays that small runs on OpenCL pass through."""
        run = opencl_runtime.OpenCLExecutable._run_staged

        def poisoned(executable: Any, call: Any) -> Any:
            for stage in executable.stages._kept.values():
                for array in stage.outputs:
                    poison(array)
            return run(executable, call)

        stack.enter_context(patch.object(opencl_runtime.OpenCLExecutable, "_run_staged", poisoned))

    def poison_numpy(self, stack: ExitStack) -> None:
        """Patch numpy's own functions for memory that holds anything."""
        stack.enter_context(patch.object(np, "empty", lambda *a, **k: poison(_EMPTY(*a, **k))))
        stack.enter_context(patch.object(np, "empty_like", lambda *a, **k: poison(_EMPTY_LIKE(*a, **k))))


@contextmanager
def stressed(seed: int) -> Iterator[Stress]:
    """Disturb every run of the block, on all backends, by choices that the seed repeats."""
    stress = Stress(seed)
    with ExitStack() as stack:
        stress.split(stack)
        stress.begin_late(stack)
        stress.call_again(stack)
        stress.poison_pools(stack)
        stress.poison_stages(stack)
        stress.poison_numpy(stack)
        yield stress
