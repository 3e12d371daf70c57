"""The width of a kernel's packets, chosen by measurement where the kernel runs.

Stage: run. No rule finds the fastest width: two registers a value hide the latency of one kernel and cost another its
registers, and processors differ. So `lanes="auto"` begins with the width of the device's vectors. Once the kernel has
run for as long as it took to compile, the next width is compiled and both run on that run's own data; the faster one
stays, and the outcome is kept on disk. So it goes on, to wider packets first, until both neighbours of the width in use
have been measured. A wider neighbour that is level hides what comes after it, so the next wider one is measured too.
Strict mode gives the same bits at every width, so nothing else can be seen.

    build(8) ──run, run, …──▶ spent > compiling ──▶ build(16) ──run both─┬─▶ 16 is faster ──run, run, …──▶ build(32)
                                                                         └─▶ 8 is faster ──run, run, …──▶ build(4)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Final, Protocol

import numpy as np

from shpy.backends import store
from shpy.backends.base import Array, Call, DeviceCall, Executable
from shpy.errors import CompileError
from shpy.ir.nodes import Loc

__all__ = ["Choosing", "measured_widths", "next_width"]

_ENOUGH, _LONG_ENOUGH = 1 << 14, 1e-3
"""Elements of a run that says something about a width, and seconds of one with fewer: shorter runs are all overhead."""
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
        measured: tuple[int, ...] = (),
        spread: int = 0,
    ) -> None:
        """Start with `first`, whose compilation took `seconds`; `build` compiles for one of the `widths`.

        `measured`: the widths that need no trial; the outcome of each trial is kept under `key`. `spread`: elements a
        lane with which all cores have work to the end of a run.
        """
        self._current = first
        self._widths = widths
        self._build = build
        self._worth = min(max(seconds, _LEAST_SPENT), _MOST_SPENT)
        self._spent = 0.0
        self._key = key
        self._measured = {first.lanes, *measured}
        self._level: set[int] = set()
        self._spread = spread
        self._trying = False
        self._shares: list[str] = []
        self._refusal = ""

    @property
    def source(self) -> str:
        """The text of the width in use."""
        return self._current.source

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes of the width in use, and why it is in use."""
        return (*self._current.notes, self._remark)

    @property
    def _other(self) -> int | None:
        """The width to try next."""
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
        other = self._other
        if self._trying or other is None:
            return self._current.run(call)
        start = time.perf_counter()
        status = self._current.run(call)
        taken = time.perf_counter() - start
        if call.count < _ENOUGH and taken < _LONG_ENOUGH:
            return status
        self._spent += taken
        if self._spent >= self._worth:
            self._trying = True  # before the trial: another thread goes on with the first width
            try:
                self._try(other, call, taken)
            finally:
                self._trying = False
        return status

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over memory of the device, at the width that is in use now."""
        return self._current.ready(call, once=once)

    def _clock(self, count: int, lanes: int) -> Callable[[], float]:
        """Return the clock of a trial: CPU time, which other programs hardly change, where no core can be idle."""
        if count >= self._spread * lanes and time.get_clock_info("process_time").resolution <= _FINE:
            return time.process_time
        return time.perf_counter

    def _try(self, width: int, call: Call, taken: float) -> None:
        first, start = self._current, time.perf_counter()
        self._measured.add(width)
        try:
            other = self._build(width)
        except CompileError as error:  # the first width stays, which is no slower than before: a note says so
            self._refusal = f", since {width} do not compile: {error.message}"
            return
        self._worth, self._spent = max(time.perf_counter() - start, _LEAST_SPENT), 0.0
        longest = _TRIED / _LEAST_ROUNDS
        part = _part(call, longest / taken) if taken > longest else _scratch(call)
        rounds = min(max(int(_TRIED / taken), _LEAST_ROUNDS), _MOST_ROUNDS)
        clock = self._clock(part.count, max(first.lanes, other.lanes))
        _seconds(other, part, clock)  # the first run of a kernel is not like the others
        times: dict[int, list[float]] = {sized.lanes: [] for sized in (first, other)}
        for _ in range(rounds):
            for sized in (first, other):
                times[sized.lanes].append(_seconds(sized, part, clock))
        mine, its = min(times[first.lanes]), min(times[other.lanes])
        if its < _GAIN * mine:
            self._current, self._shares = other, []
            self._level.clear()
            mine, its, width = its, mine, first.lanes
        elif its < _LEVEL * mine and width > first.lanes:
            self._level.add(width)
        self._shares.append(f"{mine / its:.2f} of the time of {width}")
        # A process that ends before the width behind a level one is measured leaves both to the next process.
        open_ = self._level if self._other is not None else set()
        kept = (self._current.lanes, *sorted(self._measured - open_ - {self._current.lanes}))
        store.save(self._key, " ".join(map(str, kept)).encode())


def _seconds(executable: Executable, call: Call, clock: Callable[[], float]) -> float:
    start = clock()
    executable.run(call)
    return clock() - start


def _scratch(call: Call) -> Call:
    """The same run into arrays of its own."""
    return replace(call, outputs=tuple(np.empty_like(o) for o in call.outputs))


def _part(call: Call, share: float) -> Call:
    """A run over the middle rows, about so much of the whole, into arrays of its own."""
    rows, *rest = call.shape
    count = max(1, min(rows, int(rows * share)))
    each = call.count // rows
    begin = (rows - count) // 2 * each
    end = begin + count * each
    inputs = tuple(a[begin:end] if len(a) == call.count else a for a in call.inputs)
    outputs = tuple(np.empty_like(o[begin:end]) for o in call.outputs)
    return replace(call, shape=(count, *rest), inputs=inputs, outputs=outputs)
