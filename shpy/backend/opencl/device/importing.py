"""The import of pyopencl, and the environment that it and PoCL start in.

Stage: run. pyopencl is imported when a device is asked for.

    cl = pyopencl()
"""

from __future__ import annotations

import importlib
import os
import sys
import threading
from typing import Any

from shpy.backend.device.answer import Answer
from shpy.backend.opencl.device.absence import can_keep_callers
from shpy.errors import BackendUnavailable
from shpy.packages import install


def pyopencl() -> Any:
    """Return the module; BackendUnavailable where it is not installed."""
    _set_environment()
    try:
        return _imported("pyopencl")
    except ImportError as e:
        raise BackendUnavailable(f"opencl needs pyopencl: {e}", cure=install("pyopencl")) from e


def _imported(name: str) -> Any:
    """Import a module on another thread: Ctrl-C while an extension in C starts would end the process by SIGABRT."""
    if name in sys.modules or sys.is_finalizing():
        return importlib.import_module(name)
    answer: Answer[Any] = Answer()

    def work() -> None:
        try:
            answer.give(importlib.import_module(name))
        except BaseException as error:
            answer.refuse(error)

    threading.Thread(target=work, name="shpy-import", daemon=True).start()
    return answer.result()


def _set_environment() -> None:
    """Set what pyopencl and PoCL read as they start, unless the user has set it."""
    os.environ.setdefault("PYOPENCL_COMPILER_OUTPUT", "0")
    if not can_keep_callers():
        os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
    _keep_threads_apart()


def _keep_threads_apart() -> None:
    """Make PoCL bind each of its threads to a core, unless the environment configures its threads.

    Otherwise Linux may run two threads that wake at once on one core for a whole call, which takes twice as long then.
    PoCL numbers the cores from 0 without regard to the affinity of the process, so this needs all cores to be allowed.
    """
    told = {"POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"} & os.environ.keys()
    if sys.platform == "linux" and not told and os.sched_getaffinity(0) >= set(range(os.cpu_count() or 1)):
        os.environ.setdefault("POCL_AFFINITY", "1")
