"""Runs of a few elements: gather them, run a kernel without the condition, and scatter the results to their places.

Stage: run. Arrays of the host become lists where few elements run. A stream becomes one where that takes less time: a
packet runs if one of its elements does, so where one element in ten is alive, most packets run for it alone. That pays
where an element takes longer to compute than to move, which the first such runs of a kernel measure.

CPU time of lists in times of packets, PoCL 3.1 with AVX-512, a million elements of which 2, 10, 30 and 68 % are alive:
.11, .19, .40 and .75 for a program of 64 sines; 1.00, 1.05, 1.10 and 1.14 for one product, where packets run.

    live = few(mask)                            # their indices, or None where all elements are to run
    run_some(call, live, status, plain.run)
    Listed(guarded, plain, space).run(call)     # the last input says which elements run
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from shpy.backend.base import Array, Call, DeviceCall, Executable, Space
from shpy.ir.nodes import Loc, Status
from shpy.ir.types import Base, vec

_FEW: Final = 0.7
"""The share of elements below which to gather and to scatter them takes less time than to run over all."""
_WORTH_A_LIST: Final = 4096
"""The least number of elements for which a list is made; in a smaller run all elements run."""
_WARP: Final = 32
"""Elements that run together where a kernel has no packets: on a GPU, or as a CPU's compiler joins them."""
_SIMILAR: Final = 2
"""A list takes the same time for each element as a measured list, up to this many times its length."""


def is_worth_a_list(count: int) -> bool:
    """Return whether a run over `count` elements takes long enough to look for those that need not run."""
    return count >= _WORTH_A_LIST


def few(mask: Array) -> Array | None:
    """Return the indices of the elements that are True, if they are few; None where it is better to run over all."""
    live = np.flatnonzero(mask)
    return live if len(live) < _FEW * len(mask) else None


def run_some(call: Call, elements: Array, status: Array, run: Callable[[Call], Array | None]) -> None:
    """Run over the elements of these indices alone, as a call of its own; fill in their statuses and outputs."""
    inputs = tuple(x if len(x) == 1 else x[elements] for x in call.inputs)
    outputs = tuple(np.empty((len(elements), *out.shape[1:]), out.dtype) for out in call.outputs)
    ended = run(replace(call, shape=(len(elements),), inputs=inputs, outputs=outputs))
    status[elements] = Status.WRITTEN if ended is None else ended
    written = slice(None) if ended is None else ended == Status.WRITTEN
    for out, values in zip(call.outputs, outputs, strict=True):
        out[elements[written]] = values[written]


@dataclass(slots=True)
class ListedKernel:
    """A kernel whose last input is the condition under which an element runs: see `base.Executable`.

    `guarded` discards the other elements. `plain` is the same kernel without the condition; it cannot use grid_index.
    """

    guarded: Executable
    plain: Executable
    space: Space
    _measured_count: int = 0
    """Elements of the list whose times are known: of the second one, since the first one builds kernels."""
    _first: bool = True
    _running: float = 0.0
    _moving: float = 0.0
    """Seconds to run and to move one element of it."""

    @property
    def source(self) -> str:
        """The emitted text of the kernel that evaluates the condition for each element."""
        return self.guarded.source

    @property
    def notes(self) -> tuple[str, ...]:
        """Facts about the target."""
        return self.guarded.notes

    @property
    def loops(self) -> tuple[Loc | None, ...]:
        """The lines of the limited loops, which both kernels have."""
        return self.guarded.loops

    @property
    def writes_all(self) -> bool:
        """False: an element whose condition does not hold writes nothing."""
        return False

    def run(self, call: Call) -> Array | None:
        """Run it over the elements whose condition holds, if these are few, or else over all."""
        mask = call.inputs[-1]
        live = few(mask) if is_worth_a_list(call.count) and len(mask) == call.count else None
        if live is None:
            return self.guarded.run(call)
        status = np.full(call.count, Status.DISCARDED, np.int32)
        if len(live):
            run_some(replace(call, inputs=call.inputs[:-1]), live, status, self.plain.run)
        return status

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over memory of the device: as a list where that is worth it, and the run is not repeated."""
        count = math.prod(call.shape)
        if self.space.collectives.place and once and is_worth_a_list(count) and call.inputs[-1].count == count:
            return lambda: self._start(call)
        return self.guarded.ready(call, once=once)

    def _start(self, call: DeviceCall) -> None:
        """Start a run; to know how many elements are alive, it waits for the mask."""
        select = self.space.collectives.select
        assert select is not None
        live = select(call.inputs[-1])
        if self._pays(live.count, math.prod(call.shape)):
            self._run(call, live)
        else:
            self.space.start([self.guarded.ready(call, once=True)])

    def _pays(self, live: int, count: int) -> bool:
        """Return whether it is faster to run the `live` of `count` elements as a list than to run whole packets.

        The estimate assumes that live elements lie at random places: a packet runs if any of its lanes is live.
        """
        if live in (0, count):
            return live == 0
        if live > _SIMILAR * self._measured_count:
            return True
        lanes = getattr(self.plain, "lanes", 1)
        together = 1 - (1 - live / count) ** (lanes if lanes > 1 else _WARP)
        return live * (self._running + self._moving) < count * together * self._running

    def _run(self, call: DeviceCall, live: Any) -> None:
        space, own = self.space, self.space.collectives
        assert own.take is not None
        assert own.mark is not None
        assert own.place is not None
        own.mark(call.inputs[-1], call.status)
        if not live.count:
            return
        begin = self._now(live)
        moved = iter(own.take([m for m in call.inputs[:-1] if m.count != 1], live))
        gathered = tuple(m if m.count == 1 else next(moved) for m in call.inputs[:-1])
        outputs = tuple(space.allocate(live.count, m.type, m.dtype) for m in call.outputs)
        ended: Any = None if self.plain.writes_all else space.allocate(live.count, vec(Base.I), np.dtype(np.int32))
        part = replace(call, shape=(live.count,), inputs=gathered, outputs=outputs, status=ended)
        run = self._now(live)
        space.start([self.plain.ready(part, once=True)])
        back = self._now(live)
        if ended is not None:
            own.place(ended, live, call.status)
        for values, target in zip(outputs, call.outputs, strict=True):
            own.place(values, live, target)
        end = self._now(live)
        if self._first:
            self._first = False
        elif live.count > _SIMILAR * self._measured_count:
            self._measured_count = live.count
            self._running = (back - run) / live.count
            self._moving = (run - begin + end - back) / live.count

    def _now(self, live: Any) -> float:
        """Wait for the runs that were started and return the time; 0 at once where no time is needed."""
        if live.count <= _SIMILAR * self._measured_count:
            return 0.0
        self.space.finish()
        return time.perf_counter()
