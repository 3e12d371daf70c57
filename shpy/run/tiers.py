"""The backend "auto": numpy at once, and OpenCL with the same bits from when compiling for it has paid.

Stage: run. numpy compiles in a moment and is slow; OpenCL is tens of times as fast, and its driver takes up to seconds
to compile. numpy computes until the seconds spent on it, and the rest of the call as far as it is known, reach what
compiling for OpenCL is expected to cost. Then the caller waits for the driver, and OpenCL goes on, also in the middle
of a call. So a process takes at most about twice the time of the better backend, however wrong the expectation is
(the ski rental problem; Karlin et al. 1988). Seconds that earlier processes spent on a program count as well, in
sixteenths of that cost: a script that is run again and again would never reach it otherwise. One of its processes then
compiles sooner, and the bound is that of all of them together. The programs of a process pay together for the start
of OpenCL, which they share: eight processes of five programs took 0.73 of the time of programs that each pay it alone
(`benchmarks/startup`).

    kernel = program.compile("auto")
    kernel(x)                  # kernel.runs_on == "numpy"
    kernel(large)              # "opencl" from now on; kernel.notes say why

numpy stays in relaxed and fast mode, whose bits differ between backends; for streams, which lie on numpy; and where
OpenCL refuses the program, gives an error, or is slower, as where a graphics card spends its time on copies. In worker
processes of `multiprocessing`, which share the cores, OpenCL keeps to one core, as numpy does.
"""

from __future__ import annotations

import importlib.util
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property
from typing import Any, Final

from shpy.backend.base import Array, Call, Device, DeviceCall, Executable, Options, Space
from shpy.backend.registry import AUTO, backend as backend_named
from shpy.backend.slow import announced
from shpy.errors import ShpyError, raise_interrupt
from shpy.ieee import ieee_arithmetic
from shpy.ir.collector import uncollected
from shpy.ir.nodes import Loc, Module
from shpy.ir.text import print_module
from shpy.ir.traverse import walk
from shpy.passes.modes import REPRODUCIBLE

QUICK: Final = "numpy"
BETTER: Final = "opencl"
MISSING: Final = f"there is no {BETTER} here"
SLOWER: Final = f"{BETTER} is slower here"
REFUSES: Final = f"{BETTER} does not take it ({{}})"
_COMPILED: Final = "texts that OpenCL compiled"
"""The list of texts whose binaries the driver is expected to have in its own files."""
_SPENT: Final = "seconds that numpy spent on texts"
"""The list of texts with the parts of the cost of compiling that processes spent on them without compiling."""
_PARTS: Final = 16
_START: Final = 0.1
"""Seconds to load pyopencl and to open a driver, once in a process."""
_COMPILER: Final = 0.7
"""Seconds until a driver compiles the first text of a process: PoCL reads its library of functions."""
_COLD: Final = (0.19, 0.0011)
"""Seconds to compile a program, and each of its prepared statements: off by 1.5 times on the mean of 26 programs."""
_CACHED: Final = (0.015, 0.00015)
"""The same where the driver has compiled this text in an earlier process: 22 programs took 0.3 to 1.5 of it."""
_LOOK: Final = 0.02
"""Seconds between two readings of the clock in the middle of a call."""
_SMALL: Final = 256
"""The most elements of a small call. Only a sample of small calls is timed."""
_LARGE: Final = 65_536
"""The most elements of numpy's tiles."""
_SAMPLE: Final = 32
"""Small calls for each one that is timed: reading the clock at each call would cost a twentieth of it."""
_LAUNCH: Final = 5e-5
"""Seconds of OpenCL's shortest call: numpy runs what it can run in that time."""
_TRIED: Final = 4
"""Calls of OpenCL, of which the fastest is compared with numpy: drivers compile in the first ones, too."""


_in_all = 0.0
"""Seconds that numpy spent on all programs of "auto" in this process."""


