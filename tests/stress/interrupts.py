"""Ctrl-C at a chosen place of a run: at a line of shpy's runtimes, or in a draw on the context's thread.

A signal may arrive at any line of the main thread, so a trace function raises there. A draw runs on
another thread while the main one waits: there a real signal is sent, and the draw waits until the caller has let go.

    with at_line(40):
        kernel(x)                  # raises Interrupted if it executes as many lines of the runtimes
"""

from __future__ import annotations

import linecache
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from pages import wait_until

from shpy.backend.glsl.device.context import Context

SHPY = Path(sys.modules["shpy"].__file__ or "").parent
LOCKS = (threading.__file__, os.path.join(os.path.dirname(threading.__file__), "concurrent", ""))
"""Modules of Python whose locks a runtime may hold: an interrupt may come between a lock and its `with` block."""
RUNTIMES = tuple(str(SHPY / part) for part in ("backend", "streams", "chains", "collectives"))


class Interrupted(KeyboardInterrupt):
    """The interrupt of a test."""


def _raise(number: int, frame: Any) -> None:
    raise Interrupted


@contextmanager
def at_line(after: int) -> Iterator[None]:
    """Raise Interrupted in this thread once `after` lines of the runtimes were executed, or returns of their locks."""
    left = after

    def follow(frame: Any, event: str, _: Any) -> Any:
        if frame.f_code.co_filename.startswith(LOCKS):
            return leave
        if not frame.f_code.co_filename.startswith(RUNTIMES):
            return None
        entered: set[int] = set()

        def count(frame: Any, event: str, _: Any) -> Any:
            nonlocal left
            if event == "line" and not hears_nothing(frame, entered):
                left -= 1
                if left == 0:
                    raise Interrupted
            return count

        return count

    def leave(frame: Any, event: str, _: Any) -> Any:
        nonlocal left
        if event == "return":
            left -= 1
            if left == 0:
                raise Interrupted
        return leave

    before = sys.gettrace()
    sys.settrace(follow)
    try:
        yield
    finally:
        sys.settrace(before)


def hears_nothing(frame: Any, entered: set[int]) -> bool:
    """Return whether CPython handles no signal at a line: at `try:`, or at a `with` that the frame leaves.

    An exception there would pass by the `__exit__` of the block around it, and a lock would stay locked.
    """
    text = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
    if not text.startswith("with "):
        return text.startswith("try:")
    leaves = frame.f_lineno in entered
    entered.add(frame.f_lineno)
    return leaves


@contextmanager
def in_a_draw(after: int) -> Iterator[None]:
    """Send SIGINT to the main thread while the context's thread is in its draw of this number."""
    left, real = after, Context.go_on

    def go_on(context: Context) -> None:
        nonlocal left
        left -= 1
        if left == 0 and threading.current_thread() is not threading.main_thread():
            job = context._job
            assert job is not None
            os.kill(os.getpid(), signal.SIGINT)
            wait_until(lambda: not job.is_awaited)
        real(context)

    before = signal.signal(signal.SIGINT, _raise)
    try:
        with patch.object(Context, "go_on", go_on):
            yield
    finally:
        signal.signal(signal.SIGINT, before)
