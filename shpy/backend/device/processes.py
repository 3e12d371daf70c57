"""Processes and threads beside a driver: forked children, which lack its threads, and answers of other threads.

Stage: compile, run. A backend calls `use` before it calls its driver, and before it takes a lock that another thread of
the parent may have held at the time of the fork. An `Answer` waits by a lock of Python's own, which Ctrl-C leaves taken
or not: the Condition of a `concurrent.futures.Future` is written in Python, so an interrupted thread may hold it for
ever, and the thread that answers would wait for it.

    OPENCL = Driver("opencl")
    OPENCL.use()           # BackendUnavailable in a child of a process that has used OpenCL
    at_exit(end)           # `end` waits for threads, which a child does not have
    answer = Answer()
    answer.give(3)         # on one thread
    answer.result()        # on another: 3
"""

from __future__ import annotations

import atexit
import ctypes
import math
import os
import threading
from collections.abc import Callable
from typing import Any, Final, Generic, TypeVar, cast

from shpy.backend.device.once import once
from shpy.errors import BackendUnavailable

T = TypeVar("T")

HEARD: Final = 0.1
"""Seconds after which a wait of the caller wakes up, so that Ctrl-C is heard.

CPython handles no signal that arrives between its last check and the wait: that one would go on to its end. On a busy
machine the driver's thread may run just there.
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
        """Return whether the driver belongs to the process from which this one was forked."""
        return self._process not in (None, os.getpid())

    def release(self) -> None:
        """Forget that the driver was used: it was not there."""
        self._process = None


class Answer(Generic[T]):
    """A result or an error, given once by one thread; `ended` tells whether it is there."""

    __slots__ = ("__weakref__", "_error", "_lock", "_result", "ended")

    def __init__(self) -> None:
        self.ended = False
        self._result: Any = None
        self._error: BaseException | None = None
        self._lock = threading.Lock()
        self._lock.acquire()

    def give(self, result: T) -> None:
        """Answer with a result."""
        self._result = result
        self._end()

    def refuse(self, error: BaseException) -> None:
        """Answer with an error, which `result` raises."""
        self._error = error
        self._end()

    def wait(self, seconds: float = math.inf) -> bool:
        """Wait for the answer, at most `seconds`; return whether it is there. Ctrl-C ends the wait."""
        while not self.ended and seconds > 0:
            if self._lock.acquire(timeout=min(seconds, HEARD)):
                self._lock.release()  # lets other threads that wait continue
            seconds -= HEARD
        return self.ended

    def result(self) -> T:
        """Wait for the answer; return the result, or raise the error."""
        self.wait()
        if self._error is None:
            return cast(T, self._result)
        try:
            raise self._error
        finally:
            del self  # the traceback of the error holds this frame

    def _end(self) -> None:
        self.ended = True
        self._lock.release()


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