class AutoBackend:
    """numpy, followed by OpenCL: see `base.Backend`."""

    name = AUTO

    def devices(self) -> list[Device]:
        """Return numpy's device, where streams lie."""
        return backend_named(QUICK).devices()

    def compile(self, module: Module, options: Options) -> Executable:
        """Compile for numpy; where the bits are the same, OpenCL may follow."""
        quick = backend_named(QUICK).compile(module, replace(options, lanes="auto"))
        return TieredExecutable(quick, module, options) if options.math in REPRODUCIBLE else quick

    def space(self, device: int | None) -> Space:
        """Return numpy's memory."""
        return backend_named(QUICK).space(None)


class TieredExecutable:
    """An executable of numpy until one of OpenCL takes over: see `base.Executable`. Threads may share it."""

    def __init__(self, quick: Any, module: Module, options: Options) -> None:
        self._quick, self._module, self._options = quick, module, options
        self._statements = statements_of(quick)
        self._better: Executable | None = None
        self._refusal: str | None = None
        self._compiling = threading.Lock()
        self._spent = 0.0
        self._small_calls = 0
        self._elements, self._seconds = 0, 0.0
        """Elements that numpy ran in long calls, and the seconds that these took."""
        self._fewest = 0
        self._trials: list[float] = []
        """Seconds for each element of OpenCL's first calls."""
        self._worth = self.expected(cached=True)
        """Seconds, with those of other programs, from which on compiling is considered next."""
        self._earlier: int | None = None
        """Parts of the cost of compiling that earlier processes spent; None before they are read."""

    def expected(self, *, cached: bool) -> float:
        """Return the seconds that compiling for OpenCL is expected to take, `cached` in the driver's files or not."""
        return expected([(self._statements, cached)], starts=True)

    def _spend(self, seconds: float) -> None:
        """Count seconds that numpy spent on this program."""
        global _in_all
        self._spent += seconds
        _in_all += seconds

    def _shared(self, *, cached: bool) -> float:
        """Return the seconds of OpenCL's start that other programs have paid, or all of them if it has started."""
        start = _start(cached=cached)
        return start if is_open() else min(start, _in_all - self._spent)

    def _is_due(self, total: float) -> bool:
        """Return whether numpy's `total` seconds may pay for OpenCL."""
        return total + self._shared(cached=True) >= self._worth

    @property
    def runs_on(self) -> str:
        """The name of the backend in use."""
        return QUICK if self._better is None else BETTER

    @property
    def _current(self) -> Executable:
        return self._better or self._quick

    @property
    def source(self) -> str:
        """The text in use."""
        return self._current.source

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the notes of the backend in use, and why it is in use."""
        if self._better is not None:
            why = f"runs on {BETTER}, after {self._spent:.1f} s on {QUICK}"
        elif self._refusal is not None:
            why = f"runs on {QUICK}: {self._refusal}"
        else:
            why = f"runs on {QUICK}, for {self._spent:.1f} s so far; {BETTER} follows where it pays"
        return (*self._current.notes, why)

    @property
    def loops(self) -> tuple[Loc | None, ...]:
        """The lines of the limited loops, which are the same on both."""
        return self._quick.loops  # type: ignore[no-any-return]

    @property
    def writes_all(self) -> bool:
        """Return whether every element is written, which is the same on both."""
        return self._quick.writes_all  # type: ignore[no-any-return]

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over streams, which are numpy's."""
        return self._quick.ready(call, once=once)  # type: ignore[no-any-return]

    def run(self, call: Call) -> Array | None:
        """Run on the backend in use; where OpenCL takes over in the middle of a call, it runs the whole call again."""
        if self._better is not None and call.count >= self._fewest:
            return self._run_better(call)
        if self._better is not None or self._refusal is not None:
            return self._quick.run(call)  # type: ignore[no-any-return]
        if call.count <= _SMALL:
            return self._run_small(call)
        ended, status = self._run_long(call)
        return status if ended else self._run_better(call)

    def _run_small(self, call: Call) -> Array | None:
        self._small_calls += 1
        if self._small_calls % _SAMPLE:
            return self._quick.run(call)  # type: ignore[no-any-return]
        start = time.thread_time()
        status: Array | None = self._quick.run(call)
        seconds = time.thread_time() - start
        self._spend(_SAMPLE * seconds)
        self._elements, self._seconds = self._elements + call.count, self._seconds + seconds
        if self._is_due(self._spent):
            self._take_over(self._spent)
        return status

    def _run_long(self, call: Call) -> tuple[bool, Array | None]:
        """Run on numpy until OpenCL takes over; return whether that was to the end, and the statuses."""
        start = last = time.thread_time()

        def stop(done: int) -> bool:
            nonlocal last
            now = time.thread_time()
            if now - last < _LOOK:
                return False
            self._spend(now - last)
            last = now
            rest = (now - start) / done * (call.count - done)
            total = self._spent + rest
            if not self._is_due(total):
                return False
            self._elements, self._seconds = self._elements + done, self._seconds + now - start
            return self._take_over(total)

        ended, status = self._quick.run_until(call, stop, self._first_tile())
        if ended:
            now = time.thread_time()
            self._spend(now - last)
            self._elements, self._seconds = self._elements + call.count, self._seconds + now - start
            if self._is_due(self._spent):
                self._take_over(self._spent)
        return ended, status

    def _first_tile(self) -> int:
        """Return the elements of a call's first tile, which are expected to take less time than compiling for OpenCL.

        The time of a tile of the usual size may be anything: 65,536 rays in random directions took four minutes, where
        OpenCL took .3 s with its compilation. Sizes are few, since the tiles of a shape are kept.
        """
        count = _SMALL
        while self._elements and count < _LARGE and 4 * count * self._seconds < self._worth * self._elements:
            count *= 4
        return count

    def _take_over(self, total: float) -> bool:
        """Compile for OpenCL if numpy's `total` seconds pay for it; return whether OpenCL is in use.

        Other threads go on with numpy meanwhile.
        """
        if self._compiling.locked():
            return False
        with self._compiling:  # Ctrl-C may come between a call of `acquire` and `try`
            if self._better is None and self._refusal is None:
                self._compile(total)
        return self._better is not None

    def _compile(self, total: float) -> None:
        if not is_installed():
            self._refuse(MISSING)
            return
        text = self._text
        if not was_compiled(text) and not self._has_paid(total):
            return
        before = sys.exception()
        try:
            opencl: Any = backend_named(BETTER)
            if (fault := fault_of(opencl, self._options.device)) is not None:
                self._refuse(fault)
                return
            with ieee_arithmetic(), uncollected(), announced(self._module, BETTER):
                better = opencl.compile(self._module, self._options)
        except Exception as error:  # drivers raise errors of any type
            raise_interrupt(error, before)
            self._refuse(REFUSES.format(said(error)))
            return
        remember_compiled(text)
        # Threads read it without the lock.
        self._fewest = round(_LAUNCH / (self._seconds / self._elements)) if self._seconds else 0
        self._better = better

    def _has_paid(self, total: float) -> bool:
        """Return whether numpy's seconds, with those of others, reach the cost of a text without a binary.

        Others are earlier processes, for this program, and other programs of this process, for the start of OpenCL. If
        not, remember how many parts of the cost this program paid.
        """
        from shpy.backend.device import store

        cost, names = self.expected(cached=False), [f"{self._text}+{n}" for n in range(_PARTS)]
        if self._earlier is None:
            self._earlier = max(n for n in range(_PARTS) if not n or store.is_remembered(_SPENT, names[n]))
        seconds = self._earlier * cost / _PARTS + total
        if seconds + self._shared(cached=False) >= cost:
            return True
        parts = int(_PARTS * seconds / cost)
        if parts > self._earlier:
            store.remember(_SPENT, names[parts])
        self._worth = total + self._shared(cached=True) + cost / _PARTS
        return False

    @cached_property
    def _text(self) -> str:
        return text_of(self._module, self._options)

    def _run_better(self, call: Call) -> Array | None:
        better = self._better
        if better is None:  # another thread has refused it meanwhile
            return self._quick.run(call)  # type: ignore[no-any-return]
        before = sys.exception()
        try:
            # A kernel that is not optimized yet is no judge: raymarch (1,204 statements) then takes .7 of numpy's CPU
            # time, and on a busy machine longer than numpy.
            if len(self._trials) >= _TRIED or not self._seconds or getattr(better, "hurried", False):
                return better.run(call)
            start = time.perf_counter()
            status = better.run(call)
        except Exception as error:  # for instance, too little memory on the device
            raise_interrupt(error, before)
            self._refuse(f"{BETTER} gave an error ({said(error)})")
            if call.fresh:
                for out in call.outputs:
                    out.fill(0)
            return self._quick.run(call)  # type: ignore[no-any-return]
        self._trials.append((time.perf_counter() - start) / call.count)
        if is_slower(self._trials, self._seconds / self._elements):
            self._refuse(SLOWER)
        return status

    def _refuse(self, reason: str) -> None:
        """Go on with numpy for good."""
        self._better, self._refusal = None, reason


