"""Chains that name no backend: numpy runs them, and OpenCL with the same bits from when compiling for it has paid.

Stage: run. The policy is that of programs (`run.tiers`): numpy runs the kernels until the seconds spent on them, and on
the rest of a chain that repeats, reach what compiling them for OpenCL is expected to cost. Seconds of earlier processes
do not count. A chain only reads the caller's arrays, so OpenCL runs all of it again. Its streams are then copied to
numpy's memory, where streams lie by default: the place of a result does not depend on the time that a run has taken.
500 steps of Jacobi's iteration over 1,024 x 1,024 take 0.6 s the first time and 0.14 s from then on; on numpy 1.2 s.

    chain.run(u=image)          # chain.runs_on == "numpy"
    chain.run(u=large)          # "opencl", from the pass on that is expected to pay
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from shpy.backend.registry import backend as backend_named
from shpy.errors import LoopLimitExceeded, raise_interrupt
from shpy.run import tiers
from shpy.run.kernel import Kernel, forget_data
from shpy.run.tiers import BETTER, QUICK
from shpy.streams.stream import Stream

if TYPE_CHECKING:
    from shpy.chains.running import ChainResult, Run


class Paid(Exception):
    """numpy's seconds pay for compiling a chain for OpenCL, which begins it again."""


class Takeover:
    """Tells where the runs of a chain go; threads may share it."""

    def __init__(self) -> None:
        self._refusal: str | None = None
        self._better = False
        self._was_small = False
        self._spent = 0.0
        self._rate = 0.0
        """numpy's seconds for each element of each run of a kernel."""
        self._trials: list[float] = []
        """The same of OpenCL's first runs of the chain."""
        self._worth: float | None = None
        """Seconds that compiling is expected to take; None before the kernels are known."""
        self._is_exact = False
        """True once that follows from the driver's files, too, which take longer to ask."""

    @property
    def runs_on(self) -> str:
        """The name of the backend in use."""
        return BETTER if self._better else QUICK

    @property
    def note(self) -> str:
        """The reason why that backend is in use."""
        if self._better:
            return f"runs on {BETTER}, after {self._spent:.1f} s on {QUICK}"
        if self._refusal is not None:
            return f"runs on {QUICK}: {self._refusal}"
        return f"runs on {QUICK}, for {self._spent:.1f} s so far; {BETTER} follows where it pays"

    def __reduce__(self) -> Any:
        """Begin anew in another process."""
        return Takeover, ()

    def result(self, begin: Callable[[str], Run]) -> ChainResult:
        """Run a chain; `begin` returns a run over the caller's arrays on the backend of a name."""
        if self._better and not self._was_small:
            return self._run_better(begin)
        run = begin(QUICK)
        if self._better and not self._is_small(run):
            return self._run_better(begin)
        if not self._better and self._refusal is None and run.elements:
            run.watch = self._watch(run.elements)
        with suppress(Paid):
            return run.result()
        del run  # its streams, before OpenCL has its own
        return self._run_better(begin)

    def _is_small(self, run: Run) -> bool:
        """Return whether numpy runs a kernel in less time than OpenCL's shortest call takes."""
        self._was_small = tiers.is_brief(run.elements * self._rate)
        return self._was_small

    def _watch(self, elements: int) -> Callable[[Run], None]:
        """Return the function that raises Paid in the middle of a run on numpy. It does not hold the run's memory."""
        start = last = time.thread_time()

        def watch(run: Run) -> None:
            nonlocal last
            now = time.thread_time()
            self._spent, last = self._spent + now - last, now
            self._rate = (now - start) / (elements * run.started)
            rest = (now - start) * (1 - run.share) / run.share if run.share else 0.0
            if self._pays(run, self._spent + rest):
                raise Paid

        return watch

    def _pays(self, run: Run, seconds: float) -> bool:
        """Return whether numpy's seconds reach what compiling the kernels of a run is expected to take."""
        if self._worth is None:
            self._worth = tiers.expected([(_statements(kernel), True) for kernel in run.kernels])
        if seconds < self._worth or self._refusal is not None:
            return False
        if not self._is_exact:
            if not tiers.is_installed():
                self._refusal = tiers.MISSING
                return False
            programs = [(_statements(kernel), tiers.was_compiled(_text(kernel))) for kernel in run.kernels]
            self._worth, self._is_exact = tiers.expected(programs), True
        return seconds >= self._worth

    def _run_better(self, begin: Callable[[str], Run]) -> ChainResult:
        """Run the chain on OpenCL, or on numpy where OpenCL may not, cannot, or would take longer."""
        before, refusal = sys.exception(), None
        try:
            result = self._run_on_opencl(begin)
        except LoopLimitExceeded as error:
            if error.result is not None:
                error.result.streams = _copied(error.result.streams)
            raise
        except Exception as error:  # drivers raise errors of any type
            raise_interrupt(error, before)
            result, refusal = None, tiers.REFUSES.format(tiers.said(error))
        if result is None:
            result = begin(QUICK).result()  # raises the caller's own mistakes again
        if refusal is not None:
            self._better, self._refusal = False, refusal
        return result

    def _run_on_opencl(self, begin: Callable[[str], Run]) -> ChainResult | None:
        """Run the chain on OpenCL; return None where numpy is to run it."""
        opencl: Any = backend_named(BETTER)
        is_first = not self._better
        if is_first and (fault := tiers.fault_of(opencl, None)) is not None:
            self._refusal = fault
            return None
        start = time.perf_counter()
        run = begin(BETTER)
        if is_first:
            for kernel in run.kernels:
                tiers.remember_compiled(_text(kernel))
            self._better = True
        if self._is_small(run):
            return None
        result = run.result()
        result.streams = _copied(result.streams)
        if not (is_first or any(_is_hurried(kernel) for kernel in run.kernels)):
            self._trials.append((time.perf_counter() - start) / (run.elements * max(1, run.started)))
            if tiers.is_slower(self._trials, self._rate):
                self._better, self._refusal = False, tiers.SLOWER
        return result


def _is_hurried(kernel: Kernel) -> bool:
    return getattr(kernel._executable, "hurried", False)


def _statements(kernel: Kernel) -> int:
    return tiers.statements_of(kernel._executable)


def _text(kernel: Kernel) -> str:
    return tiers.text_of(forget_data(kernel.recorded.module), kernel.options)


def _copied(streams: dict[str, Stream]) -> dict[str, Stream]:
    """Return streams with the same elements where streams lie by default."""
    return {name: stream.to(QUICK) for name, stream in streams.items()}
