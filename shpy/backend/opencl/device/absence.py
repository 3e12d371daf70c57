"""The error where OpenCL cannot be used: no driver, drivers without a device, or PoCL without a folder for its cache.

Stage: run. Takes the names of platforms, gives the error that names the cause.

    raise explain_absence(["Portable Computing Language"])
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile

from shpy.errors import BackendUnavailable

_POCL = "Portable Computing Language"
_FILE = 1 << 18
"""Bytes of a file that a folder must have room for: those of a compiled kernel."""


def explain_absence(platforms: Sequence[str]) -> BackendUnavailable:
    """Return the error for a system where these platforms offer no device."""
    if not platforms:
        return BackendUnavailable(
            "opencl needs an OpenCL driver, and there is none",
            cure="apt install pocl-opencl-icd (or the driver of the GPU)",
        )
    return explain_cache(platforms) or BackendUnavailable(
        f"an OpenCL driver is installed ({', '.join(platforms)}), but it offers no device",
        cure="see what `clinfo` says, or apt install pocl-opencl-icd, which runs on any processor",
    )


def explain_cache(platforms: Sequence[str]) -> BackendUnavailable | None:
    """Return the error for PoCL among the platforms that cannot write its cache: it compiles nothing without it.

    Its disk may be full by the time that a kernel is compiled, which PoCL does not tell from a fault of the text.
    """
    if _POCL not in platforms:
        return None
    folder = _cache_of_pocl()
    reason = _fault_of(folder)
    if reason is None:
        return None
    return BackendUnavailable(
        f"PoCL cannot write its cache in {folder} ({reason}), and runs nothing without it",
        cure="export POCL_CACHE_DIR=FOLDER with a folder that you can write",
    )


def can_keep_callers() -> bool:
    """Return whether pyopencl can keep the functions that it generates to call kernels; without a folder it fails."""
    shared = os.environ.get("XDG_CACHE_HOME")
    try:
        return _fault_of((Path(shared) if shared else Path.home() / ".cache") / "pytools") is None
    except RuntimeError:  # there is no home
        return False


def reads_header(platform: str) -> bool:
    """Return whether a platform's compiler reads the declarations of OpenCL C anew for each program."""
    return platform == _POCL


def _fault_of(folder: Path) -> str | None:
    """Return the reason why no file can be written in a folder, which is made if it is missing; None if one can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder) as file:
            file.write(bytes(_FILE))
    except OSError as error:
        return error.strerror or str(error)
    return None


def _cache_of_pocl() -> Path:
    """Return the folder in which PoCL keeps its kernels, by the environment variables that it reads."""
    own = os.environ.get("POCL_CACHE_DIR")
    if own:
        return Path(own)
    shared, home = os.environ.get("XDG_CACHE_HOME"), os.environ.get("HOME")
    # PoCL takes /tmp where HOME is not set.
    base = Path(shared) if shared else Path(home) / ".cache" if home else Path("/tmp")
    return base / "pocl" / "kcache"
