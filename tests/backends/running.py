"""The names with which tests of backends run programs."""

from typing import Any

import numpy as np

import shpy as sh
from shpy.backend.base import Array, Options
from shpy.backend.opencl.packets.widen import WIDTHS as PACKET_WIDTHS
from shpy.backend.registry import backend as backend_named
from shpy.run import kernel as kernels
from shpy.run.kernel import Kernel
from shpy.run.result import Result
from shpy.testing.arrays import differing
from shpy.testing.reference import flushes as flushes_denormals, kernel

__all__ = [
    "BACKENDS",
    "LANES",
    "PACKETS",
    "TARGETS",
    "TILES",
    "WIDE",
    "WIDTHS",
    "compiled_anew",
    "covering",
    "differs",
    "flushes_denormals",
    "kernel",
    "run",
]

TARGETS = ("numpy", "opencl", "glsl")
BACKENDS = ("interpreter", "prepared", *TARGETS)
PACKETS = ("opencl-1", "opencl-4", "opencl-16")
TILES = ("numpy-5",)
"""Other widths, with lanes that are left over: as many elements together in OpenCL and in a tile of numpy."""
WIDTHS = (*TILES, *PACKETS)
LANES = {f"opencl-{n}": n for n in (1, *PACKET_WIDTHS)}
"""Every width of OpenCL by itself: one element a work item is what a GPU runs."""
WIDE = {"opencl-32": 32, "opencl-64": 64}
"""The widths for which a driver may lack vectors."""
TINY = {np.dtype(t): np.finfo(t).tiny for t in (np.float16, np.float32, np.float64)}


def run(program: sh.Program, backend: str, *arrays: Any, out: Any = None, shape: Any = None, **options: Any) -> Result:
    """Run it on arrays on one of BACKENDS, WIDTHS, LANES or WIDE; `options` are those of `Program.compile`."""
    return kernel(program, backend, **options).run(*arrays, out=out, shape=shape)


def differs(results: Array, expected: Array, ulp: float = 0, absolute: float = 0) -> Array:
    """Return a mask of the elements that differ: in any bit but those of a NaN, or by more than the bound."""
    wrong = differing(results, expected)
    if results.dtype.kind == "f" and (ulp or absolute):
        with np.errstate(all="ignore"):
            unit = np.spacing(np.maximum(np.abs(expected), TINY[expected.dtype])).astype(np.float64)
            distance = np.abs(results.astype(np.float64) - expected.astype(np.float64))
            wrong &= ~(distance <= np.maximum(ulp * unit, absolute))
    return wrong


def covering(turn: int) -> tuple[str, ...]:
    """Every backend, OpenCL at one lane and at one of its other widths: programs that have turns cover them all."""
    wider = [name for name in LANES if name != "opencl-1"]
    return ("numpy", "opencl-1", wider[turn % len(wider)], "glsl")


def compiled_anew(program: sh.Program, backend: str, **options: Any) -> Kernel:
    """Return a kernel that is not the one of an earlier device, with other faults."""
    kernels._executables.clear()
    return Kernel(program.recorded, backend_named(backend), Options(**options))
