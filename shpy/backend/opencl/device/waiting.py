"""Waits for a device so that Ctrl-C is heard: a thread waits in the driver, and the caller waits for that thread.

Stage: run. A signal does not end a wait inside a driver, and a driver cannot stop what runs. So the wait ends, the run
goes on up to the end of its dispatch, and all that it uses is kept until then.

    waiter = Waiter(lock)
    waiter.wait(event)           # KeyboardInterrupt ends it
    waiter.keep(event, buffers)  # until the event is complete
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
from queue import SimpleQueue
from typing import Any, Final

from shpy.backend.device.processes import HEARD, Answer

_GRACE: Final = 1.0
"""Seconds that the end of an interrupted process waits for the device: most dispatches take less."""


class _Job(Answer[None]):
    """A wait for an event; `kept` holds the memory that the device uses until then."""

    __slots__ = ("event", "kept")

    def __init__(self, event: Any, kept: Any = None) -> None:
        super().__init__()
        self.event = event
        self.kept = kept


class Waiter:
    """The waits of one device, whose runs hold `lock`.

    At the end of the process no thread may be inside the driver: it would end the process by SIGABRT. Threads that the
    process does not wait for (daemons) end after their dispatch. `end` waits for that and keeps the lock, so that only
    its own thread, which calls the exit handlers, can run kernels afterwards.
    """

    def __init__(self, lock: Any) -> None:
        self._lock = lock
        self._jobs: SimpleQueue[_Job] = SimpleQueue()
        self._ending = False
        self._interrupted = False
        threading.Thread(target=self._serve, name="shpy-opencl", daemon=True).start()

    def wait(self, event: Any) -> None:
        """Wait until the event is complete; raises the driver's error, or KeyboardInterrupt."""
        if sys.is_finalizing():  # threads do not run any more
            event.wait()
            return
        job = _Job(event)
        self._jobs.put(job)
        job.wait()
        if self._ending and threading.current_thread().daemon:
            raise SystemExit  # ends this thread alone and releases the lock
        try:
            job.result()
        finally:
            del job  # the traceback of its error holds this frame

    def keep(self, event: Any, things: Any) -> None:
        """Hold references to a run's memory until the event completes, after Ctrl-C has interrupted the run."""
        self._interrupted = True
        self._jobs.put(_Job(event, things))

    def _serve(self) -> None:
        while True:
            job = self._jobs.get()
            try:
                if job.event is not None:
                    job.event.wait()
                job.give(None)
            except Exception as error:
                job.refuse(error)
            del job  # and its references

    def end(self) -> None:
        """Leave no thread inside the driver; an interrupted process ends by SIGINT where its device goes on."""
        self._ending = True
        last = _Job(None)
        try:
            while not self._lock.acquire(timeout=HEARD):
                pass
            self._jobs.put(last)
            ended = last.wait(_GRACE if self._interrupted else math.inf)
        except KeyboardInterrupt:
            ended = False
        if not ended:
            sys.stdout.flush()
            sys.stderr.flush()
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            os.kill(os.getpid(), signal.SIGINT)
