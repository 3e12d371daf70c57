"""Sum, scan, sort and compact of ten million floats that lie where the contender works: nothing is copied to it.

Every version takes x (n,), float32 in [-1, 1), and gives the sum, the prefix sums, the sorted numbers, or those above
0; arrays stay where they are made, and time ends when they are there. Sums differ by their order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.work import Run, Work


def numbers(size: int) -> tuple[np.ndarray]:
    return (np.random.default_rng(3).random(size, np.float32) * 2 - 1,)


def _work(name: str, title: str, within: float) -> Work:
    title = f"{title} of {{size}} numbers"
    return Work(name, title, numbers, size=10_000_000, quick=5_000, within=within)


SUM = _work("sum", "Pairwise sum", 1e-3)
SCAN = _work("scan", "Prefix sums", 2e-2)
SCAN.exact = lambda x: np.cumsum(x, dtype=np.float64)
SORT = _work("sort", "Sorting", 0)
COMPACT = _work("compact", "Those above 0", 0)
WORKS = (SUM, SCAN, SORT, COMPACT)


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@sh.program
def positive(x: sh.Attrib1f) -> sh.Attrib1b:
    return x > 0


def _ours(work: Work, operation: Callable[[sh.Stream], Any]) -> None:
    @work.ours_on("opencl", "plain", "glsl", "numpy")
    def ours(compiled: Callable[..., sh.Kernel], x: np.ndarray) -> Run:
        stream = sh.Stream(x, sh.Attrib1f, getattr(compiled(add), "backend", None))

        def run() -> Any:
            answer = operation(stream)
            if isinstance(answer, sh.Stream):
                answer.place.space.finish()
            return answer

        return run


_ours(SUM, lambda x: x.sum())
_ours(SCAN, lambda x: sh.scan(add, x))
_ours(SORT, sh.sort)
_ours(COMPACT, lambda x: sh.compact(x, positive(x))[0])


def _numpy(name: str, x: np.ndarray) -> Run:
    functions: dict[str, Callable[[np.ndarray], Any]]
    functions = {"sum": np.sum, "scan": np.cumsum, "sort": np.sort, "compact": lambda x: x[x > 0]}
    return lambda: functions[name](x)


def _jax(name: str, x: np.ndarray) -> Run:
    import jax
    import jax.numpy as jnp

    functions = {"sum": jnp.sum, "scan": jnp.cumsum, "sort": jnp.sort, "compact": lambda a: a[a > 0]}
    function = functions[name] if name == "compact" else jax.jit(functions[name])
    there = jnp.asarray(x)
    return lambda: function(there).block_until_ready()


def _numba(name: str, x: np.ndarray) -> Run:
    from numba import njit, prange

    @njit(parallel=True, fastmath=True)
    def total(a: Any) -> Any:
        result = np.float32(0)
        for i in prange(len(a)):
            result += a[i]
        return result

    @njit(fastmath=True)
    def prefixes(a: Any) -> Any:
        sums = np.empty_like(a)
        so_far = np.float32(0)
        for i in range(len(a)):
            so_far += a[i]
            sums[i] = so_far
        return sums

    functions = {
        "sum": total,
        "scan": prefixes,
        "sort": njit(lambda a: np.sort(a)),
        "compact": njit(lambda a: a[a > 0]),
    }
    return lambda: functions[name](x)


for _of in WORKS:
    for _peer, _version in {"masks": _numpy, "jax": _jax, "numba": _numba}.items():
        _of.version(_peer)(lambda x, name=_of.name, version=_version: version(name, x))
