"""Work in a process of its own with low priority, so that runs go on while a driver compiles.

Stage: compile. A driver's compiler takes seconds of a core, and may hold locks that runs need. So it works in another
process, which starts with the first task, ends when it has had no task for a while, and never outlives this one. A
thread waits for its answers. Neither is waited for at the end of the process.

    answer = background().submit(task)      # a picklable function without arguments
    answer.ended                            # False until the process has answered
    answer.result()                         # Refused with the reason where the task raised or the process ended
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import IO, Any, Final, TypeVar

from shpy.backend.device.answer import Answer
from shpy.backend.device.once import once
from shpy.backend.device.processes import at_exit

T = TypeVar("T")

_LINGER: Final = 10.0
"""Seconds without a task after which the process ends, since it holds memory and starts again in half a second."""
_NICENESS: Final = 19
"""The niceness of the process, the highest, on systems without a scheduling policy for idle time."""
_CHECKED: Final = 0.5
"""Seconds between two checks that the parent process still exists."""


class Refused(Exception):
    """A task has no result; the message says why."""


class Background:
    """A process for tasks, one after the other, and the thread that waits for it.

    A forked child has neither, and submits nothing: its parent's driver does not serve it.
    """

    def __init__(self) -> None:
        self._tasks: SimpleQueue[tuple[Callable[[], Any], weakref.ref[Answer[Any]]]] = SimpleQueue()
        self._process: subprocess.Popen[bytes] | None = None
        self._working = False
        threading.Thread(target=self._serve, name="shpy-background", daemon=True).start()
        at_exit(self._end)

    @property
    def busy(self) -> bool:
        """Return whether the process has work, so that what is timed now may take longer than usual."""
        return self._working or not self._tasks.empty()

    def submit(self, task: Callable[[], T]) -> Answer[T]:
        """Run a task in the process, which skips it if nobody holds the answer any longer."""
        answer: Answer[T] = Answer()
        self._tasks.put((task, weakref.ref(answer)))
        return answer

    def _serve(self) -> None:
        while True:
            try:
                task, reference = self._tasks.get(timeout=None if self._process is None else _LINGER)
            except Empty:
                self._stop()
                continue
            self._working = True
            if reference() is not None:
                _answer(reference, partial(self._ask, task))
            self._working = False
            del task, reference

    def _ask(self, task: Callable[[], Any]) -> Any:
        """Send a task to the process and return its answer."""
        try:
            if self._process is None:
                self._process = _started()
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            pickle.dump(task, self._process.stdin)
            self._process.stdin.flush()
            refusal, answer = pickle.load(self._process.stdout)
        except Exception as error:
            self._stop()
            if isinstance(error, EOFError | OSError):
                raise Refused("the process that compiles ended") from error
            raise
        if refusal is not None:
            raise Refused(refusal)
        return answer

    def _stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            with suppress(OSError):  # a pipe whose reader is gone
                process.communicate()

    def _end(self) -> None:
        """End the process with its parent."""
        if self._process is not None:
            self._process.kill()


def _answer(reference: weakref.ref[Answer[Any]], ask: Callable[[], Any]) -> None:
    """Give the answer or its error; do nothing if its owner has dropped it."""
    value, refusal = None, None
    try:
        value = ask()
    except Exception as error:
        refusal = error if isinstance(error, Refused) else Refused(f"{type(error).__name__}: {error}")
    answer = reference()
    if answer is None:
        return
    if refusal is not None:
        answer.refuse(refusal)
    else:
        answer.give(value)


@once
def background() -> Background:
    """Return the background process of this process."""
    return Background()


def _started() -> subprocess.Popen[bytes]:
    """Start the process. Raises Refused in a frozen program, which has no Python to start."""
    if getattr(sys, "frozen", False) or not sys.executable:
        raise Refused("there is no Python to compile in another process")
    path = [str(p) for p in sys.path]
    command = f"import sys; sys.path[:] = {path!r}; from shpy.backend.opencl.device.background import serve; serve()"
    # A process group of its own keeps Ctrl-C, which is meant for this process, from it. It stays in the session,
    # because Linux compares priorities only within a session.
    group: dict[str, Any] = {"process_group": 0} if os.name == "posix" else {}
    return subprocess.Popen(
        [sys.executable, "-c", command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        # PoCL's threads, which compile, take whatever core is idle.
        env={**os.environ, "POCL_AFFINITY": "0"},
        **group,
    )


def serve() -> None:
    """Run the tasks that arrive on standard input until it ends; this is the main function of the process."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # a driver may print
    threading.Thread(target=_follow, args=(os.getppid(),), daemon=True).start()
    _give_way()
    with suppress(EOFError):
        while True:
            _do(pickle.load(sys.stdin.buffer), answers)
    os._exit(0)  # at once: a driver may take its time


def _give_way() -> None:
    """Use only idle time of the cores, since even a nice process may delay a thread that wakes up."""
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    elif hasattr(os, "nice"):
        os.nice(_NICENESS)


def _do(task: Callable[[], Any], answers: IO[bytes]) -> None:
    try:
        answer = pickle.dumps((None, task()))
    except Exception as error:
        answer = pickle.dumps((getattr(error, "message", None) or f"{type(error).__name__}: {error}", None))
    answers.write(answer)
    answers.flush()


def _follow(parent: int) -> None:
    """End this process once its parent has ended, even while a driver compiles or others hold the pipe open."""
    while os.getppid() == parent:
        time.sleep(_CHECKED)
    os._exit(1)
