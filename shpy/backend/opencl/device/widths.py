"""The width of a kernel's packets, chosen by measurement where the kernel runs.

Stage: run. No rule finds the fastest width: two registers a value hide the latency of one kernel and cost another its
registers, and processors differ. So `lanes="auto"` begins with the width of the device's vectors. Once the kernel has
run for as long as it took to compile, another process compiles the next width while runs go on (see `background`).
Then both run on samples of the next runs' own data, a little after each run, so that no run takes much longer than the
others; the faster one stays, and the outcome is kept on disk. So it goes on, to wider packets first, until both
neighbours of the width in use have been measured. A wider neighbour that is level hides what comes after it, so the
next wider one is measured too. Strict mode gives the same bits at every width, so nothing else can be seen.

    build(8) ──run, run, …──▶ spent > compiling ──▶ begin(16) ──run, run, …──▶ 16 is compiled ──run both, run both, …─┐
         ┌────────────────────────────────────────────────────────────────────────────────────────────────────────────┘
         ├─▶ 16 is faster ──run, run, …──▶ begin(32)
         └─▶ 8 is faster ──run, run, …──▶ begin(4)
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final

from shpy.backend.base import Array, Call, DeviceCall
from shpy.backend.device import store
from shpy.backend.opencl.device.beside import Beside, Sized, Waiting
from shpy.backend.opencl.device.memory import OpenCLSpace
from shpy.backend.opencl.device.samples import Sample, sample_of, sample_on_device
from shpy.errors import CompileError
from shpy.ir.nodes import Loc

_ENOUGH, _LONG_ENOUGH = 1 << 14, 1e-3
"""The least elements of a run that is measured, and its least seconds if it has fewer: short runs are all overhead."""
_COUNTS: Final = 64
"""The most numbers of elements for which the least time is kept."""
_LEAST_SPENT: Final = 0.05
"""Seconds of running before a trial pays, however fast the compiler was."""
_MOST_SPENT: Final = 0.5
"""Seconds of running after which the first trial is made, however slow the compiler was."""
_TRIED: Final = 0.2
"""Seconds for the runs of each width in a trial."""
_LEAST_ROUNDS, _MOST_ROUNDS = 5, 25
"""The least and the most runs of each width in a trial. The fastest counts, as other programs can only slow a run.