def statements_of(quick: Any) -> int:
    """Return the statements of a program that numpy has prepared."""
    return sum(1 for f in quick.prepared.module.functions for _ in walk(f.body))


def expected(programs: Iterable[tuple[int, bool]], *, starts: bool | None = None) -> float:
    """Return the seconds that compiling for OpenCL is expected to take.

    Of each program: its statements, and whether the driver has its binary in its files. `starts` tells whether OpenCL
    has to be opened; None: what holds now.
    """
    seconds, is_cold = 0.0, False
    for statements, cached in programs:
        once, each = _CACHED if cached else _COLD
        seconds += once + each * statements
        is_cold |= not cached
    return seconds + (_start(cached=not is_cold) if (not is_open() if starts is None else starts) else 0.0)


def _start(*, cached: bool) -> float:
    """Return the seconds of OpenCL's start, and unless programs are `cached`, of the start of its compiler."""
    return _START if cached else _START + _COMPILER


def is_open() -> bool:
    """Return whether this process has loaded OpenCL."""
    return "pyopencl" in sys.modules


def is_installed() -> bool:
    """Return whether there is a package for OpenCL."""
    return importlib.util.find_spec("pyopencl") is not None


def fault_of(opencl: Any, device: int | None) -> str | None:
    """Return why OpenCL may not go on with numpy's work, or None; a worker process keeps it to one core."""
    from shpy.backend.opencl.device.loading import keep_to_one_core

    if _is_worker():
        keep_to_one_core()
    faults = opencl.faults(device)
    return f"{BETTER}'s device gets {' and '.join(sorted(faults))} wrong" if faults else None


