"""The cost and the error of functions in each mode, in core-nanoseconds a call and in units in the last place.

    python -m benchmarks --only functions,modes

A program calls a function eight times for each element; one that only adds is taken off. Times are of all cores, so
that others at work matter little, and the least of several calls, all modes in turns. Errors are the greatest over
binary32 in a stride, against binary64. `modes` compares whole kernels in the same way,
and `strict-frames` whole frames.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import shpy as sh
from benchmarks import studies
from benchmarks.kernels import blur, mandelbrot, nbody, polynomial, shader, spheres
from benchmarks.studies import Table, spread
from benchmarks.work import Work
from raytracer import Mesh
from raytracer.integrators.renderer import Renderer
from raytracer.scenes import glass, materials
from shpy.ir.ops import OPS, TRANSCENDENTALS
from shpy.passes.modes import MODES

CALLS = 8
ROUNDS = 7


def repeated(function: Callable[..., Any], arguments: int) -> sh.Program:
    """Return the program that adds up a function of eight numbers near its input."""
    if arguments == 2:

        def of_two(x: sh.Attrib1f) -> sh.Attrib1f:
            total = sh.Attrib1f(0)
            for n in range(CALLS):
                total += function(x + n * 0.001, x + 0.5)
            return total

        return sh.program(of_two)

    def of_one(x: sh.Attrib1f) -> sh.Attrib1f:
        total = sh.Attrib1f(0)
        for n in range(CALLS):
            total += function(x + n * 0.001)
        return total

    return sh.program(of_one)


def named(name: str) -> sh.Program:
    """Return the program of one of shpy's functions."""
    return repeated(getattr(sh, name), len(OPS[name].takes))


def core_seconds(kernel: Any, x: Any) -> float:
    """Return the seconds of one call, on all cores together."""
    start = time.process_time()
    kernel(x)
    return time.process_time() - start


def times(name: str, backend: str, count: int) -> list[float]:
    """Core-nanoseconds a call in each of MODES."""
    low = 1.25 if name == "acosh" else 0.1
    x = np.linspace(low, low + 0.8, count, dtype=np.float32)
    empty = repeated(lambda *a: a[0], 1)
    kernels = [p.compile(backend, math=mode) for p in (named(name), empty) for mode in MODES]  # type: ignore[arg-type]
    for kernel in kernels:
        kernel(x)
    least = [
        min(seconds) for seconds in zip(*([core_seconds(k, x) for k in kernels] for _ in range(ROUNDS)), strict=True)
    ]
    pairs = zip(least[: len(MODES)], least[len(MODES) :], strict=True)
    return [max(0.0, whole - nothing) / count / CALLS * 1e9 for whole, nothing in pairs]


def greatest_error(name: str, stride: int, mode: str) -> tuple[float, str]:
    """In units in the last place, in a mode, and at which input."""
    function = getattr(sh, name)
    bits = np.arange(0, 1 << 32, stride, dtype=np.uint64).astype(np.uint32)
    x = bits.view(np.float32)
    kept = np.isfinite(x) & (np.abs(x) >= 2.0**-126)
    x = x[kept]
    others = ()
    if len(OPS[name].takes) == 2:
        rng = np.random.default_rng(1)
        x = (rng.uniform(0.5, 2, len(x)) * 2.0 ** rng.integers(-9, 10, len(x))).astype(np.float32)
        others = ((rng.standard_normal(len(x)) * 9).astype(np.float32),)
    meaning = OPS[name].meaning
    assert meaning is not None
    with np.errstate(all="ignore"):
        exact = np.asarray(meaning(x.astype(np.float64), *(o.astype(np.float64) for o in others)))
        values = _program(function, len(others)).compile(math=mode)(x, *others)  # type: ignore[arg-type]
        place = 2.0 ** (np.floor(np.log2(np.maximum(np.abs(exact), 2.0**-126))) - 23)
        off = np.abs(values.astype(np.float64) - exact) / place
    off = np.where(np.isfinite(values) & (np.abs(exact) < 3.4e38), off, 0)
    worst = int(np.argmax(off))
    return float(off[worst]), ", ".join(f"{v[worst]:.9g}" for v in (x, *others))


