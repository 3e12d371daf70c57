"""Says that a compilation takes long, and what makes it long, while it lasts.

Stage: emit. Takes a module that is being compiled; prints one line to standard error, or nothing.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from shpy.ir.nodes import Module
from shpy.ir.traverse import callee_of, walk
from shpy.passes.size import copies_of

PATIENCE = 5.0
"""Seconds after which a compilation is announced."""


@contextmanager
def announced(module: Module, backend: str) -> Iterator[None]:
    """Announce a compilation that takes longer than `PATIENCE`, once, unless SHPY_QUIET is set."""
    if os.environ.get("SHPY_QUIET"):
        yield
        return
    said = threading.Event()
    started = time.monotonic()

    def announce() -> None:
        said.set()
        _write(f"shpy: compiling {describe(module, backend)} …")

    timer = threading.Timer(PATIENCE, announce)
    timer.daemon = True  # a process that ends does not wait for it
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        seconds = time.monotonic() - started
        # Some drivers compile with Python's lock held, and no thread can speak meanwhile.
        if seconds > PATIENCE and not said.is_set():
            _write(f"shpy: compiled {describe(module, backend)} in {seconds:.0f} s")


def _write(line: str) -> None:
    with suppress(AttributeError, OSError, ValueError):  # there is no standard error, or it is closed
        sys.stderr.write(f"{line} (SHPY_QUIET=1 omits this line)\n")
        sys.stderr.flush()


def describe(module: Module, backend: str) -> str:
    """Return `shade for glsl (12,345 operations; 100 calls of noise3 with 11,000 of them)`.

    Operations count as often as their function is called, and calls of a function that calls others count theirs too.
    """
    times = copies_of(module)
    work = {f.name: times[f.name] * sum(callee_of(s) is None for s in walk(f.body)) for f in reversed(module.functions)}
    told = f"{sum(work.values()):,} operations"
    # The deepest function that most of the work lies in: its callers do nothing but call it.
    called = (name for name in work if times[name] and name != module.entry.name)
    largest = max(called, key=work.__getitem__, default=None)
    if largest is not None:
        told += f"; {times[largest]:,} call{'s' * (times[largest] != 1)} of {largest} with {work[largest]:,} of them"
    return f"{module.name} for {backend} ({told})"
