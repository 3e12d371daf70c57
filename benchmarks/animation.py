"""The evenness of frames while `lanes="auto"` tries widths: 200 frames in a new process with empty caches.

    python -m benchmarks --only frames-auto

An animation shows a frame that takes long as a stall. The first frame waits for the driver's compiler and does not
count. After the 200 frames each process goes on until no width is left to try, to tell how many frames that takes.
"""

from __future__ import annotations

import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.chains import gray_scott
from benchmarks.kernels import mandelbrot, shader
from benchmarks.studies import Table
from benchmarks.widths import lanes_of
from benchmarks.work import Run
from raytracer import Mesh, Scene
from raytracer.integrators.renderer import Renderer

CHILD = "import sys; from benchmarks.animation import child; child(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))"
FRAMES = 200
PATIENCE = 25.0
"""Seconds of frames after which a process ends that still has widths to try."""
STALL = 10
"""A frame that takes more than so many times the median is a stall."""
_STEPS = 10

Compiled = Callable[..., sh.Kernel]


def _mandelbrot(compiled: Compiled) -> Run:
    kernel, points = compiled(mandelbrot.mandelbrot), mandelbrot.points(512)[0]
    return lambda: kernel(points)


def _marble(compiled: Compiled) -> Run:
    kernel = compiled(shader.marble)
    return lambda: kernel(shape=(512, 512))


def _gray_scott(compiled: Compiled) -> Run:
    """Return a chain over streams: each frame goes on where the one before ended."""
    start = gray_scott.concentrations(512)[0]
    chain = sh.repeat(compiled(gray_scott.react), _STEPS)
    fields = {name: sh.Stream(start[..., k].copy(), sh.Attrib1f, "opencl") for k, name in enumerate("uv")}

    def run() -> np.ndarray:
        fields.update(chain.run(**fields).streams)
        return fields["u"].numpy()

    return run


def _picture(name: str, size: int, compiled: Compiled) -> Run:
    del compiled
    renderer = Renderer(Scene.builtin(name), backend="opencl", bounces=1)
    return lambda: renderer.render((size, size)).pixels


ANIMATIONS: dict[str, Callable[[Compiled], Run]] = {
    "mandelbrot, 512 x 512": _mandelbrot,
    "marble, 512 x 512": _marble,
    f"gray-scott, {_STEPS} steps at 512 x 512, streams": _gray_scott,
    "boxes, 128 x 128": partial(_picture, "boxes", 128),
    "mixed, 128 x 128": partial(_picture, "mixed", 128),
}


def frames_auto(mesh: Mesh, quick: bool) -> Table:
    """Median and largest times of frames of each animation, with nothing kept from earlier processes."""
    del mesh
    names = list(ANIMATIONS)[1:2] if quick else list(ANIMATIONS)
    rows = [_row(name, 5 if quick else FRAMES, 0.0 if quick else PATIENCE) for name in names]
    head = ["animation", "median", "largest", "frame", "of median", "stalls", "settled", "largest", "lanes"]
    note = (
        f'Milliseconds of {FRAMES} frames on OpenCL with lanes="auto" and empty caches, in a new process each: the '
        f"median, the largest after the first and which one it is; frames above {STALL} times the median. Then the "
        "frame after which no width is left to try, the largest up to it, and the lanes that were chosen."
    )
    return Table("frames-auto", note, head, rows)


def _row(name: str, frames: int, patience: float) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        caches = {"SHPY_CACHE_DIR": folder, "POCL_CACHE_DIR": folder, "SHPY_QUIET": "1"}
        path = os.pathsep.join(p for p in (os.getcwd(), os.environ.get("PYTHONPATH")) if p)
        done = subprocess.run(
            [sys.executable, "-c", CHILD, name, str(frames), str(patience)],
            env={**os.environ, **caches, "PYTHONPATH": path},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    told = json.loads(done.stdout.splitlines()[-1])
    rest = told["seconds"][1:]
    until, chosen = told["settled"], told["lanes"]
    median, counted = statistics.median(rest[: frames - 1]), rest[: frames - 1]
    largest = max(counted)
    return [
        name,
        f"{1e3 * median:.2f}",
        f"{1e3 * largest:.1f}",
        str(rest.index(largest) + 2),
        f"{largest / median:.1f}",
        str(sum(seconds > STALL * median for seconds in counted)),
        "no" if until is None else str(until),
        f"{1e3 * max(rest):.1f}",
        chosen,
    ]


def child(name: str, frames: int, patience: float) -> None:
    """Print the seconds of frames, the one after which no width was left to try, and the lanes, as JSON."""
    kernels: list[sh.Kernel] = []
    compile_: Any = sh.Program.compile

    def compiled(program: sh.Program, *args: Any, **options: Any) -> sh.Kernel:
        kernels.append(compile_(program, *args, **{"backend": "opencl", **options} if not args else options))
        return kernels[-1]

    sh.Program.compile = compiled  # type: ignore[method-assign]
    run = ANIMATIONS[name](compiled)
    seconds: list[float] = []
    settled = None
    end = math.inf
    while len(seconds) < frames or (settled is None and time.perf_counter() < end):
        started = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - started)
        if len(seconds) == 1:
            end = time.perf_counter() + patience
        if settled is None and not any("are tried" in note for kernel in kernels for note in kernel.notes):
            settled = len(seconds)
    lanes = ", ".join(dict.fromkeys(map(lanes_of, kernels)))
    print(json.dumps({"seconds": seconds, "settled": settled, "lanes": lanes}))
