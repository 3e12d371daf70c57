"""The width of a kernel's packets, chosen by measurement where the kernel runs.

Stage: run. No rule finds the fastest width: two registers a value hide the latency of one kernel and cost another its
registers, and processors differ. So `lanes="auto"` begins with the width of the device's vectors. Once the kernel has
run for as long as it took to compile, the next width is compiled and both run on a sample of that run's own data; the
faster one stays, and the outcome is kept on disk. So it goes on, to wider packets first, until both neighbours of the
width in use have been measured. A wider neighbour that is level hides what comes after it, so the next wider one is
measured too. Strict mode gives the same bits at every width, so nothing else can be seen.

    build(8) ──run, run, …──▶ spent > compiling ──▶ build(16) ──run both─┬─▶ 16 is faster ──run, run, …──▶ build(32)
                                                                         └─▶ 8 is faster ──run, run, …──▶ build(4)
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Final, Protocol

from shpy.backends import store
from shpy.backends.base import Array, Call, DeviceCall, Executable
from shpy.backends.opencl.samples import Sample, sample_of, sample_on_device
from shpy.errors import CompileError
from shpy.ir.nodes import Loc

if TYPE_CHECKING:
    from shpy.backends.opencl.memory import OpenCLSpace

__all__ = ["Choosing", "measured_widths", "next_width"]

_ENOUGH, _LONG_ENOUGH = 1 << 14, 1e-3
"""Elements of a run that says something about a width, and seconds of one with fewer: shorter runs are all overhead."""
_COUNTS: Final = 64
"""Numbers of elements whose least times are kept."""
_LEAST_SPENT: Final = 0.05
"""Seconds of running before a trial pays, however fast the compiler was."""
_MOST_SPENT: Final = 0.5
"""Seconds of running after which the first trial is made, however slow the compiler was."""
_TRIED: Final = 0.2
"""Seconds for the runs of each width in a trial."""
_LEAST_ROUNDS, _MOST_ROUNDS = 5, 25
"""Runs of each width: as many as fit. The fastest one counts, because other programs can only slow a run.

