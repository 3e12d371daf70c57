"""How much of a call one dispatch does, so that none takes long: a GPU's watchdog stops what does.

Stage: run. Windows resets a device after two seconds, desktop drivers for Linux after five to ten; a dispatch of about
a tenth of a second is far from either, and lets Ctrl-C be heard. What a kernel's elements cost is not known before they
run, so the first dispatch is small, and each next one is as large as the last one's time allows.

    pace = Pace()                              # one a kernel: the next call starts with what was learnt
    for first, count in pace.parts(rows, width):
        dispatch(first, count)                 # and wait for its end
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Final

__all__ = ["Pace"]

SECONDS: Final = 0.1
"""What a dispatch should take."""
FIRST: Final = 1 << 16
"""Elements of a kernel's first dispatch."""
GROWTH: Final = 8
"""A dispatch has at most this many times the elements of the one before: those were perhaps the cheap ones."""


class Pace:
    """How many elements of one kernel's take about `SECONDS`."""

    def __init__(self, seconds: float = SECONDS, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds = seconds
        self.elements = FIRST
        self._clock = clock

    def parts(self, rows: int, width: int = 1) -> Iterator[tuple[int, int]]:
        """First row and number of rows of each dispatch, a row being `width` elements; at least one row each.

        Whoever iterates has to wait for a dispatch's end before asking for the next.
        """
        first = 0
        while first < rows:
            count = min(rows - first, max(1, self.elements // width))
            started = self._clock()
            yield first, count
            self._learn(count * width, self._clock() - started)
            first += count

    def _learn(self, elements: int, seconds: float) -> None:
        fitting = elements * self.seconds / seconds if seconds > 0 else elements * GROWTH
        if fitting < self.elements or elements >= self.elements:  # a small rest says nothing of how many would fit
            self.elements = max(1, min(int(fitting), GROWTH * self.elements))
