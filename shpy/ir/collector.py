"""Python's cycle collector, paused while a program is recorded or compiled.

The nodes of the IR refer to each other by id, so there are no cycles for the collector to find. Its walks over hundreds
of thousands of new nodes take a third of the time, a share that increases with the size of a program.

    with uncollected():
        text = print_kernel(prepare(module, options, target).module).text
"""

from __future__ import annotations

import gc
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class _Pause:
    """The blocks of all threads that pause the collector, and whether the first of them has to turn it on again."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.threads: dict[object, int] = {}
        """The thread of each block."""
        self.was_on = False

    def enter(self, block: object) -> None:
        """Enter a block; the first block disables the garbage collector."""
        with self.lock:
            if not self.threads:
                self.was_on = gc.isenabled()
            self.threads[block] = threading.get_ident()
            gc.disable()

    def leave(self, block: object) -> None:
        """Leave a block, unless that is done; the last block restores the collector's state."""
        with self.lock:
            self.threads.pop(block, None)
            self._restore()

    def forget_other_threads(self) -> None:
        """Drop the blocks of other threads, since in the child of a fork only the forking thread continues."""
        self.lock = threading.RLock()
        if self.threads:
            own = threading.get_ident()
            self.threads = {block: thread for block, thread in self.threads.items() if thread == own}
            self._restore()

    def _restore(self) -> None:
        if self.was_on and not self.threads:
            gc.enable()
            self.was_on = False


_PAUSE = _Pause()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_PAUSE.forget_other_threads)


@contextmanager
def uncollected() -> Iterator[None]:
    """Run the block without the collector. The last of these blocks in all threads restores its state."""
    block = object()
    try:
        _PAUSE.enter(block)
        yield
    finally:
        try:
            _PAUSE.leave(block)
        finally:  # Ctrl-C in the first call would otherwise leave the collector off for good
            _PAUSE.leave(block)
