"""Runs over streams of which few elements are alive: a list of those, gathered, run and put back.

Stage: run. A packet runs if one of its elements does, so where one element in ten is alive, most packets run for it
alone. The kernel without the condition runs over the elements of the list instead, in full packets. That pays where an
element takes longer to compute than to move, which the first such run of a kernel measures.

    lists = Lists(space, guarded, plain)
    start = lists.ready(call)                 # the last input says which elements are alive
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from shpy.backends.base import DeviceCall, Executable
from shpy.backends.opencl.device.memory import WORDS, OpenCLSpace, held
from shpy.ir.nodes import Status
from shpy.ir.types import Base, vec

__all__ = ["Lists"]

_WARP: Final = 32
"""Elements that run together where a kernel has no packets: on a GPU, or as a CPU's compiler joins them."""
_SIMILAR: Final = 2
"""A list of at most so many times the elements of one whose time is known takes as long for each."""
_PLACE: Final = """\
// Puts each value to its place; no place occurs twice.
__kernel void place(__global const WORD *values, __global const int *indices, __global WORD *target, ulong n) {
    size_t i = get_global_id(0);
    if (i < n)
        for (int k = 0; k < SIZE; ++k)
            target[(size_t)indices[i] * SIZE + k] = values[i * SIZE + k];
}
"""
_MARK: Final = """\
__kernel void mark_all(__global int *status, int value, ulong n) {
    if (get_global_id(0) < n)
        status[get_global_id(0)] = value;
}

__kernel void mark(__global const int *indices, __global int *status, int value, ulong n) {
    if (get_global_id(0) < n)
        status[indices[get_global_id(0)]] = value;
}
"""


class Lists:
    """The runs over lists of one kernel: `plain` is `guarded` without its last input, the condition."""

    def __init__(self, space: OpenCLSpace, guarded: Executable, plain: Executable) -> None:
        self._space = space
        self._guarded = guarded
        self._plain = plain
        self._known = 0
        """Elements of the list whose times are known: of the second one, since the first one builds kernels."""
        self._first = True
        self._running = self._moving = 0.0
        """Seconds to run and to move one element of it."""

    def ready(self, call: DeviceCall) -> Callable[[], None]:
        """Prepare one run; to know how many elements are alive, it waits for the mask."""

        def start() -> None:
            select = self._space.collectives.select
            assert select is not None
            live = select(call.inputs[-1])
            if self._pays(live.count, math.prod(call.shape)):
                self._run(call, live)
            else:
                self._space.start([self._guarded.ready(call, once=True)])

        return start

    def _pays(self, live: int, count: int) -> bool:
        """Return whether a list takes less time than the packets that have an element of it, wherever these lie."""
        if live in (0, count):
            return live == 0
        if live > _SIMILAR * self._known:
            return True
        lanes = getattr(self._plain, "lanes", 1)
        together = 1 - (1 - live / count) ** (lanes if lanes > 1 else _WARP)
        return live * (self._running + self._moving) < count * together * self._running

    def _run(self, call: DeviceCall, live: Any) -> None:
        space, status = self._space, call.status
        take = space.collectives.take
        assert take is not None
        _enqueue(space, _MARK, "mark_all", status, np.int32(Status.DISCARDED))
        if not live.count:
            return
        begin = self._now(live)
        gathered = tuple(m if m.count == 1 else take(m, live) for m in call.inputs[:-1])
        found = tuple(space.allocate(live.count, m.type, m.dtype) for m in call.outputs)
        ended: Any = None if self._plain.writes_all else space.allocate(live.count, vec(Base.I), np.dtype(np.int32))
        part = replace(call, shape=(live.count,), inputs=gathered, outputs=found, status=ended)
        run = self._now(live)
        space.start([self._plain.ready(part, once=True)])
        back = self._now(live)
        if ended is None:
            _enqueue(space, _MARK, "mark", live, status, np.int32(Status.WRITTEN))
        else:
            _place(space, ended, live, status)
        for values, target in zip(found, call.outputs, strict=True):
            _place(space, values, live, target)
        end = self._now(live)
        if self._first:
            self._first = False
        elif live.count > _SIMILAR * self._known:
            self._known = live.count
            self._running = (back - run) / live.count
            self._moving = (run - begin + end - back) / live.count

    def _now(self, live: Any) -> float:
        """Return the time when what was started has ended; 0 where it need not be known."""
        if live.count <= _SIMILAR * self._known:
            return 0.0
        self._space.finish()
        return time.perf_counter()


def _place(space: OpenCLSpace, values: Any, indices: Any, target: Any) -> None:
    text = _PLACE.replace("WORD", WORDS[held(values.type, values.dtype).itemsize])
    text = text.replace("SIZE", str(values.type.size))
    _enqueue(space, text, "place", values, indices, target)


def _enqueue(space: OpenCLSpace, text: str, name: str, *args: Any) -> None:
    """Start a kernel with a work item for each element of its first argument."""
    space.each(text, name, args[0].count, [getattr(a, "buffer", a) for a in args])
