"""The answer that one thread owes another, which Ctrl-C may interrupt in its wait at any place.

Stage: run. A lock of Python's own is taken or not; the Condition of a `concurrent.futures.Future` is written in Python,
so an interrupted thread may hold it for ever, and the thread that answers would wait for it.

    answer = Answer()
    answer.give(3)              # on one thread
    answer.wait(0.1)            # on another: True
    answer.result()             # 3
"""

from __future__ import annotations

import math
import threading
from typing import Any, Generic, TypeVar, cast

from shpy.backend.device.processes import HEARD

T = TypeVar("T")


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
        """Wait for the answer, at most so many seconds; return whether it is there. Ctrl-C ends the wait."""
        while not self.ended and seconds > 0:
            if self._lock.acquire(timeout=min(seconds, HEARD)):
                self._lock.release()  # for others that wait
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
