"""Sum, scan, sort and compact of ten million floats that lie where the contender works: nothing is copied to it.

Sums and scans of ten thousand are beside the time of a launch, which is what a device needs for anything at all.

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


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


def _work(name: str, title: str, within: float, note: str = "", size: int = 10_000_000) -> Work:
    return Work(
        name,
        f"{title} of {{size}} numbers",
        inputs=numbers,
        size=size,
        quick=5_000,
        within=within,
        note=note,
        group="collectives",
    )


SUM = _work("sum", "Pairwise sum", 1e-3)
SUM_EXACT = _work("sum-exact", "Sum, rounded once,", 1e-6, 'Ours is method="exact"; that of numpy is math.fsum.')
SCAN = _work("scan", "Prefix sums", 2e-2)
SCAN.exact = lambda x: np.cumsum(x, dtype=np.float64)
SORT = _work("sort", "Sorting", 0)
COMPACT = _work("compact", "Those above 0", 0)
SUM_SMALL = _work("sum-small", "Pairwise sum", 1e-3, size=10_000)
SCAN_SMALL = _work("scan-small", "Prefix sums", 2e-2, size=10_000)
SCAN_SMALL.exact = SCAN.exact
WORKS = (SUM, SUM_EXACT, SCAN, SORT, COMPACT, SUM_SMALL, SCAN_SMALL)
SUMS, SCANS = (SUM, SUM_SMALL), (SCAN, SCAN_SMALL)


def _ours(work: Work, operation: Callable[[sh.Stream], Any]) -> None:
    @work.ours_on("opencl", "glsl", "numpy")
    def ours(compiled: Callable[..., sh.Kernel], x: np.ndarray) -> Run:
        stream = sh.Stream(x, sh.Attrib1f, compiled(add).backend)

        def run() -> Any:
            answer = operation(stream)
            if isinstance(answer, sh.Stream):
                answer.place.space.finish()
            return answer

        return run


for _of in SUMS:
    _ours(_of, lambda x: x.sum())
for _of in SCANS:
    _ours(_of, lambda x: sh.scan(add, x))
_ours(SUM_EXACT, lambda x: x.sum(method="exact"))
_ours(SORT, sh.sort)
_ours(COMPACT, lambda x: sh.compact(x, _above(x))[0])


@sh.program
def positive(x: sh.Attrib1f) -> sh.Attrib1b:
    return x > 0


def _above(x: sh.Stream) -> sh.Stream:
    return positive(x)


def _by_numpy() -> None:
    import math

    plain: dict[str, Callable[[np.ndarray], Any]] = {
        "sum": np.sum,
        "sum-exact": math.fsum,
        "scan": np.cumsum,
        "sort": np.sort,
        "compact": lambda x: x[x > 0],
    }
    for work in WORKS:
        function = plain[work.name.removesuffix("-small")]
        work.version("masks")(lambda x, function=function: lambda: function(x))


def _by_jax() -> None:
    def version(of: str) -> Callable[[np.ndarray], Run]:
        def prepare(x: np.ndarray) -> Run:
            import jax
            import jax.numpy as jnp

            functions = {"sum": jnp.sum, "scan": jnp.cumsum, "sort": jnp.sort, "compact": lambda a: a[a > 0]}
            function = functions[of] if of == "compact" else jax.jit(functions[of])
            there = jnp.asarray(x)
            return lambda: function(there).block_until_ready()

        return prepare

    for work in (*SUMS, *SCANS, SORT, COMPACT):
        work.version("jax")(version(work.name.removesuffix("-small")))


def _by_numba() -> None:
    def version(of: str) -> Callable[[np.ndarray], Run]:
        def prepare(x: np.ndarray) -> Run:
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

            @njit
            def ordered(a: Any) -> Any:
                return np.sort(a)

            @njit
            def above(a: Any) -> Any:
                return a[a > 0]

            function = {"sum": total, "scan": prefixes, "sort": ordered, "compact": above}[of]
            return lambda: function(x)

        return prepare

    for work in (*SUMS, *SCANS, SORT, COMPACT):
        work.version("numba")(version(work.name.removesuffix("-small")))


def _by_pyopencl() -> None:
    def version(of: str) -> Callable[[np.ndarray], Run]:
        def prepare(x: np.ndarray) -> Run:
            import pyopencl as cl
            import pyopencl.algorithm as algorithm
            import pyopencl.array as arrays
            from pyopencl.scan import GenericScanKernel

            stream = sh.Stream(x, sh.Attrib1f, "opencl")
            there = stream.native()
            context, queue = there.context, there.queue
            prefix = GenericScanKernel(
                context,
                np.float32,
                arguments="__global float *a, __global float *found",
                input_expr="a[i]",
                scan_expr="a + b",
                neutral="0",
                output_statement="found[i] = item;",
            )
            sums = arrays.empty_like(there)

            def scanned() -> Any:
                prefix(there, sums)
                queue.finish()
                return sums

            def copied() -> Any:
                chosen, count, _ = algorithm.copy_if(there, "ary[i] > 0")
                return chosen[: int(count.get())]

            kept = (stream, cl)
            runs = {"sum": lambda: kept and arrays.sum(there).get(), "scan": scanned, "compact": copied}
            return runs[of]

        return prepare

    for work in (*SUMS, *SCANS, COMPACT):
        work.version("pyopencl")(version(work.name.removesuffix("-small")))


def _by_a_launch() -> None:
    """Run an empty kernel and wait for its end; its result was computed before."""

    def version(of: str) -> Callable[[np.ndarray], Run]:
        def prepare(x: np.ndarray) -> Run:
            import pyopencl as cl

            queue = sh.Stream(x[:1], sh.Attrib1f, "opencl").native().queue
            empty = cl.Program(queue.context, "__kernel void empty() {}").build().empty
            answer = {"sum": np.sum, "scan": np.cumsum}[of](x)

            def run() -> Any:
                empty(queue, (1,), (1,))
                queue.finish()
                return answer

            return run

        return prepare

    for work in (SUM_SMALL, SCAN_SMALL):
        work.version("launch")(version(work.name.removesuffix("-small")))


_by_numpy()
_by_jax()
_by_numba()
_by_pyopencl()
_by_a_launch()
