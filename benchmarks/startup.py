"""The time until a kernel runs: emitting and compiling, in new processes, cold and warm.

    print(compiling(Setup()).markdown())

Cold is a process that finds nothing kept from an earlier one, warm is one after it.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import cache
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.tables import Setup, Table
from raytracer import Scene
from raytracer.kernels.eye_rays import EyeRays
from raytracer.kernels.picture import eye_rays
from raytracer.kernels.tracer import Tracer
from raytracer.scene.layout import Layout
from shpy import SH_FOR, SH_IF

CHILD = "import sys; from benchmarks.startup import child; child(*sys.argv[1:])"
IMPORTED = ("numpy", "shpy", "raytracer")
IMPORT = "import time; start = time.process_time(); import {package}; print(time.process_time() - start)"
SMALL = """
import time, numpy, shpy
from benchmarks.calls import COUNT, increment
numbers = numpy.arange(COUNT, dtype=numpy.float32)
for _ in range({count}):
    increment(numbers)
print(time.process_time())
"""
COMMAND = "import sys, shpy_start; sys.exit(shpy_start.raytracer())"
AT_ONCE = f"from shpy.backend.opencl.device import building; building.LARGE = 1 << 30; {COMMAND}"
"""The same, where no program is built in a hurry."""
RENDERS = {
    "{}": ["boxes", "--size", "256x256"],
    "{}, a path traced scene": ["mixed", "--integrator", "path", "--samples", "1", "--size", "64x48"],
}
HURRIED = "opencl, a path traced scene"
"""The start that is measured with builds that are optimized at once, too."""


def straight(count: int) -> sh.Program:
    """Return a program of `count` lines."""

    @sh.program
    def work(a: sh.Attrib3f, b: sh.Attrib1f) -> sh.Attrib3f:
        x, y = sh.Attrib3f(a), sh.Attrib3f(b)
        for number in range(0, count, 10):
            with SH_FOR(0, 3) if number % 100 == 0 else nullcontext():
                for k in range(4):
                    x[:] = x * a + (number + k)
                    y[:] = sh.max(x, y) - b
                x.xy = y.yx
            with SH_IF(x.x > y.y):
                y += sh.dot(x, a)
        return x + y

    return work


@cache
def mixed() -> tuple[Scene, Layout]:
    """Return the scene with everything in it, and its tables."""
    scene = Scene.builtin("mixed")
    return scene, Layout.of(scene)


def ray_tracer() -> sh.Program:
    """Return the kernel of that scene."""
    scene, layout = mixed()
    program: sh.Program = eye_rays(Tracer(layout, scene.background, scene.ambient, 3, "opencl"), EyeRays())
    return program


def _spheres() -> Any:
    from benchmarks.kernels.spheres import picture

    return sh.Program.from_ir(picture.ir)


PROGRAMS: dict[str, Callable[[], Any]] = {
    "spheres": _spheres,
    "ray tracer": ray_tracer,
    "branches": lambda: straight(270),
}


def child(name: str, backend: str) -> None:
    """Print the seconds of emitting and compiling a program: for a process of its own."""
    sh.backends()  # opening the device is no part of it, and neither is the scene's accelerator
    mixed()
    program = PROGRAMS[name]()
    started = time.perf_counter()
    program.compile(backend, loop_limit=None)
    print(time.perf_counter() - started)


def _run(command: Sequence[str], cache: str, places: Mapping[str, str] | None = None) -> tuple[str, float, float]:
    """Run a new Python; return its output, its seconds, and those of its processor.

    `places` are further variables of its environment.
    """
    paths = [p for p in (os.getcwd(), os.environ.get("PYTHONPATH")) if p]
    environment = {**os.environ, "SHPY_CACHE_DIR": cache, "POCL_CACHE_DIR": cache, "PYTHONPATH": os.pathsep.join(paths)}
    environment |= places or {}
    started, busy = time.perf_counter(), _children()
    done = subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True, check=True)
    return done.stdout, time.perf_counter() - started, _children() - busy


def _children() -> float:
    """Return the processor's seconds of all processes that this one has started and that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return children.ru_utime + children.ru_stime


def _backends() -> list[str]:
    return [b.name for b in sh.backends() if b.available]


def compiling(setup: Setup) -> Table:
    """Measure the compilation of programs, each in a new process, cold and then warm."""
    rows, rounds = [], {}
    cases = [(name, backend) for name in PROGRAMS for backend in _backends()]
    for name, backend in [("spheres", "numpy")] if setup.quick else cases:
        with tempfile.TemporaryDirectory() as cache:
            cold, warm = (float(_run(["-c", CHILD, name, backend], cache)[0]) for _ in range(2))
        rows.append([name, backend, f"{cold:.3f}", f"{warm:.3f}"])
        rounds[f"{name}, {backend}"] = [cold, warm]
    head = ["program", "target", "compile, cold", "compile, warm"]
    return Table("compiling", "Seconds, with emission; the driver's code is waited for.", head, rows, rounds)


