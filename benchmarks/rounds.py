"""Time contenders in turns: each runs once in every round, so that other work on the machine slows all of them.

    measured = run(MANDELBROT, 1024, ["opencl", "masks", "numba"], rounds=7)
    measured.ratios("numba", "opencl")     # how many times as long numba took as opencl, one number a round

Each contender is warmed up first, which compiles what is compiled; its answer is then compared with the reference. A
sample is the mean over as many calls as take `ENOUGH` seconds. Between contenders there is a pause, in which the
threads of the one before, which look for work for a while, fall asleep. On a machine that does other work too, threads
wait for each other and medians tell about that work as well. The best single call of all rounds then tells more, and so
does the time that all threads of the process spent computing, though threads that only look for work count there too.
"""

from __future__ import annotations

import gc
import math
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.work import Agreement, Run, Work, judge

ENOUGH = 0.02
PAUSE = 0.03
"""Seconds: Dr.Jit's threads look for work for 15 to 20 ms, and slow down by a third who comes after them till then."""


@dataclass
class Measured:
    """The times of one benchmark.

    `seconds` has for each contender one number per round, `cpu` the CPU seconds of all threads, and `best` the single
    fastest call. `first` is the time of the first call, compilation included. The answers are compared with the
    reference; contenders that failed are listed with the error.
    """

    work: Work
    size: int
    seconds: dict[str, list[float]] = field(default_factory=dict)
    cpu: dict[str, list[float]] = field(default_factory=dict)
    best: dict[str, float] = field(default_factory=dict)
    agreement: dict[str, Agreement] = field(default_factory=dict)
    first: dict[str, float] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    @property
    def right(self) -> bool:
        """Return whether all answers agree and nobody failed."""
        return not self.failed and all(a.same for a in self.agreement.values())

    def ratios(self, contender: str, base: str) -> np.ndarray:
        """Return the ratio of the times of `contender` and `base`, a number for each round."""
        return np.divide(self.seconds[contender], self.seconds[base])


def once(run: Run) -> float:
    """Return the seconds of one call."""
    started = time.perf_counter()
    run()
    return time.perf_counter() - started


def run(
    work: Work, size: int, contenders: Sequence[str], rounds: int, say: Callable[[str], None] = lambda _: None
) -> Measured:
    """Measure a benchmark. A contender that raises an error is noted and left out."""
    measured, ready = Measured(work, size), {}
    inputs = work.inputs(size)
    reference = np.array(work.versions["masks"](*inputs)()) if "masks" in work.versions else None
    contenders = [c for c in contenders if c in work.versions]
    for name in contenders:
        say(f"{work.name}: {name}")
        started = time.perf_counter()
        try:
            timed = work.versions[name](*inputs)
            answer = timed()
        except Exception as error:
            measured.failed[name] = f"{type(error).__name__}: {error}".splitlines()[0]
            traceback.print_exc(limit=-3)
            continue
        measured.first[name] = time.perf_counter() - started
        answer = np.array(answer.get() if hasattr(answer, "get") else answer)
        reference = answer if reference is None else reference
        measured.agreement[name] = judge(work, answer, reference, inputs)
        ready[name] = (timed, max(1, math.ceil(ENOUGH / max(min(once(timed), once(timed)), 1e-6))))
        measured.seconds[name], measured.cpu[name] = [], []
    gc.collect()
    for number in range(rounds):
        say(f"{work.name}: round {number + 1} of {rounds}")
        for name, (timed, calls) in ready.items():
            time.sleep(PAUSE)
            busy = time.process_time()
            durations = [once(timed) for _ in range(calls)]
            measured.cpu[name].append((time.process_time() - busy) / calls)
            measured.seconds[name].append(sum(durations) / calls)
            measured.best[name] = min(measured.best.get(name, math.inf), *durations)
    return measured
