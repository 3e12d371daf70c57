"""The part of a call that one dispatch does, so that each is short: a GPU's watchdog stops long ones.

Stage: run. Windows resets a device after two seconds, desktop drivers for Linux after five to ten; a dispatch of about
a tenth of a second is far from either, and lets Ctrl-C be heard. The cost of an element is not known before the first
run, so the first dispatch is small, and the size of each next one follows from the time of the last one.

    pace = Pace()                              # one a kernel: the next call starts with what was learnt
    run = pace.driver(rows, dispatch, finish, width, reads=True)
    run()
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Final, TypeVar

T = TypeVar("T")

SECONDS: Final = 0.1
"""The time that a dispatch should take."""
FIRST: Final = 256
"""Elements of a kernel's first dispatch."""
AGAIN: Final = 1 << 14
"""Elements of the first dispatch of each call of a kernel that is not steady, at most."""
GROWTH: Final = 8
"""A dispatch has at most this many times the elements of the one before: their elements may have been cheaper."""
BRIEF: Final = 0.005
"""Seconds of a dispatch that a caller need not be able to interrupt."""
AGAIN_AFTER: Final = 64
"""Brief dispatches after which one is timed again."""
QUARTERS: Final = 4
"""Equal parts of a better build's cost: a `Watch` tells each time when one more of them is spent."""
SHORT: Final = 10
"""A dispatch that takes less than one in this many of `SECONDS` is short."""


class Pace:
    """The number of elements of one kernel that take about `seconds`.

    `bounded`: no data makes an element take more than a few thousand iterations. Not `steady`: the elements of the
    next call may cost any factor more, so each call begins with a small dispatch.
    """

    def __init__(
        self,
        seconds: float = SECONDS,
        clock: Callable[[], float] = time.perf_counter,
        *,
        steady: bool = True,
        bounded: bool = True,
    ) -> None:
        self.seconds = seconds
        self.bounded = bounded
        self.steady = steady
        self.elements = FIRST
        self._brief = 0
        self._asked = 0
        self._clock = clock

    def driver(
        self,
        rows: int,
        dispatch: Callable[[int, int], T],
        finish: Callable[[T], None],
        width: int,
        least: int = 1,
        *,
        reads: bool,
    ) -> Callable[[], None]:
        """Return a function that runs rows of `width` elements, in as many dispatches as they need.

        `dispatch(first, count)` starts some rows, at least `least`, and `finish` waits for the end of what that gave. A
        run is one dispatch, and not waited for, if it is known to be brief; or, unless the caller `reads` the results
        next, to fit in one.
        """
        elements = rows * width

        def run() -> None:
            if self.is_brief(elements) if reads else self.fits(elements):
                dispatch(0, rows)
                return
            for first, count in self.parts(rows, width, least):
                finish(dispatch(first, count))

        return run

    def parts(self, rows: int, width: int = 1, least: int = 1) -> Iterator[tuple[int, int]]:
        """Yield the first row and the number of rows of each dispatch, which has ended when the next one is asked for.

        A row is `width` elements, and a dispatch has at least `least` rows.
        """
        if not self.steady:
            self.elements = min(self.elements, AGAIN)
        first = 0
        while first < rows:
            most = max(least, self.elements // width)
            count = min(rows - first, most)
            started = self._clock()
            yield first, count
            self._learn(count * width, self._clock() - started, whole=count == most)
            first += count

    def fits(self, elements: int) -> bool:
        """Return whether this number of elements is known to fit into the time of one dispatch."""
        return self.steady and elements <= self.elements

    def is_brief(self, elements: int) -> bool:
        """Return whether as many elements took less than `BRIEF` when they were timed last; now and then they are."""
        self._asked += 1
        return self.was_brief(elements) and self._asked % AGAIN_AFTER != 0

    def was_brief(self, elements: int) -> bool:
        """Return whether as many elements took less than `BRIEF` when they were timed last."""
        return self.bounded and elements <= self._brief

    def _learn(self, elements: int, seconds: float, *, whole: bool) -> None:
        """Learn from the time of a dispatch; `whole`: the limit decided its size, not the end of the run."""
        if seconds < BRIEF:
            self._brief = max(self._brief, elements)
        elif elements <= self._brief:
            self._brief = 0
        fitting = elements * self.seconds / seconds if seconds > 0 else elements * GROWTH
        if fitting < self.elements:
            # A short dispatch takes as long as it does because of what each dispatch costs.
            if seconds > self.seconds / SHORT or whole:
                self.elements = max(1, int(fitting))
        elif whole:  # the time of a small rest does not show how many would fit
            self.elements = min(int(fitting), GROWTH * self.elements)
        elif seconds < BRIEF:  # but that it fits itself: to wait for a small run takes as long as the run
            self.elements = max(self.elements, elements)


class Watch(Pace):
    """The pace of a kernel that was built in a hurry, which tells when a better build pays.

    Every dispatch is timed, until the seconds of all of them, and those that the rest of the current run is expected
    to take, reach what the better build is expected to cost (`worth`). So both builds and the runs of the first one
    take at most about twice as long as the better choice of the two would have (the ski rental problem, see
    `run/tiers`).
    """

    def __init__(
        self,
        seconds: float,
        clock: Callable[[], float] = time.perf_counter,
        *,
        bounded: bool,
        worth: float,
        quarters: int = 0,
        tell: Callable[[int], None] = lambda _: None,
    ) -> None:
        """`quarters` of `worth` were spent before; each further one is told."""
        super().__init__(seconds, clock, bounded=bounded)
        self.watches = True
        self._worth, self._spent, self._rest = worth, worth * quarters / QUARTERS, 0.0
        self._quarters, self._tell = quarters, tell
        self._left = 0
        """Elements that the current run has still to do."""

    @property
    def pays(self) -> bool:
        """Return whether the better build pays, and was not made yet."""
        return self.watches and self._spent + self._rest >= self._worth

    def end(self) -> None:
        """Be a plain pace from now on, for a kernel with other costs."""
        self.elements, self._brief = FIRST, 0
        self.watches = False

    def parts(self, rows: int, width: int = 1, least: int = 1) -> Iterator[tuple[int, int]]:
        """Yield the dispatches of a run: see `Pace.parts`, by which each run goes as long as it is timed."""
        self._left, self._rest = rows * width, 0.0
        return super().parts(rows, width, least)

    def fits(self, elements: int) -> bool:
        """Return whether this number of elements is known to fit into a dispatch that is not timed."""
        return not self.watches and super().fits(elements)

    def was_brief(self, elements: int) -> bool:
        """Return whether as many elements need not be timed."""
        return not self.watches and super().was_brief(elements)

    def _learn(self, elements: int, seconds: float, *, whole: bool) -> None:
        super()._learn(elements, seconds, whole=whole)
        self._left -= elements
        self._spent += seconds
        # Of a brief dispatch most time may go into its start.
        self._rest = seconds / elements * self._left if seconds >= BRIEF else 0.0
        quarters = int(QUARTERS * self._spent / self._worth)
        if self.watches and self._quarters < quarters < QUARTERS:
            self._quarters = quarters
            self._tell(quarters)
