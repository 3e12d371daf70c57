"""Measure the overhead of a call: x + 1 of 64 numbers, from an array to an array.

python -m benchmarks --only calls
"""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.rounds import Apart, in_turns, peer_run
from benchmarks.tables import Setup, Table
from benchmarks.work import Run

COUNT = 64
ROUNDS = 14
CALLS = 200
STEPS = 100
"""Kernels of a chain, of which the table shows one."""


@sh.program
def increment(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + 1


def calls(setup: Setup) -> Table:
    """Microseconds of a call: the median of the rounds' means, their quartiles, and the best mean."""
    x = np.arange(COUNT, dtype=np.float32)
    runs: dict[str, tuple[Run | Apart, int]] = {"shpy, plain call": (lambda: increment(x), 1)}
    for info in sh.backends():
        if info.available:
            runs |= _ours(info.name, x)
    rounds = 2 if setup.quick else ROUNDS
    with ExitStack() as ending:
        for name in setup.installed(*PEERS):
            label, make = PEERS[name]
            runs[label] = ending.enter_context(peer_run(name, make, x)), 1
        calls = {name: 5 if setup.quick else max(CALLS // parts, 10) for name, (_, parts) in runs.items()}
        warm = {name: run for name, (run, _) in runs.items()}
        in_turns(warm, 1, calls)  # compiles and settles
        seconds = {name: np.divide(t.seconds, runs[name][1]) for name, t in in_turns(warm, rounds, calls).items()}
    rows = []
    for name, means in seconds.items():
        low, middle, high = np.percentile(1e6 * means, (25, 50, 75))
        rows.append([name, f"{middle:.1f}", f"{low:.1f} to {high:.1f}", f"{1e6 * means.min():.1f}"])
    note = (
        f"Microseconds of a call of x + 1 over {COUNT} float32 numbers: the median of {rounds} rounds of {CALLS} "
        f"calls, the quartiles, the best round. Of a chain of {STEPS} kernels, one kernel."
    )
    means_by_name = {name: means.tolist() for name, means in seconds.items()}
    return Table("calls", note, ["call", "median", "quartiles", "best"], rows, means_by_name)


def _ours(backend: str, x: np.ndarray) -> dict[str, tuple[Run, int]]:
    kernel, out = increment.compile(backend), np.empty_like(x)
    stream = sh.Stream(x, sh.Attrib1f, backend)
    chain = sh.repeat(kernel, STEPS)

    def streamed() -> Any:
        answer = kernel(stream)
        answer.place.space.finish()
        return answer

    def chained() -> Any:
        answer = chain.run(x=stream).streams["x"]
        answer.place.space.finish()
        return answer

    return {
        f"shpy, {backend}": (lambda: kernel(x), 1),
        f"shpy, {backend}, out=": (lambda: kernel.run(x, out=out), 1),
        f"shpy, {backend}, streams": (streamed, 1),
        f"shpy, {backend}, in a chain": (chained, STEPS),
    }


def _numpy(x: np.ndarray) -> Run:
    return lambda: x + np.float32(1)


def _numba(x: np.ndarray) -> Run:
    from numba import vectorize

    function = vectorize(["float32(float32)"])(lambda a: a + np.float32(1))
    return lambda: function(x)


def _jax(x: np.ndarray) -> Run:
    import jax

    function = jax.jit(lambda a: a + np.float32(1))
    return lambda: np.asarray(function(x))


PEERS: dict[str, tuple[str, Callable[..., Run]]] = {
    "masks": ("numpy", _numpy),
    "numba": ("numba", _numba),
    "jax": ("JAX", _jax),
}
