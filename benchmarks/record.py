"""CPU time from Python to text, against the size of the program: recording, passes, printing; no driver.

    python -m benchmarks --only recording

The programs hold lines such as `x[:] = x * a + y`, every tenth in an `if`, every hundredth in a loop; a line makes
about eleven statements of the IR. The time of a statement should not grow with their number. Then the ray tracer's
kernel, a real program.
"""

import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache, partial
from typing import Any

import shpy as sh
from benchmarks.tables import Table
from raytracer import Scene
from raytracer.kernels.eye_rays import EyeRays
from raytracer.kernels.picture import eye_rays
from raytracer.kernels.tracer import Tracer
from raytracer.scene.layout import Layout
from shpy import SH_FOR, SH_IF
from shpy.backend.base import Options
from shpy.backend.glsl import text_for
from shpy.backend.glsl.text.interface import Limits
from shpy.backend.numpy.device.run import TARGET as NUMPY
from shpy.backend.numpy.text.apart import lay_out
from shpy.backend.numpy.text.module import print_python
from shpy.backend.opencl.device.driver import TARGET as OPENCL
from shpy.backend.opencl.text.kernel import print_kernel
from shpy.ir.collector import uncollected
from shpy.ir.nodes import Module
from shpy.passes.pipeline import prepare
from shpy.passes.size import count_ops

LINES = (450, 900, 1_800, 3_600, 7_200)


TEXTS: dict[str, Callable[[Module], str]] = {
    "numpy": lambda module: print_python(lay_out(prepare(module, Options(), NUMPY).module).vector).text,
    "opencl": lambda module: print_kernel(prepare(module, Options(), OPENCL).module).text,
    "glsl": lambda module: text_for(module, Options(), Limits(doubles=True)),
}
"""The text of each target, on GLSL for a device without faults, which has binary64."""


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


def measured(make: Callable[[], sh.Program], repeats: int = 2) -> tuple[int, dict[str, float]]:
    """Return the number of recorded statements; seconds of recording and of each target, the best of `repeats`."""
    best: dict[str, float] = {}

    def timed(name: str, work: Callable[[], Any]) -> Any:
        started = time.process_time()
        with uncollected():
            result = work()
        best[name] = min(best.get(name, float("inf")), time.process_time() - started)
        return result

    for _ in range(repeats):
        module = timed("record", make).ir
        for name, text in TEXTS.items():
            timed(name, partial(text, module))
    return sum(count_ops(module).values()), best


def recording(quick: bool) -> Table:
    """CPU seconds of recording and of each target's text, for programs of several lengths and for the ray tracer."""
    straight(100)
    mixed()
    makers: dict[str, Callable[[], sh.Program]]
    makers = {f"{lines:,} lines": partial(straight, lines) for lines in (LINES[:1] if quick else LINES)}
    rows = []
    for name, make in (makers | {"the ray tracer": ray_tracer}).items():
        count, seconds = measured(make)
        whole = seconds["record"] + max(seconds[target] for target in TEXTS)
        rows.append(
            [name, f"{count:,}", *(f"{s:.3f}" for s in (*seconds.values(), whole)), f"{1e6 * whole / count:.1f}"]
        )
    note = "CPU seconds. Whole: recording, then the slowest target; each: microseconds of a statement."
    return Table("recording", note, ["program", "statements", "record", *TEXTS, "whole", "each"], rows)