def text_of(module: Module, options: Options) -> str:
    """Return the key of a program's text in the lists of texts."""
    from shpy.backend.device import store

    return store.key(print_module(module), repr(options))


def was_compiled(text: str) -> bool:
    """Return whether the driver is expected to have the binary of a text."""
    from shpy.backend.device import store

    return store.is_remembered(_COMPILED, text)


def remember_compiled(text: str) -> None:
    """Note that the driver has compiled a text."""
    from shpy.backend.device import store

    store.remember(_COMPILED, text)


def is_brief(seconds: float) -> bool:
    """Return whether OpenCL's shortest call takes longer."""
    return seconds < _LAUNCH


def is_slower(trials: list[float], seconds: float) -> bool:
    """Return whether OpenCL's first calls, now complete, took more than numpy's seconds; both of an element."""
    return len(trials) == _TRIED and min(trials) > seconds


def _is_worker() -> bool:
    """Return whether this is a process of `multiprocessing`, which then has the module: its import takes 11 ms."""
    process: Any = sys.modules.get("multiprocessing.process")
    return process is not None and process.parent_process() is not None


def said(error: Exception) -> str:
    """Return what an error says, in a note."""
    return error.message if isinstance(error, ShpyError) else f"{type(error).__name__}: {error}"


auto: Final = AutoBackend()
