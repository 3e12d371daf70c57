"""Time contenders in turns: each runs once in every round, so that other work on the machine slows all of them.

    measured = run(MANDELBROT, 1024, ["opencl", "masks", "numba"], rounds=7)
    measured.ratios("numba", "opencl")     # how many times as long numba took as opencl, one number a round

Each contender is warmed up first, which compiles what is compiled; its answer is then compared with the reference. A
sample is the mean over as many calls as take `ENOUGH` seconds, after one more unless they are long. Peers run in
processes of their own, since their threads look for work for a while after a call and slow down the other threads of
their process; a pause lets them fall asleep. On a machine that does other work too, threads wait for each other and
medians tell about that work as well. The best single call of all rounds then tells more, and so does the CPU time,
though threads that look for work count there too.
"""

from __future__ import annotations

import gc
import math
import multiprocessing
import signal
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.work import OURS, Agreement, Run, Work, judge

ENOUGH = 0.02
SETTLED = 3.0
"""Seconds of plain calls before the first round: the default backend has then gone on to OpenCL where that pays."""
LONG = 0.5
"""Seconds of a call that is timed without another one before it."""
PAUSE = 0.03
"""Seconds: Dr.Jit's threads look for work for 15 to 20 ms, and slow down by a third who comes after them till then."""
LIMIT, ENDING = 600.0, 10.0
"""Seconds that a peer has for an answer, compilation included, and for the end of its process."""


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

    def fail(self, contender: str, error: Exception) -> None:
        """Note that a contender failed, and drop its times, which lack rounds."""
        self.failed[contender] = reason(error)
        traceback.print_exc(limit=-3)
        for times in (self.seconds, self.cpu, self.best, self.agreement, self.first):
            times.pop(contender, None)

    def ratios(self, contender: str, base: str) -> np.ndarray:
        """Return the ratio of the times of `contender` and `base`, a number for each round."""
        return np.divide(self.seconds[contender], self.seconds[base])


def once(run: Run) -> float:
    """Return the seconds of one call."""
    started = time.perf_counter()
    run()
    return time.perf_counter() - started


@dataclass
class Times:
    """The seconds of each round, and the CPU seconds of all threads of the process."""

    seconds: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)


def sample(run: Run, calls: int) -> tuple[list[float], float]:
    """Return the seconds of each call, and the CPU seconds of one."""
    busy = time.process_time()
    durations = [once(run) for _ in range(calls)]
    return durations, (time.process_time() - busy) / calls


