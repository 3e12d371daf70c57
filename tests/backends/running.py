"""The names with which tests of backends run programs."""

from typing import Any

import shpy as sh
from shpy.backend.base import Options
from shpy.backend.registry import backend as backend_named
from shpy.run import kernel as kernels
from shpy.run.kernel import Kernel
from shpy.testing.conformance.running import (
    BACKENDS,
    LANES,
    PACKETS,
    TARGETS,
    TILES,
    WIDE,
    WIDTHS,
    DenormalWatch,
    differs,
    flushes_denormals,
    kernel,
    run,
)

__all__ = [
    "BACKENDS",
    "LANES",
    "PACKETS",
    "TARGETS",
    "TILES",
    "WIDE",
    "WIDTHS",
    "DenormalWatch",
    "compiled_anew",
    "covering",
    "differs",
    "flushes_denormals",
    "kernel",
    "run",
]


def covering(turn: int) -> tuple[str, ...]:
    """Every backend, OpenCL at one lane and at one of its other widths: programs that have turns cover them all."""
    wider = [name for name in LANES if name != "opencl-1"]
    return ("numpy", "opencl-1", wider[turn % len(wider)], "glsl")


def compiled_anew(program: sh.Program, backend: str, **options: Any) -> Kernel:
    """Return a kernel that is not the one of an earlier device, with other faults."""
    kernels._executables.clear()
    return Kernel(program.recorded, backend_named(backend), Options(**options))
