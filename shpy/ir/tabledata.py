"""The data of a table, which programs hold and runtimes read.

Stage: represent. It is part of the IR package because `lang` creates it and `backend` reads it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

PARTS = 256
"""The number of recorded changes; a runtime that has missed more of them uploads the whole array."""


class TableData:
    """`array` is (*shape, size) for vectors, (*shape,) for scalars, of the working dtype.

    `version` counts updates: one of the whole brings another array, one of a part changes the array that is there. A
    runtime keeps the device's copy by the object's identity (weakly) and uploads again only when `version` has changed.
    """

    __slots__ = ("__weakref__", "_parts", "_readers", "array", "version")

    def __init__(self, array: NDArray[Any], version: int = 0) -> None:
        self.array = array
        self.version = version
        self._parts: list[tuple[int, int]] = []
        self._readers: set[Callable[[], None]] = set()

    def lent(self, settle: Callable[[], None]) -> None:
        """Record that a device reads the array in place; `settle` waits for the runs that may be reading it."""
        self._readers.add(settle)

    def settle(self) -> None:
        """Wait until no run reads the array, so that it may be changed or replaced."""
        for settle in self._readers:
            settle()

    def replace(self, array: NDArray[Any], version: int) -> None:
        """Replace the array and set its version."""
        self.settle()
        self.array, self.version = array, version
        self._parts = []

    def change(self, start: int, part: NDArray[Any]) -> None:
        """Write `part` along the first axis from `start` on, which makes the next version."""
        self.settle()
        self.array.flags.writeable = True
        self.array[start : start + len(part)] = part
        self.array.flags.writeable = False
        self.version += 1
        self._parts = [*self._parts[1 - PARTS :], (start, start + len(part))]

    def changed_since(self, version: int | None) -> list[tuple[int, int]] | None:
        """Return the disjoint ranges along the first axis that changed after `version`; None if all may have."""
        if version is None or not 0 <= self.version - version <= len(self._parts):
            return None
        ranges: list[tuple[int, int]] = []
        for start, stop in sorted(self._parts[len(self._parts) - (self.version - version) :]):
            if ranges and start <= ranges[-1][1]:
                ranges[-1] = ranges[-1][0], max(stop, ranges[-1][1])
            else:
                ranges.append((start, stop))
        return ranges