def in_turns(runs: Mapping[str, Run | Apart], rounds: int, calls: Mapping[str, int] | None = None) -> dict[str, Times]:
    """Time runs in turns: in each round a pause, a warm-up call, and the mean of one timed call, or of `calls`.

    A run may be a `PeerRun` in a process of its own.
    """
    times = {name: Times() for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            count = calls[name] if calls else 1
            time.sleep(PAUSE)
            durations, busy = run(count) if isinstance(run, Apart) else (run(), sample(run, count))[1]
            times[name].seconds.append(sum(durations) / count)
            times[name].cpu.append(busy)
    return times


class Failed(Exception):
    """Raised for an error in another process, or for its end."""


def reason(error: Exception) -> str:
    """Return the first line of an error, after its type unless another process named that."""
    text = str(error) if isinstance(error, Failed) else f"{type(error).__name__}: {error}"
    return text.splitlines()[0]


class Ready:
    """A version of a work, compiled."""

    def __init__(self, find: Callable[[str], Work], size: int, name: str) -> None:
        work = find(name)
        inputs = work.inputs(size)
        started = time.perf_counter()
        self.run = work.versions[name](*inputs)
        answer = self.run()
        self.least = self.first = time.perf_counter() - started
        self.answer = np.array(answer.get() if hasattr(answer, "get") else answer)

    def __call__(self, calls: int | None) -> Any:
        """Return the seconds of the first call and its answer, or for a number of `calls` their `sample`.

        A call that is not timed comes before it, unless one takes longer than LONG: while others had their turns,
        caches have lost this contender's data, and a system may have reclaimed its memory.
        """
        if calls is None:
            return self.first, self.answer
        if self.least < LONG:
            self.run()
        durations, busy = sample(self.run, calls)
        self.least = min(self.least, *durations)
        return durations, busy


class PeerRun:
    """A run of a peer, which `make` makes of `arguments` once the peer has started."""

    def __init__(self, peer: str, make: Callable[..., Run], arguments: Sequence[Any]) -> None:
        peers.start(peer)
        self.run = make(*arguments)

    def __call__(self, calls: int) -> Any:
        """Return the numbers of a call, or for a number of `calls` above 0 their `sample` after a warm-up call."""
        result = self.run()
        return sample(self.run, calls) if calls else list(_arrays(result))


def _arrays(result: Any) -> Iterator[np.ndarray]:
    """Yield the arrays of a peer's result."""
    if isinstance(result, tuple | list):
        for part in result:
            yield from _arrays(part)
    else:
        yield np.array(result)


def peer_run(peer: str, make: Callable[..., Run], *arguments: Any) -> Apart:
    """Return a `PeerRun` in a process of its own."""
    return Apart(partial(PeerRun, peer, make, arguments), f"{peers.PEERS[peer].label}: ")


class Apart:
    """A function in a new process, which makes it by `make`, a pickle; the process ends with the `with` block.

    Errors begin with `label`.
    """

    def __init__(self, make: Callable[[], Callable[[Any], Any]], label: str = "") -> None:
        self.label = label
        context = multiprocessing.get_context("spawn")
        self.pipe, there = context.Pipe()
        self.process = context.Process(target=_serve, args=(there,), daemon=True)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        self.process.start()  # Ctrl-C does not reach it: it ends when its pipe closes
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        there.close()
        self.pipe.send(make)

    def __enter__(self) -> Apart:
        return self

    def __call__(self, argument: Any) -> Any:
        """Call the function; raise Failed with its error, or with the signal or the status that ended its process.

        A process that does not answer within LIMIT is killed.
        """
        try:
            self.pipe.send(argument)
            if not self.pipe.poll(LIMIT):
                self.process.kill()
                raise Failed(f"{self.label}it gave no answer in {LIMIT:g} s")
            result, error = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            status = self.process.exitcode or 0
            how = signal.Signals(-status).name if status < 0 else f"exit status {status}"
            raise Failed(f"{self.label}its process ended by {how}") from None
        if error:
            raise Failed(self.label + error)
        return result

    def __exit__(self, error: object, *_: object) -> None:
        self.pipe.close()
        self.process.join(ENDING if error is None else 0)
        self.process.kill()
        self.process.join()


def _serve(pipe: Connection) -> None:
    function = None
    with suppress(EOFError, OSError):
        make = pipe.recv()
        while True:
            argument = pipe.recv()
            try:
                function = function or make()
                pipe.send((function(argument), ""))
            except Exception as error:
                traceback.print_exc(limit=-3)
                pipe.send((None, f"{type(error).__name__}: {error}"))


def run(
    work: Work,
    size: int,
    contenders: Sequence[str],
    rounds: int,
    say: Callable[[str], None] = lambda _: None,
    find: Callable[[str], Work] | None = None,
) -> Measured:
    """Measure a benchmark. A contender that raises an error, or whose process ends, is noted and left out.

    `find` gives the work in the process of a peer, by the peer's name; without it all contenders run in this process.
    """
    measured, ready = Measured(work, size), {}
    inputs = work.inputs(size)
    reference = np.array(work.versions["masks"](*inputs)()) if "masks" in work.versions else None
    with ExitStack() as ending:
        for name in (c for c in contenders if c in work.versions):
            say(f"{work.name}: {name}")
            contender: Ready | Apart
            try:
                if find is None or name in OURS:
                    contender = Ready(lambda _: work, size, name)
                else:
                    contender = ending.enter_context(Apart(partial(Ready, find, size, name)))
                measured.first[name], result = contender(None)
                trial, _ = contender(2)
                if name == "plain" and rounds:
                    contender(math.ceil(SETTLED / min(trial)))
                    trial, _ = contender(2)  # of the backend on which it has settled
            except Exception as error:
                measured.fail(name, error)
                continue
            reference = result if reference is None else reference
            measured.agreement[name] = judge(work, result, reference, inputs)
            ready[name] = (contender, max(1, math.ceil(ENOUGH / max(min(trial), 1e-6))))
            measured.seconds[name], measured.cpu[name] = [], []
        gc.collect()
        for number in range(rounds):
            say(f"{work.name}: round {number + 1} of {rounds}")
            for name, (contender, calls) in list(ready.items()):
                time.sleep(PAUSE)
                try:
                    durations, busy = contender(calls)
                except Exception as error:
                    measured.fail(name, error)
                    del ready[name]
                    continue
                measured.cpu[name].append(busy)
                measured.seconds[name].append(sum(durations) / calls)
                measured.best[name] = min(measured.best.get(name, math.inf), *durations)
    return measured
