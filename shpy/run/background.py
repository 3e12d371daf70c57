"""Results that threads make, while the caller goes on with the best that is there.

Stage: run. Live pages, notebooks and renderers compile by it.

    kernels: Background[str, Kernel] = Background(wake)
    kernels.begin("opencl", lambda: program.compile("opencl"))
    kernels.is_done("opencl")        # False at first
    kernels.result("opencl")         # waits for the kernel; raises the error with which it was refused
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")


class Background(Generic[Key, Result]):
    """Results by key, each made in a thread of its own; a key whose making failed keeps the error."""

    def __init__(self, wake: Callable[[], None] = lambda: None) -> None:
        """`wake` is called in the thread that has made a result."""
        self._wake = wake
        self._done = threading.Condition()
        self._results: dict[Key, Result] = {}
        self._errors: dict[Key, Exception] = {}
        self._begun: set[Key] = set()
        self._timers: dict[Key, threading.Timer] = {}

    def begin(self, key: Key, make: Callable[[], Result]) -> None:
        """Begin to make a result, if that has not begun."""
        with self._done:
            if key in self._begun:
                return
            self._begun.add(key)
        threading.Thread(target=self._run, args=(key, make), daemon=True).start()

    def begin_after(self, seconds: float, key: Key, make: Callable[[], Result]) -> None:
        """Begin after some seconds, or at the second call, whichever is earlier."""
        if key in self._timers:
            self.begin(key, make)
        elif key not in self._begun:
            timer = self._timers[key] = threading.Timer(seconds, self.begin, (key, make))
            timer.daemon = True
            timer.start()

    def is_done(self, key: Key) -> bool:
        """Return whether the result of a key is there."""
        return key in self._results

    def error(self, key: Key) -> Exception | None:
        """Return the error with which the making of a key failed, else None."""
        return self._errors.get(key)

    def result(self, key: Key) -> Result:
        """Wait for a key that has begun; return its result, or raise its error."""
        self.wait(key)
        if key in self._errors:
            raise self._errors[key]
        return self._results[key]

    def wait(self, key: Key) -> None:
        """Wait for a key that has begun."""
        with self._done:
            self._done.wait_for(lambda: self.has_ended(key))

    def has_ended(self, key: Key) -> bool:
        """Return whether a result or an error is there."""
        return key in self._results or key in self._errors

    def is_awaited(self, key: Key) -> bool:
        """Return whether the result of a key is being made, or about to be."""
        return not self.has_ended(key) and (key in self._begun or key in self._timers)

    def forget(self, key: Key) -> None:
        """Forget the result of a key, so that it can begin again."""
        with self._done:
            self._begun.discard(key)
            self._timers.pop(key, None)
            self._results.pop(key, None)
            self._errors.pop(key, None)

    def _run(self, key: Key, make: Callable[[], Result]) -> None:
        try:
            result = make()
        except Exception as error:  # drivers raise errors of any type, and other keys continue
            with self._done:
                self._errors[key] = error
                self._done.notify_all()
        else:
            with self._done:
                self._results[key] = result
                self._done.notify_all()
        self._wake()