A trial of a long run uses a share of its elements, so that the least number of runs fits into `_TRIED`.
"""
_SHARE: Final = 0.5
"""The largest share of a run for a sample: both widths together then take as long as the run."""
_FINE: Final = 1e-4
"""The coarsest resolution, in seconds, of a clock of CPU time that can measure a run."""
_GAIN: Final = 0.97
"""The other width replaces the one in use if it takes at most this share of the time; smaller gains are noise."""
_LEVEL: Final = 1.1
"""A wider width that takes at most this share of the time is level: the next wider one may still gain."""
_SIMILAR: Final = 2
"""A run over device memory with at most this many times the elements of a timed run is not timed itself."""


@dataclass(slots=True)
class _Trial:
    """The seconds that an element of a sample takes at the width in use and at another one, by width."""

    other: Sized
    times: dict[int, list[float]]
    rounds: int = 0


def measured_widths(key: str, widths: tuple[int, ...]) -> tuple[int, ...]:
    """Return the widths that earlier trials measured, the one that they chose first; () where there were none."""
    kept = store.load(key)
    words = [] if kept is None else kept.decode(errors="replace").split()
    choices = tuple(int(word) for word in words if word.isdecimal())
    return choices if choices and set(choices) <= set(widths) and len(choices) == len(words) else ()


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
        builder: Beside,
        seconds: float,
        key: str,
        space: OpenCLSpace,
        measured: tuple[int, ...] = (),
        spread: int = 0,
    ) -> None:
        """Start with `first`, whose compilation took `seconds`; `builder` compiles for the others of the `widths`.

        The outcome of each trial is kept under `key`. `space`: where runs over streams are. `measured`: the widths that
        need no trial. `spread`: elements a lane with which all cores have work to the end of a run.
        """
        self._current = first
        self._widths = widths
        self._builder = builder
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
        self._step = threading.Lock()
        """Held by the thread that goes on with the choice; others run at the width in use meanwhile."""
        self._pending: Waiting | None = None
        self._trial: _Trial | None = None
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
        if self._other is None:
            return remark
        when = (
            "once another process has compiled them" if self._pending else "once runs have taken as long as compiling"
        )
        return f"{remark}; {self._other} are tried {'now' if self._trial else when}"

    @property
    def loops(self) -> tuple[Loc | None, ...]:
        """The lines of the limited loops."""
        return self._current.loops

    @property
    def writes_all(self) -> bool:
        """Return whether no element has a status."""
        return self._current.writes_all

    def run(self, call: Call) -> Array | None:
        """Run it; once enough time was spent, the data of calls decide between two widths."""
        if self._other is None:
            return self._current.run(call)
        start = time.perf_counter()
        status = self._current.run(call)
        self._go_on(call.count, time.perf_counter() - start, lambda share: sample_of(call, share))
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
            if self._other is None:
                run()
            else:
                seconds = self._start(run, count)
                self._go_on(count, seconds, lambda share: sample_on_device(call, share, self._space))

        return start

    def _start(self, run: Callable[[], None], count: int) -> float:
        """Start a run over memory of the device; returns the seconds that it takes.

        Wait for its end only before a trial, or where no earlier run allows an estimate of the seconds.
        """
        timed, seconds = self._timed
        if count <= _SIMILAR * timed and self._trial is None:
            run()
            return seconds * count / timed
        self._space.finish()
        start = time.perf_counter()
        self._space.start([run])  # which counts it: the space waits for nothing that it did not start
        self._space.finish()
        seconds = time.perf_counter() - start
        self._timed = count, seconds
        return seconds

    def _go_on(self, count: int, seconds: float, sample: Callable[[float], Sample]) -> None:
        """Go on with the choice after a run of so many elements and seconds; `sample` gives a share of its data."""
        if not self._step.acquire(blocking=False):
            return
        try:
            if self._other is None or self._says_nothing(count, seconds):
                return
            if self._trial is None and self._pending is None:
                self._spent += seconds
                if self._spent >= self._worth:
                    self._pending = self._builder.begin(self._other)
            if self._pending is not None and self._pending.done():
                self._receive(self._pending, self._other)
            elif self._trial is not None and not self._builder.busy:
                self._compare(self._trial, count, seconds, sample)
        except MemoryError:  # there is enough for the run itself
            self._other = self._trial = self._pending = None
            self._refusal = f"{self._refusal}, since there is no memory for trials"
        finally:
            self._step.release()

    def _says_nothing(self, count: int, seconds: float) -> bool:
        """Return whether a run is too short to measure a width."""
        if count >= _ENOUGH:
            return False
        if len(self._least) >= _COUNTS:
            self._least.clear()
        # One that other programs delayed is not long.
        least = self._least[count] = min(seconds, self._least.get(count, seconds))
        return least < _LONG_ENOUGH

    def _receive(self, pending: Waiting, width: int) -> None:
        """Begin a trial with the kernel of another width, or note the reason why there is none."""
        self._pending = None
        self._measured.add(width)
        try:
            other, seconds = pending.result()
        except CompileError as error:  # the first width stays, which is no slower than before: a note says so
            self._other = self._next()
            self._refusal = f", since {width} do not compile: {error.message}"
            return
        self._worth, self._spent = max(seconds, _LEAST_SPENT), 0.0
        self._trial = _Trial(other, {self._current.lanes: [], width: []})

    def _clock(self, count: int, lanes: int) -> Callable[[], float]:
        """Return the clock of a trial: CPU time, which other programs hardly change, where no core can be idle."""
        if count >= self._spread * lanes and time.get_clock_info("process_time").resolution <= _FINE:
            return time.process_time
        return time.perf_counter

    def _compare(self, trial: _Trial, count: int, seconds: float, sample: Callable[[float], Sample]) -> None:
        """Run both widths on samples of a run, once or for as long as the run took; decide after enough rounds."""
        began, sized = time.perf_counter(), {s.lanes: s for s in (self._current, trial.other)}
        share = min(max(_SHARE, _ENOUGH / count), _TRIED / _LEAST_ROUNDS / seconds, 1.0) if seconds else 1.0
        part = sample(share)
        rounds = min(max(int(_TRIED / (seconds * share)), _LEAST_ROUNDS), _MOST_ROUNDS) if seconds else _MOST_ROUNDS
        clock = self._clock(part.count, max(sized))
        runs = {lanes: part.prepare(executable) for lanes, executable in sized.items()}
        if not trial.rounds:
            runs[trial.other.lanes]()  # the first run of a kernel is not like the others
        while trial.rounds < rounds:
            # By turns one begins, which finds nothing of the sample in the cache.
            for lanes in sorted(runs, reverse=trial.rounds % 2 == 1):
                trial.times[lanes].append(_seconds(runs[lanes], clock) / part.count)
            trial.rounds += 1
            if time.perf_counter() - began + 2 * share * seconds > seconds:
                break
        if trial.rounds >= rounds:
            self._decide(trial)

    def _decide(self, trial: _Trial) -> None:
        """Keep the faster width, and the outcome on disk."""
        first, other = self._current, trial.other
        width = other.lanes
        mine, its = min(trial.times[first.lanes]), min(trial.times[width])
        if its < _GAIN * mine:
            self._current, self._shares = other, []
            self._level.clear()
            mine, its, width = its, mine, first.lanes
        elif its < _LEVEL * mine and width > first.lanes:
            self._level.add(width)
        self._shares.append(f"{mine / its:.2f} of the time of {width}")
        self._trial = None
        self._other = self._next()
        # A process that ends before the width behind a level one is measured leaves both to the next process.
        open_ = self._level if self._other is not None else set()
        kept = (self._current.lanes, *sorted(self._measured - open_ - {self._current.lanes}))
        store.save(self._key, " ".join(map(str, kept)).encode())


def _seconds(run: Callable[[], object], clock: Callable[[], float]) -> float:
    start = clock()
    run()
    return clock() - start