Of a run that is too long for so many, a part is tried.
"""
_FINE: Final = 1e-4
"""Seconds: a clock of CPU time that is coarser says nothing about a run."""
_GAIN: Final = 0.97
"""The other width stays if it takes at most this much of the time: less is noise."""
_LEVEL: Final = 1.1
"""A wider width that takes at most this much of the time is level: the next wider one may still gain."""
_SIMILAR: Final = 2
"""A run over memory of the device of at most so many times the elements of a run that was waited for is not."""


class Sized(Executable, Protocol):
    """An executable whose packets have one width."""

    @property
    def lanes(self) -> int:
        """Elements of a packet."""


def measured_widths(key: str, widths: tuple[int, ...]) -> tuple[int, ...]:
    """Return the widths that earlier trials measured, the one that they chose first; () where there were none."""
    kept = store.load(key)
    words = [] if kept is None else kept.decode(errors="replace").split()
    found = tuple(int(word) for word in words if word.isdecimal())
    return found if found and set(found) <= set(widths) and len(found) == len(words) else ()


def next_width(
    current: int, measured: Collection[int], widths: tuple[int, ...], level: Collection[int] = ()
) -> int | None:
    """Return the neighbour of `current` to measure next, the wider one first; None where both are measured.

    Behind a wider neighbour that is `level` with the current width stands the next wider one.
    """
    at = widths.index(current)
    wider = next((width for width in widths[at + 1 :] if width not in level), current)
    beside = (wider, *widths[max(at - 1, 0) : at])
    return next((width for width in beside if width not in measured), None)


class Choosing:
    """An executable that tries other widths on its own data: see `base.Executable`."""

    def __init__(
        self,
        first: Sized,
        widths: tuple[int, ...],
        build: Callable[[int], Sized],
        seconds: float,
        key: str,
        space: OpenCLSpace,
        measured: tuple[int, ...] = (),
        spread: int = 0,
    ) -> None:
        """Start with `first`, whose compilation took `seconds`; `build` compiles for one of the `widths`.

        The outcome of each trial is kept under `key`. `space`: where runs over streams are. `measured`: the widths that
        need no trial. `spread`: elements a lane with which all cores have work to the end of a run.
        """
        self._current = first
        self._widths = widths
        self._build = build
        self._worth = min(max(seconds, _LEAST_SPENT), _MOST_SPENT)
        self._spent = 0.0
        self._key = key
        self._space = space
        self._timed = (0, 0.0)
        """The elements of a run over memory of the device, and its seconds."""
        self._least: dict[int, float] = {}
        """The least seconds of runs of few elements, by their number."""
        self._measured = {first.lanes, *measured}
        self._level: set[int] = set()
        self._spread = spread
        self._trying = False
        self._other = self._next()
        self._shares: list[str] = []
        self._refusal = ""

    @property
    def lanes(self) -> int:
        """The width in use."""
        return self._current.lanes

    @property
    def source(self) -> str:
        """The text of the width in use."""
        return self._current.source

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes of the width in use, and why it is in use."""
        return (*self._current.notes, self._remark)

    def _next(self) -> int | None:
        """Return the width to try next."""
        return next_width(self._current.lanes, self._measured, self._widths, self._level)

    @property
    def _remark(self) -> str:
        shares = f", whose runs of this program take {' and '.join(self._shares)}" if self._shares else ""
        remark = f"{self._current.lanes} lanes{shares}{self._refusal}"
        other = self._other
        return f"{remark}; {other} are tried once runs have taken as long as compiling" if other else remark

    @property
    def loops(self) -> tuple[Loc | None, ...]:
        """The lines of the limited loops."""
        return self._current.loops

    @property
    def writes_all(self) -> bool:
        """Return whether no element has a status."""
        return self._current.writes_all

    def run(self, call: Call) -> Array | None:
        """Run it; once enough time was spent, this call's data decide between two widths."""
        if self._trying or self._other is None:
            return self._current.run(call)
        start = time.perf_counter()
        status = self._current.run(call)
        self._spend(call.count, time.perf_counter() - start, lambda share: sample_of(call, share))
        return status

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over memory of the device, at the width that is in use when it starts."""
        current = self._current
        run = current.ready(call, once=once)
        count = math.prod(call.shape)
        if self._other is None or not count:
            return run

        def start() -> None:
            nonlocal current, run
            if current is not self._current:
                current = self._current
                run = current.ready(call, once=once)
            if self._trying or self._other is None:
                run()
            else:
                taken = self._start(run, count)
                self._spend(count, taken, lambda share: sample_on_device(call, share, self._space))

        return start

    def _start(self, run: Callable[[], None], count: int) -> float:
        """Start a run over memory of the device; returns the seconds that it takes.

        It is waited for only where they do not follow from those of an earlier run.
        """
        timed, taken = self._timed
        if count <= _SIMILAR * timed:
            run()
            return taken * count / timed
        self._space.finish()
        start = time.perf_counter()
        self._space.start([run])  # which counts it: the space waits for nothing that it did not start
        self._space.finish()
        taken = time.perf_counter() - start
        self._timed = count, taken
        return taken

    def _spend(self, count: int, taken: float, sample: Callable[[float], Sample]) -> None:
        """Count the seconds of a run; make a trial on a sample of it once they amount to those of compiling."""
        other = self._other
        if self._trying or other is None:
            return
        if count < _ENOUGH:  # one that other programs delayed is not long
            if len(self._least) >= _COUNTS:
                self._least.clear()
            taken = self._least[count] = min(taken, self._least.get(count, taken))
            if taken < _LONG_ENOUGH:
                return
        self._spent += taken
        if self._spent >= self._worth:
            self._trying = True  # before the trial: another thread goes on with the first width
            try:
                self._try(other, sample, taken)
            finally:
                self._trying = False

    def _clock(self, count: int, lanes: int) -> Callable[[], float]:
        """Return the clock of a trial: CPU time, which other programs hardly change, where no core can be idle."""
        if count >= self._spread * lanes and time.get_clock_info("process_time").resolution <= _FINE:
            return time.process_time
        return time.perf_counter

    def _try(self, width: int, sample: Callable[[float], Sample], taken: float) -> None:
        first, start = self._current, time.perf_counter()
        self._measured.add(width)
        try:
            other = self._build(width)
        except CompileError as error:  # the first width stays, which is no slower than before: a note says so
            self._other = self._next()
            self._refusal = f", since {width} do not compile: {error.message}"
            return
        self._worth, self._spent = max(time.perf_counter() - start, _LEAST_SPENT), 0.0
        longest = _TRIED / _LEAST_ROUNDS
        part = sample(longest / taken if taken > longest else 1.0)
        rounds = min(max(int(_TRIED / taken), _LEAST_ROUNDS), _MOST_ROUNDS)
        clock = self._clock(part.count, max(first.lanes, other.lanes))
        runs = {sized.lanes: part.prepare(sized) for sized in (first, other)}
        runs[width]()  # the first run of a kernel is not like the others
        times: dict[int, list[float]] = {lanes: [] for lanes in runs}
        for _ in range(rounds):
            for lanes, run in runs.items():
                times[lanes].append(_seconds(run, clock))
        mine, its = min(times[first.lanes]), min(times[other.lanes])
        if its < _GAIN * mine:
            self._current, self._shares = other, []
            self._level.clear()
            mine, its, width = its, mine, first.lanes
        elif its < _LEVEL * mine and width > first.lanes:
            self._level.add(width)
        self._shares.append(f"{mine / its:.2f} of the time of {width}")
        self._other = self._next()
        # A process that ends before the width behind a level one is measured leaves both to the next process.
        open_ = self._level if self._other is not None else set()
        kept = (self._current.lanes, *sorted(self._measured - open_ - {self._current.lanes}))
        store.save(self._key, " ".join(map(str, kept)).encode())


def _seconds(run: Callable[[], object], clock: Callable[[], float]) -> float:
    start = clock()
    run()
    return clock() - start
