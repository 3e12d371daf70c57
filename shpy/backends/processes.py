"""Which process uses a driver: a forked child has its parent's driver, but not the driver's threads, and would hang.

Stage: compile, run. A backend asks before it touches its driver, and before it takes a lock that another thread of the
parent may have held at the time of the fork.

    OPENCL = Driver("opencl")
    OPENCL.use()        # BackendUnavailable in a child of a process that has used OpenCL
"""

from __future__ import annotations

import os

from shpy.errors import BackendUnavailable

__all__ = ["Driver"]


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
        elif self._process != process:
            raise BackendUnavailable(
                f"this process was forked after its parent had used {self.backend}, whose driver does not survive that",
                cure='multiprocessing.get_context("spawn"), or fork before the first use; numpy works in any process',
            )

    def release(self) -> None:
        """Forget that the driver was used: it was not there."""
        self._process = None
