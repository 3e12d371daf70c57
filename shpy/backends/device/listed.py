"""Runs of a few elements: arrays of those alone, for a kernel that knows no condition.

Stage: run. Above every backend, since it moves only arrays of the host.

    Listed(guarded, plain, space).run(call)     # the last input says which elements run
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from shpy.backends.base import Array, Call, DeviceCall, Executable, Space
from shpy.ir.nodes import Loc, Status

__all__ = ["Listed"]

_FEW: Final = 0.7
"""The share of elements below which to gather and to scatter them takes less time than to run over all."""
_WORTH_A_LIST: Final = 4096
"""Elements of a run with fewer of which all of them run."""


@dataclass(slots=True)
class Listed:
    """A kernel whose last input is the condition under which an element runs: see `base.Executable`.

    `guarded` discards the others; `plain` is the same kernel without the condition, and does not know its place.
    """

    guarded: Executable
    plain: Executable
    space: Space
    lists: Any = field(init=False)
    """The function that prepares runs over memory of the device as lists; None where the space has no such function."""

    def __post_init__(self) -> None:
        self.lists = self.space.lists(self.guarded, self.plain)

    @property
    def source(self) -> str:
        """The text with the condition."""
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
        """No: an element whose condition does not hold writes nothing."""
        return False

    def run(self, call: Call) -> Array | None:
        """Run it over the elements whose condition holds, if these are few, or else over all."""
        mask = call.inputs[-1]
        if call.count < _WORTH_A_LIST or len(mask) != call.count:
            return self.guarded.run(call)
        live = np.flatnonzero(mask)
        if len(live) >= _FEW * call.count:
            return self.guarded.run(call)
        status = np.full(call.count, Status.DISCARDED, np.int32)
        if not len(live):
            return status
        inputs = tuple(x if len(x) == 1 else x[live] for x in call.inputs[:-1])
        outputs = tuple(np.empty((len(live), *out.shape[1:]), out.dtype) for out in call.outputs)
        ended = self.plain.run(replace(call, shape=(len(live),), inputs=inputs, outputs=outputs))
        status[live] = Status.WRITTEN if ended is None else ended
        written = slice(None) if ended is None else ended == Status.WRITTEN
        for out, found in zip(call.outputs, outputs, strict=True):
            out[live[written]] = found[written]
        return status

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over memory of the device: as a list where that is worth it, and the run is not repeated."""
        if self.lists is not None and once and _WORTH_A_LIST <= math.prod(call.shape) == call.inputs[-1].count:
            prepared: Callable[[], None] = self.lists(call)
            return prepared
        return self.guarded.ready(call, once=once)
