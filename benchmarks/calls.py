"""Measure the overhead of a call: x + 1 of 64 numbers, from an array to an array.

python -m benchmarks --only calls
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.rounds import PAUSE, once
from benchmarks.tables import Table
from benchmarks.work import Run
from raytracer import Mesh

COUNT = 64
ROUNDS = 15
CALLS = 200
STEPS = 100
"""Kernels of a chain, of which the table shows one."""


@sh.program
def increment(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + 1


def calls(mesh: Mesh, quick: bool) -> Table:
    """Microseconds of a call: the median of the rounds' means, their quartiles, and the best mean."""
    x = np.arange(COUNT, dtype=np.float32)
    runs: dict[str, tuple[Run, int]] = {}
    for info in sh.backends():
        if info.available:
            runs |= _ours(info.name, x)
    for name, make in PEERS.items():
        try:
            runs[name] = make(x), 1
        except ImportError:
            continue
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for number in range(3 if quick else ROUNDS):
        for name, (run, parts) in runs.items():
            time.sleep(PAUSE)
            count = 5 if quick else max(CALLS // parts, 10)
            mean = sum(once(run) for _ in range(count)) / count / parts
            if number:  # the first round compiles and settles
                seconds[name].append(1e6 * mean)
    rows = []
    for name, means in seconds.items():
        low, middle, high = np.percentile(means, (25, 50, 75))
        rows.append([name, f"{middle:.1f}", f"{low:.1f} to {high:.1f}", f"{min(means):.1f}"])
    note = (
        f"Microseconds of a call of x + 1 over {COUNT} float32 numbers: the median of {ROUNDS - 1} rounds of {CALLS} "
        f"calls, the quartiles, the best round. Of a chain of {STEPS} kernels, one kernel."
    )
    return Table("calls", note, ["call", "median", "quartiles", "best"], rows)


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


PEERS: dict[str, Callable[[np.ndarray], Run]] = {"numpy": _numpy, "numba": _numba, "JAX": _jax}
