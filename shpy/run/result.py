"""The result of a run of a kernel, over arrays or over streams.

Stage: run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from shpy.backend.base import Counts
from shpy.ir.nodes import Status
from shpy.lang.values.types import Attrib1b, Attrib1i
from shpy.streams.elements import Shape
from shpy.streams.stream import Place, Stream


@dataclass(eq=False)
class Result:
    """The result of a run: `outputs` in the function's structure, `written` (bool, S), `count` elements written.

    The outputs are arrays, or Streams where data of the run were Streams. `written` and `count` are computed on first
    access.
    """

    outputs: Any
    shape: Shape
    status: Any = None
    """The int32 status of each element (n,), in an array or in memory of the device; None if all were written."""
    place: Place | None = None
    """The device that holds the Streams; None for arrays."""

    @cached_property
    def counts(self) -> Counts:
        """The numbers of elements that were written, and that a loop limit stopped."""
        if self.status is None:
            return Counts(math.prod(self.shape))
        return Counts.of(self.status) if self.place is None else self.place.space.count(self.status)

    @property
    def count(self) -> int:
        """The number of elements that were written."""
        return self.counts.written

    @cached_property
    def written(self) -> Any:
        """True for each element that was written: bools of the run's shape, an array or a Stream."""
        if self.place is None:
            whole = np.ones(self.shape, np.bool_)
            return whole if self.status is None else (self.status == Status.WRITTEN).reshape(self.shape)
        full = Stream.fresh(self.shape, Attrib1b, self.place)
        (leaf,) = full.leaf_entries()
        leaf.memory.write(np.ones(leaf.memory.count, np.bool_))
        if self.status is not None and leaf.memory.count:
            leaf.replace(self.place.space.merge(self.status, leaf.memory, None))
        return full

    def __reduce__(self) -> Any:
        status = self.status
        if status is not None and self.place is not None:
            status = Stream.over(Attrib1i, (status.count,), self.place, [status])  # a list needs the stream of statuses
        return _sent, (self.outputs, self.shape, status, self.place)


def _sent(outputs: Any, shape: Shape, status: Any, place: Place | None) -> Result:
    """Return a result that was pickled in another process."""
    if isinstance(status, Stream):
        status = status.leaf_entries()[0].memory
    return Result(outputs, shape, status, place)
