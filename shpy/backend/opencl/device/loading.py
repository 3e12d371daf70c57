"""The import of pyopencl, its environment and PoCL's, and the error where OpenCL cannot be used.

Stage: run. pyopencl is imported when a device is asked for. The error names the cause: no driver, drivers without a
device, or PoCL without a folder for its cache.

    cl = pyopencl()
    raise explain_absence(["Portable Computing Language"])
"""

from __future__ import annotations

import importlib
import os
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from shpy.backend.device.processes import Answer
from shpy.errors import BackendUnavailable
from shpy.packages import install

POCL = "Portable Computing Language"
_THREADS = frozenset({"POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"})
"""The variables in which versions of PoCL read the number of their threads."""
_FILE = 1 << 18
"""Bytes of a file that a folder must have room for: those of a compiled kernel."""
_BEGINNING = 1.0
"""Seconds in which a thread begins, if there is one: Ctrl-C may come before it is made."""


def pyopencl() -> Any:
    """Return the module; BackendUnavailable where it is not installed."""
    _set_environment()
    try:
        module = _imported("pyopencl")
    except ImportError as e:
        raise BackendUnavailable(f"opencl needs pyopencl: {e}", cure=install("pyopencl")) from e
    # The first kernel would import these on the caller's thread, where Ctrl-C can leave half an object of pytools. Its
    # destructor would print a second error.
    for part in ("pyopencl.invoker", "pyopencl.characterize"):
        with suppress(ModuleNotFoundError):
            _imported(part)
    return module


def _imported(name: str) -> Any:
    """Import a module on another thread: Ctrl-C while an extension in C starts would end the process by SIGABRT.

    Ctrl-C ends the wait after the import: a program that ended meanwhile would end with status 1 and not by SIGINT,
    since CPython forgets how the program ended where another thread calls `exec` with a text, as dataclasses do.
    """
    if name in sys.modules or sys.is_finalizing():
        return importlib.import_module(name)
    answer: Answer[Any] = Answer()
    begun = threading.Event()

    def work() -> None:
        begun.set()
        try:
            answer.give(importlib.import_module(name))
        except BaseException as error:
            answer.refuse(error)

    try:
        threading.Thread(target=work, name="shpy-import", daemon=True).start()
        return answer.result()
    except KeyboardInterrupt:
        while not answer.wait(_BEGINNING) and begun.is_set():
            pass
        raise


def _set_environment() -> None:
    """Set what pyopencl and PoCL read as they start, unless the user has set it."""
    os.environ.setdefault("PYOPENCL_COMPILER_OUTPUT", "0")
    if not can_keep_callers():
        os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
    _keep_threads_apart()


def keep_to_one_core() -> None:
    """Let PoCL start one thread, as numpy has one, unless it has started or the environment configures its threads.

    Worker processes that share the cores do so. Two of them, which run a program of 20 sines over 400 blocks of 100,000
    elements, take 7.8 s of CPU in all, and 20.2 s with numpy.
    """
    if not _THREADS & os.environ.keys():
        os.environ.update(dict.fromkeys(_THREADS, "1"))


def _keep_threads_apart() -> None:
    """Make PoCL bind each of its threads to a core, unless the environment configures its threads.

    Otherwise Linux may run two threads that wake at once on one core for a whole call, which takes twice as long then.
    PoCL numbers the cores from 0 without regard to the affinity of the process, so this needs all cores to be allowed.
    """
    told = _THREADS & os.environ.keys()
    if sys.platform == "linux" and not told and os.sched_getaffinity(0) >= set(range(os.cpu_count() or 1)):
        os.environ.setdefault("POCL_AFFINITY", "1")


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
    """Return the error if a platform is PoCL and its cache is not writable, since it compiles nothing then.

    If the disk becomes full later, PoCL reports the same error as for a fault in the text.
    """
    if POCL not in platforms:
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
