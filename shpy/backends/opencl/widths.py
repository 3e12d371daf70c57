"""The width of a kernel's packets, chosen by measurement where the kernel runs.

Stage: run. No rule finds the fastest width: two registers a value hide the latency of one kernel and cost another its
registers, and processors differ. So `lanes="auto"` begins with the width of the device's vectors. Once the kernel has
run for as long as it took to compile, another width is compiled and both run on that run's own data; the faster one
stays, and the outcome is kept on disk. Strict mode gives the same bits at every width, so nothing else can be seen.

    build(8) ──run, run, …──▶ spent > compiling ──▶ build(16) ──run both──▶ the faster one, kept under the kernel's key
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final, Protocol

import numpy as np

from shpy.backends import store
from shpy.backends.base import Array, Call, Executable
from shpy.errors import CompileError
from shpy.ir.nodes import Loc

__all__ = ["Choosing", "known_width"]

_ENOUGH: Final = 1 << 14
"""Elements of a run that says something about a width: shorter runs are all overhead."""
_LEAST_SPENT: Final = 0.05
"""Seconds of running before a trial pays, however fast the compiler was."""
_MOST_SPENT: Final = 0.5
"""Seconds of running after which a trial is made, however slow the compiler was."""
_LONGEST: Final = 0.2
"""Seconds of a run that is made again as a whole; of a longer one a part is."""
_ROUNDS: Final = 5
"""Runs of each width where they are short; long ones take one."""
_GAIN: Final = 0.97
"""The other width stays if it takes at most this much of the time: less is noise."""


class Sized(Executable, Protocol):
    """An executable whose packets have one width."""

    @property
    def lanes(self) -> int:
        """Elements of a packet."""


def known_width(key: str, widths: tuple[int, ...]) -> int | None:
    """Return the width that an earlier trial chose, or None where there was none."""
    kept = store.load(key)
    if kept is None or not kept.isdigit():
        return None
    return int(kept) if int(kept) in widths else None


class Choosing:
    """An executable that tries a second width on its own data: see `base.Executable`."""

    def __init__(self, first: Sized, other: int, build: Callable[[int], Sized], seconds: float, key: str) -> None:
        """Start with `first`, whose compilation took `seconds`; `build(other)` compiles the width to try."""
        self._current = first
        self._other = other
        self._build = build
        self._worth = min(max(seconds, _LEAST_SPENT), _MOST_SPENT)
        self._spent = 0.0
        self._key = key
        self._settled = False
        self._remark = f"{first.lanes} lanes; {other} are tried once runs have taken as long as compiling"

    @property
    def source(self) -> str:
        """The text of the width in use."""
        return self._current.source

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes of the width in use, and why it is in use."""
        return (*self._current.notes, self._remark)

    @property
    def loops(self) -> tuple[Loc | None, ...]:
        """The lines of the limited loops."""
        return self._current.loops

    @property
    def writes_all(self) -> bool:
        """Return whether no element has a status."""
        return self._current.writes_all

    def run(self, call: Call) -> Array | None:
        """Run it; once enough time was spent, this call's data decide the width."""
        if self._settled or call.count < _ENOUGH:
            return self._current.run(call)
        start = time.perf_counter()
        status = self._current.run(call)
        taken = time.perf_counter() - start
        self._spent += taken
        if self._spent >= self._worth:
            self._settled = True  # before the trial: another thread goes on with the first width
            self._try(call, taken)
        return status

    def _try(self, call: Call, taken: float) -> None:
        first = self._current
        try:
            other = self._build(self._other)
        except CompileError as error:
            self._remark = f"{first.lanes} lanes, since {self._other} do not compile: {error.message}"
            return
        part = _part(call, _LONGEST / 2 / taken) if taken > _LONGEST else _scratch(call)
        rounds = _ROUNDS if taken < _LONGEST / _ROUNDS else 1
        _seconds(other, part)  # the first run of a kernel is not like the others
        times: dict[int, list[float]] = {sized.lanes: [] for sized in (first, other)}
        for _ in range(rounds):
            for sized in (first, other):
                times[sized.lanes].append(_seconds(sized, part))
        mine, its = min(times[first.lanes]), min(times[other.lanes])
        if its < _GAIN * mine:
            self._current = other
        chosen, left = (other, first) if self._current is other else (first, other)
        share = min(times[chosen.lanes]) / min(times[left.lanes])
        self._remark = f"{chosen.lanes} lanes, whose runs of this program take {share:.2f} of the time of {left.lanes}"
        store.save(self._key, str(chosen.lanes).encode())


def _seconds(executable: Executable, call: Call) -> float:
    start = time.perf_counter()
    executable.run(call)
    return time.perf_counter() - start


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
