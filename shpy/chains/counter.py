"""Counters: the number of a pass of `sh.repeat`, or of a round of `sh.loop`, as a stream of one element.

Stage: run. The device adds 1 between two passes, so that the kernels stay bound and the host does not wait. Three
memories take turns: a pass reads one while the next number is written to another, and the first one keeps the start.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Final

import numpy as np

from shpy.backend.base import DeviceCall
from shpy.chains.merging import COUNT
from shpy.lang.programs.record import record_body
from shpy.lang.recording.recorder import recording
from shpy.lang.values.structure import Leaf
from shpy.programs import Program
from shpy.streams.stream import Place, Stream

_NEXT: Final = (1, 2, 1)
"""The memory that is written from each: the first one is only read."""


class Counter:
    """A number that the device counts up from `first`; `stream` holds the present one."""

    def __init__(self, first: int, place: Place) -> None:
        self._streams = [Stream.fresh((), COUNT, place) for _ in range(3)]
        memory = self._streams[0].leaf_entries()[0].memory
        memory.write(np.full(1, first, memory.dtype))
        self._executable = _increment().compile_at(place)._executable
        self._starts: dict[int, tuple[DeviceCall, Callable[[], None]]] = {}
        self._now = 0

    @property
    def stream(self) -> Stream:
        """The stream of the present number."""
        return self._streams[self._now]

    def restart(self) -> None:
        """Return to the first number."""
        self._now = 0

    def advance(self) -> Callable[[], None]:
        """Move on to the next number; return the run that computes it, for the device's queue."""
        now, self._now = self._now, _NEXT[self._now]
        if now not in self._starts:
            old, new = (self._streams[k].leaf_entries()[0].memory for k in (now, self._now))
            call = DeviceCall((1,), (old,), (new,), None, {}, {})
            self._starts[now] = call, self._executable.ready(call)
        return self._starts[now][1]


@cache
def _increment() -> Program:
    with recording("increment", None) as record:
        return Program(record_body(record, {"number": Leaf(COUNT)}, None, lambda inputs: inputs["number"] + 1))
