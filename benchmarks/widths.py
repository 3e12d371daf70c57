"""The choice of `lanes="auto"` against every width of OpenCL packets, on each kernel.

    python -m benchmarks --only widths

Every width is compiled, and "auto" runs until it has made its trials, with nothing kept from earlier processes. Then
all take turns, so that a machine that has other work slows them alike. Incoherent rays run one element a work item and
are left out.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

import shpy as sh
from benchmarks import rays
from benchmarks.kernels import blur, mandelbrot, nbody, polynomial, shader, spheres
from benchmarks.rounds import once
from benchmarks.tables import Table
from benchmarks.work import Run, Work
from raytracer import Mesh
from shpy.backend.opencl.packets.widen import WIDER, WIDTHS as NARROW

AUTO = "auto"
WIDTHS = (*NARROW, *WIDER)
ROUNDS = 15
PATIENCE = 60.0
"""Seconds of calls after which a kernel that still has widths to try is measured as it is."""


def widths(mesh: Mesh, quick: bool) -> Table:
    """Measure each width, the choice of "auto", and its time over that of the fastest fixed width."""
    works = [m.WORK for m in (mandelbrot, nbody, polynomial, shader, spheres, blur)]
    works += [w for w in rays.works(mesh) if w.name in ("primary", "primary-any")]
    rows = []
    with nothing_kept():
        for work in works:
            modes = ("strict", "relaxed") if work.group == "kernels" else ("strict",)
            rows += [_row(work, math, quick) for math in modes]
    note = (
        'Milliseconds of the best call at each width, and "auto": the widths that its kernels chose, and how many '
        "times as long it takes as the fastest of the fixed widths: of the best calls, of the least CPU time of all "
        "threads, and the median and quartiles of all rounds."
    )
    head = ["kernel", *map(str, WIDTHS), AUTO, "chose", "of bests", "of CPU", "median", "quartiles"]
    return Table("widths", note, head, rows)


@contextmanager
def nothing_kept() -> Iterator[None]:
    """Keep compiled kernels and chosen widths in a folder of their own."""
    before = os.environ.get("SHPY_CACHE_DIR")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SHPY_CACHE_DIR"] = folder
        try:
            yield
        finally:
            os.environ.pop("SHPY_CACHE_DIR")
            if before is not None:
                os.environ["SHPY_CACHE_DIR"] = before


def _row(work: Work, math: str, quick: bool) -> list[str]:
    inputs = work.inputs(work.quick if quick else work.size)
    with_compiler = work.versions["opencl"]
    assert isinstance(with_compiler, partial)
    version: Callable[..., Run] = partial(
        with_compiler.func, **with_compiler.keywords
    )  # without the compiler that it was given
    runs: dict[Any, Run] = {}
    kernels: list[sh.Kernel] = []
    for lanes in (*WIDTHS, AUTO):
        kernels.clear()
        try:
            runs[lanes] = version(partial(_compiled, kernels, backend="opencl", lanes=lanes, math=math), *inputs)
        except sh.CompileError:
            continue  # this driver has no such vectors
    if not quick:  # small runs try nothing
        settle(runs[AUTO], kernels)
    seconds, cpu = in_rounds(runs, 2 if quick else ROUNDS)
    fixed = [lanes for lanes in runs if lanes != AUTO]
    fastest = min(fixed, key=lambda lanes: min(seconds[lanes]))
    ratios = np.divide(seconds[AUTO], seconds[fastest])
    low, middle, high = np.percentile(ratios, (25, 50, 75))
    best = [f"{1e3 * min(seconds[lanes]):.2f}" if lanes in seconds else "-" for lanes in (*WIDTHS, AUTO)]
    of_bests = min(seconds[AUTO]) / min(seconds[fastest])
    of_cpu = min(cpu[AUTO]) / max(min(cpu[fastest]), 1e-6)
    name = work.name if math == "strict" else f"{work.name}, {math}"
    return [
        name,
        *best,
        ", ".join(dict.fromkeys(map(lanes_of, kernels))),
        f"{of_bests:.2f}",
        f"{of_cpu:.2f}",
        f"{middle:.2f}",
        f"{low:.2f} to {high:.2f}",
    ]


def _compiled(kernels: list[sh.Kernel], program: sh.Program, **options: Any) -> sh.Kernel:
    kernels.append(program.compile(**options))
    return kernels[-1]


def lanes_of(kernel: sh.Kernel) -> str:
    """Return the number of lanes that a kernel's notes tell."""
    return next((note.split()[0] for note in kernel.notes if " lanes" in note), "1")


def settle(run: Run, kernels: Sequence[sh.Kernel]) -> None:
    """Call it until none of its kernels has a width left to try."""
    end = time.perf_counter() + PATIENCE
    while any("are tried" in note for kernel in kernels for note in kernel.notes) and time.perf_counter() < end:
        run()


Times = dict[Any, list[float]]


def in_rounds(runs: dict[Any, Run], rounds: int) -> tuple[Times, Times]:
    """Seconds, and CPU seconds of all threads, one for each round: a call that does not count, and one that does."""
    seconds: Times = {name: [] for name in runs}
    cpu: Times = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            run()
            busy = time.process_time()
            seconds[name].append(once(run))
            cpu[name].append(time.process_time() - busy)
    return seconds, cpu