def _program(function: Callable[..., Any], others: int) -> sh.Program:
    if others:

        def of_two(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
            return function(x, y)

        return sh.program(of_two)

    def of_one(x: sh.Attrib1f) -> sh.Attrib1f:
        return function(x)

    return sh.program(of_one)


def functions(mesh: Mesh, quick: bool) -> Table:
    """Return a row for each function: its greatest errors in strict and portable mode, and its cost in each mode."""
    available = [b.name for b in sh.backends() if b.available and b.name != "glsl"]
    stride, count = (65_521, 1 << 16) if quick else (1_021, 1 << 19)
    rows = []
    times_on: dict[str, list[list[float]]] = {backend: [] for backend in available}
    for name in sorted(TRANSCENDENTALS):
        strict, _ = greatest_error(name, stride, "strict")
        portable, at = greatest_error(name, stride, "portable")
        row = [f"`{name}`", f"{strict:.2f}", f"{portable:.2f}", at]
        times_by_backend = {backend: times(name, backend, count) for backend in available}
        for backend, costs in times_by_backend.items():
            times_on[backend].append(costs)
        rows.append(row + [f"{t:.2f}" for costs in times_by_backend.values() for t in costs])
    means = [
        f"{mean:.2f}"
        for costs in times_on.values()
        for mean in geometric_means(multiples(costs, MODES.index("portable")))
    ]
    rows.append(["of portable", "", "", "", *means])
    head = ["function", "strict error", "portable error", "at", *(f"{b} {mode}" for b in available for mode in MODES)]
    note = f"Errors in ULP, over binary32 in a stride of {stride:,}; times in core-nanoseconds a call. "
    note += "The last row has the geometric means of the times in multiples of those in portable mode"
    note += ", without functions whose time there is 0."
    return Table("What functions cost in each mode", note, head, rows)


def multiples(rows: list[list[float]], column: int) -> list[list[float]]:
    """Return each row in multiples of its time in one column.

    Rows without a time there are left out: on a busy machine a quick function takes no longer than an empty kernel.
    """
    return [[time / row[column] for time in row] for row in rows if row[column] > 0] or [[float("nan")] * len(rows[0])]


def geometric_means(rows: list[list[float]]) -> list[float]:
    """Return the geometric mean of each column."""
    return [float(mean) for mean in np.exp(np.log(np.maximum(rows, 1e-3)).mean(axis=0))]


KERNELS = (mandelbrot, nbody, polynomial, shader, spheres, blur)


def of_kernel(work: Work, target: str, size: int) -> list[float]:
    """Core-seconds of our version in each of MODES, in turns."""
    version: Any = work.versions[target]
    inputs = work.inputs(size)
    runs = [version.func(partial(version.args[0], math=mode), *inputs) for mode in MODES]
    least = [float("inf")] * len(runs)
    for done in range(ROUNDS):
        for k, run in enumerate(runs):
            start = time.process_time()
            run()
            if done:  # the first round compiles
                least[k] = min(least[k], time.process_time() - start)
    return least


def modes(mesh: Mesh, quick: bool) -> Table:
    """Return a row for each kernel: how many times relaxed mode's time the other modes take."""
    available = [b.name for b in sh.backends() if b.available]
    others = [mode for mode in MODES if mode != "relaxed"]
    rows, ratios = [], []
    for work in (module.WORK for module in KERNELS):
        row: list[float] = []
        for target in available:
            size = work.quick if quick or target != "opencl" else work.size
            seconds = dict(zip(MODES, of_kernel(work, target, size), strict=True))
            row += [seconds[mode] / seconds["relaxed"] for mode in others]
        ratios.append(row)
        rows.append([work.name, *(f"{ratio:.2f}" for ratio in row)])
    rows.append(["geometric mean", *(f"{mean:.2f}" for mean in geometric_means(ratios))])
    note = "Core time in multiples of that in relaxed mode."
    return Table("What modes cost", note, ["kernel", *(f"{b} {mode}" for b in available for mode in others)], rows)


FRAMES = (materials, glass)


def strict_frames(mesh: Mesh, quick: bool) -> Table:
    """Return a row for each scene: the core time of a frame in strict and in portable mode, and their ratio."""
    size, rounds = (32, 3) if quick else (512, 61)
    rows = []
    for make in FRAMES:
        strict, portable = (Renderer(make(), backend=studies.backend(), math=mode) for mode in ("strict", "portable"))
        runs = [renderer.render for renderer in (strict, portable)]
        seconds = np.array([[core_seconds(run, (size, size)) for run in runs] for _ in range(1 + rounds)])[1:]
        rows.append([make.__name__, *(spread(t * 1e3, 2) for t in seconds.T), spread(seconds[:, 0] / seconds[:, 1], 3)])
    note = f"{size} x {size} pixels on {studies.backend()}: core time, medians and quartiles of {rounds} frames each."
    return Table("What strict functions cost in frames", note, ["scene", "strict, ms", "portable, ms", "ratio"], rows)
