"""Keep a forked child from using the driver of its parent: it lacks the driver's threads, and would hang.

Stage: compile, run. A backend calls `use` before it calls its driver, and before it takes a lock that another thread of
the parent may have held at the time of the fork.

    OPENCL = Driver("opencl")
    OPENCL.use()           # BackendUnavailable in a child of a process that has used OpenCL
    at_exit(end)           # `end` waits for threads, which a child does not have
"""

from __future__ import annotations

import atexit
import ctypes
import os
from collections.abc import Callable
from typing import Final

from shpy.backend.device.once import once
from shpy.errors import BackendUnavailable

HEARD: Final = 0.1
"""Seconds after which a wait of the caller wakes up, so that Ctrl-C is heard.

CPython handles no signal that arrives between its last check and the wait: that one would go on to its end. A machine
whose processors are all busy gives the driver's thread its turn just there.
"""


class Driver:
    """A driver that starts threads: it serves the process that uses it first, and that process's children never."""

    def __init__(self, backend: str) -> None:
        self.backend = backend
        self._process: int | None = None

    def use(self) -> None:
        """Take the driver for this process; BackendUnavailable in a process forked after its parent did."""
        process = os.getpid()
        if self._process is None:
            self._process = process
            _leave_drivers_alone()
        elif self._process != process:
            raise BackendUnavailable(
                f"this process was forked after its parent had used {self.backend}, whose driver does not survive that",
                cure='multiprocessing.get_context("spawn"), or fork before the first use; numpy works in any process',
            )

    @property
    def is_elsewhere(self) -> bool:
        """Return whether the driver is that of the process from which this one was forked."""
        return self._process not in (None, os.getpid())

    def release(self) -> None:
        """Forget that the driver was used: it was not there."""
        self._process = None


def at_exit(end: Callable[[], None]) -> None:
    """Call `end` when this process exits, and not when a child exits that was forked from it."""
    process = os.getpid()
    atexit.register(lambda: end() if os.getpid() == process else None)


@once
def _leave_drivers_alone() -> None:
    """Let the children of this process exit without the exit handlers of its drivers, from now on.

    These handlers wait for the drivers' threads, which a child does not have: Mesa's wait for ever, or fail. So a child
    skips all handlers of C that its parent had registered, as `multiprocessing` does, but for those of stdio.
    """
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_exit_at_once)


def _exit_at_once() -> None:
    """Have `exit` flush what C has buffered, and end the process with its status before it calls older handlers."""
    library = ctypes.CDLL(None)
    if hasattr(library, "on_exit"):  # of glibc; handlers are called in the reverse order
        for last in (library._exit, library.fcloseall):
            library.on_exit(last, None)
