"""Peers: those installed, with their versions, and the command that installs a missing one.

found, missing = available(["drjit", "numba"])
for name in found:
    start(name)
"""

from __future__ import annotations

import ctypes.util
import glob
import importlib
import importlib.metadata
import importlib.util
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.work import Run
from shpy.ieee import set_ieee_arithmetic
from shpy.packages import install

LLVM = "apt install libllvm19   # DRJIT_LIBLLVM_PATH names another file; LLVM 16 aborts with AVX-512"


@dataclass(frozen=True)
class Peer:
    """A peer: what to call it, the modules that it needs, and the distribution whose version is shown."""

    label: str
    modules: tuple[str, ...] = ()
    distribution: str = "numpy"
    llvm: bool = False

    @property
    def cure(self) -> str | None:
        """The command that brings what is missing; None where nothing is."""
        if any(importlib.util.find_spec(m) is None for m in self.modules):
            return install(self.distribution)
        return LLVM if self.llvm and libllvm() is None else None

    @property
    def version(self) -> str:
        """The installed version."""
        return importlib.metadata.version(self.distribution)


PEERS = {
    "masks": Peer("numpy, plain masks"),
    "hand": Peer("OpenCL C by hand", ("pyopencl",), "pyopencl"),
    "moderngl": Peer("GLSL by hand", ("moderngl",), "moderngl"),
    "drjit": Peer("Dr.Jit (LLVM)", ("drjit",), "drjit", llvm=True),
    "taichi": Peer("Taichi", ("taichi",), "taichi"),
    "warp": Peer("Warp", ("warp",), "warp-lang"),
    "numba": Peer("numba", ("numba",), "numba"),
    "jax": Peer("JAX", ("jax",), "jax"),
    "mitsuba": Peer("Mitsuba 3 (llvm_ad_rgb)", ("mitsuba",), "mitsuba", llvm=True),
    "whitted": Peer("Mitsuba 3, a tracer of its own", ("mitsuba",), "mitsuba", llvm=True),
}


def libllvm() -> str | None:
    """Return the LLVM library that Dr.Jit can load, whose path is put where it looks for it; None if there is none.

    It aborts the process with LLVM 15 and older, so the newest that is installed is chosen. On a processor with
    AVX-512, LLVM 16 aborted while it generated code for the work `spheres`; with LLVM 19.1.7 all works ran (Dr.Jit 1.5,
    Mitsuba 3.9.1).
    """
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        libraries = [p for p in glob.glob("/usr/lib/*/libLLVM*.so*") if _major(p) >= 16]
        if not libraries and not (ctypes.util.find_library("LLVM-19") or ctypes.util.find_library("LLVM")):
            return None
        if libraries:
            os.environ["DRJIT_LIBLLVM_PATH"] = max(libraries, key=_major)
    return os.environ.get("DRJIT_LIBLLVM_PATH", "")


def _major(path: str) -> int:
    """Return the version in the name of a library: 19 for libLLVM-19.so and libLLVM.so.19.1."""
    rest = os.path.basename(path).removeprefix("libLLVM").lstrip("-.").removeprefix("so.")
    digits = rest.split(".")[0]
    return int(digits) if digits.isdigit() else 0


def start(name: str) -> None:
    """Do what a peer asks for before its first use: its documentation's choice of a processor, and no chatter."""
    if name == "taichi":
        os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
        import taichi

        taichi.init(taichi.cpu, log_level=taichi.ERROR)
        # It makes this thread flush denormals, which is undone for the others; the threads that it has started stay so.
        set_ieee_arithmetic()
    elif name == "warp":
        import warp

        warp.config.log_level = warp.LOG_ERROR
        warp.init()
        warp.set_device("cpu")
    elif name == "jax":
        import jax

        jax.config.update("jax_platforms", "cpu")
    elif name in ("mitsuba", "whitted"):
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")


def available(names: list[str]) -> tuple[list[str], dict[str, str]]:
    """Return the peers of these names that are there; and for each that is not, the command that brings it."""
    cures = {name: PEERS[name].cure for name in names}
    return [n for n in names if cures[n] is None], {n: c for n, c in cures.items() if c is not None}


def filled(kernel: Callable[..., None], shape: tuple[int, ...], *inputs: Any) -> Run:
    """Return a run of a kernel of Taichi that gives an array of float32, which it fills."""

    def run() -> np.ndarray:
        out = np.empty(shape, np.float32)
        kernel(*inputs, out)
        return out

    return run


def launched(kernel: Any, shape: Any, inputs: Callable[[], Sequence[Any]] = list, dtype: Any = float) -> Run:
    """Return a run of a kernel of Warp, which wraps its inputs in each run, since Warp borrows arrays of the host."""
    import warp as wp

    def run() -> np.ndarray:
        out = wp.empty(shape, dtype=dtype)
        wp.launch(kernel, shape, inputs(), [out])
        array: np.ndarray = out.numpy()
        return array

    return run