def starting(setup: Setup) -> Table:
    """`raytracer render` of a simple scene and of one with everything, in a new process, cold and then warm."""
    rows, rounds = [], {}
    cases = [(name.format(b), COMMAND, words, b) for name, words in RENDERS.items() for b in _backends()]
    cases += [(f"{name}, optimized at once", AT_ONCE, w, b) for name, _, w, b in cases if name == HURRIED]
    for name, text, words, backend in cases[:1] if setup.quick else cases:
        with tempfile.TemporaryDirectory() as cache:
            command = ["-c", text, "render", *words, "--backend", backend, "-o", os.path.join(cache, "out.png")]
            runs = [_run(command, cache)[1:] for _ in range(2 if setup.quick else 4)]
        (cold, busy), *warm = runs
        rows.append([name, f"{cold:.2f}", f"{min(warm)[0]:.2f}", f"{busy:.2f}"])
        rounds[name] = [seconds for seconds, _ in runs]
    note = "Seconds of `raytracer render` in a new process, Python's own start included: " + "; ".join(
        f"`{' '.join(words)}`" for words in RENDERS.values()
    )
    return Table("starting", f"{note}.", ["target", "cold", "warm", "CPU, cold"], rows, rounds)


def waves_of(terms: int) -> sh.Program:
    """Return a program of sines."""

    @sh.program
    def waves(x: sh.Attrib1f) -> sh.Attrib1f:
        return sum((sh.sin(x * k) / k for k in range(1, terms)), sh.Attrib1f(0))

    return waves


def session(largest: int) -> None:
    """Run five programs on 100 elements, on a tenth of the largest number and on that, and print the CPU seconds."""
    started = time.process_time()  # imports come before, since they take the same time with each backend
    x = np.linspace(0, 1, largest, dtype=np.float32)
    for terms in range(4, 24, 4):
        waves = waves_of(terms)
        for count in (100, largest // 10, largest, largest):
            waves(x[:count])
    print(time.process_time() - started + _children())


def worker(x: np.ndarray) -> None:
    """Run a program of 20 sines on a block: for a worker process."""
    waves_of(20)(x)


def workers(blocks: int) -> None:
    """Run blocks of 100,000 elements in two worker processes, and print the CPU seconds of all three processes."""
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        pool.map(worker, [np.linspace(0, 1, 100_000, dtype=np.float32)] * blocks, chunksize=1)
        pool.close()
        pool.join()
    print(time.process_time() + _children())


def sessions(setup: Setup) -> Table:
    """Measure processes of plain calls one after the other, each beside those with a backend pinned and the same files.

    The policy of "auto" (`shpy/run/tiers`) promises at most twice the time of the better backend. Each process finds
    the files that those of "auto" before it left; a pinned process has a copy of them.
    """
    sizes = (1_000,) if setup.quick else (10_000, 200_000, 2_000_000)
    texts = {f"five programs, {n:,}": f"from benchmarks.startup import session; session({n})" for n in sizes}
    blocks = 4 if setup.quick else 400
    texts[f"{blocks} blocks in two workers, 100,000"] = f"from benchmarks.startup import workers; workers({blocks})"
    texts["5,000 calls, 64"] = SMALL.format(count=10 if setup.quick else 5000)
    rows, rounds, count = [], {}, 1 if setup.quick else 8
    backends = ("numpy", "auto") if setup.quick else ("numpy", "opencl", "auto")
    for name, text in texts.items():
        seconds: dict[str, list[float]] = {backend: [] for backend in backends}
        with tempfile.TemporaryDirectory() as cache:
            for k in range(count):
                for backend in backends:
                    with _copy_of(cache, copied=backend != "auto") as files:
                        seconds[backend].append(float(_run(["-c", text], files, {"SHPY_BACKEND": backend})[0]))
                *pinned, auto = (own[k] for own in seconds.values())
                rows.append([f"{name}, process {k + 1}", *(f"{own[k]:.2f}" for own in seconds.values())])
                rows[-1].append(f"{auto / min(pinned):.2f}")
        rounds |= {f"{name}, {backend}": own for backend, own in seconds.items()}
    note = "CPU seconds of a process of plain calls, with 100 elements to as many as the row says, or of x + 1 with 64."
    return Table("sessions", note, ["programs, elements", *seconds, "auto, of the better"], rows, rounds)


@contextmanager
def _copy_of(folder: str, *, copied: bool) -> Iterator[str]:
    """Return a copy of a folder for the block, or the folder itself."""
    if not copied:
        yield folder
        return
    with tempfile.TemporaryDirectory() as parent:
        yield shutil.copytree(folder, os.path.join(parent, "files"))


def importing(setup: Setup) -> Table:
    """Measure imports of packages, each in a new process, without bytecode and then with it, as pip leaves it."""
    rounds, rows, seconds_of = 2 if setup.quick else 9, [], {}
    with tempfile.TemporaryDirectory() as cache:
        for package in IMPORTED:
            without = [_import_seconds(package, os.path.join(cache, str(n), package)) for n in range(rounds)]
            _import_seconds(package, cache, writes=True)
            kept = [_import_seconds(package, cache) for _ in range(rounds)]
            rows.append([f"`{package}`", *(f"{min(seconds):.3f}" for seconds in (without, kept))])
            seconds_of |= {package: without, f"{package}, with bytecode": kept}
    note = "Seconds of processor time of `import` in a new process, dependencies included, without Python's own start."
    return Table("importing", note, ["package", "without bytecode", "with bytecode"], rows, seconds_of)


def _import_seconds(package: str, bytecode: str, *, writes: bool = False) -> float:
    """Measure the processor time of importing a package whose bytecode lies in a folder."""
    places = {"PYTHONPYCACHEPREFIX": bytecode, "PYTHONDONTWRITEBYTECODE": "" if writes else "1"}
    return float(_run(["-c", IMPORT.format(package=package)], bytecode, places)[0])
