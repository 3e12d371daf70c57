"""Reports a long compilation, and its reason, while it lasts.

Stage: run. Takes a module that is being compiled; prints one line to standard error, or nothing. The live pages `hear`
of every compilation.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from shpy.ir.nodes import Module
from shpy.ir.traverse import callee_of, walk
from shpy.passes.size import copies_of

PATIENCE = 1.0
"""Seconds after which a compilation is announced."""
_MANY_CALLS = 10
"""Calls of a function from which on the line names SH_FOR. Fifty noises take llvmpipe 1.5 s, and in a loop 0.2 s."""


@contextmanager
def announced(module: Module, backend: str) -> Iterator[None]:
    """Announce a compilation that takes longer than PATIENCE seconds, once, unless SHPY_QUIET is set."""
    with _told(module, backend), _printed(module, backend, PATIENCE):
        yield


Heard = Callable[[str], None]
_hearing: list[Heard] = []
_lasting: dict[object, str] = {}
"""The compilations that last, by their blocks, in the order in which they began."""
_lock = threading.Lock()
SPOKEN = {"numpy": "numpy", "opencl": "OpenCL", "glsl": "GLSL"}
"""The names of backends as sentences have them."""


def hear(heard: Heard) -> None:
    """Call a function, from the thread that compiles, with what is being compiled, and with "" when that has ended.

    hear(print)     # compiling 10,897 operations for OpenCL
    """
    _hearing.append(heard)


@contextmanager
def _told(module: Module, backend: str) -> Iterator[None]:
    """Tell those who hear when a compilation begins and ends; of several that last, the one that began last."""
    if not _hearing:
        yield
        return
    text = f"compiling {sum(_work(module).values()):,} operations for {SPOKEN[backend]}"
    block = object()
    try:
        _tell(lambda: _lasting.update({block: text}))
        yield
    finally:
        _tell(lambda: _lasting.pop(block, None))


def _tell(change: Callable[[], object]) -> None:
    with _lock:
        change()
        for heard in _hearing:
            heard(next(reversed(_lasting.values()), ""))


@contextmanager
def _printed(module: Module, backend: str, patience: float) -> Iterator[None]:
    """Print a line where a compilation takes longer than `patience` seconds, unless SHPY_QUIET is set."""
    if os.environ.get("SHPY_QUIET"):
        yield
        return
    announcement = threading.Event()
    started = time.monotonic()

    def announce() -> None:
        announcement.set()
        _write(f"shpy: compiling {describe(module, backend)} …")

    timer = threading.Timer(patience, announce)
    timer.daemon = True  # a process that ends does not wait for it
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        seconds = time.monotonic() - started
        # Some drivers compile with Python's lock held, and no thread can speak meanwhile.
        if seconds > patience and not announcement.is_set():
            _write(f"shpy: compiled {describe(module, backend)} in {seconds:.0f} s")


def _write(line: str) -> None:
    with suppress(AttributeError, OSError, ValueError):  # there is no standard error, or it is closed
        sys.stderr.write(f"{line} (SHPY_QUIET=1 omits this line)\n")
        sys.stderr.flush()


def describe(module: Module, backend: str) -> str:
    """Return `shade for glsl (12,345 operations; 100 calls of noise3 with 11,000 of them; SH_FOR writes one call …)`.

    Operations count as often as their function is called, and calls of a function that calls others count theirs too.
    OpenGL's compilers copy a function to each of its calls: one call in a loop takes a fraction of the time.
    """
    times, work = copies_of(module), _work(module)
    told = f"{sum(work.values()):,} operations"
    # The deepest function that most of the work lies in: its callers do nothing but call it.
    called = (name for name in work if times[name] and name != module.entry.name)
    largest = max(called, key=work.__getitem__, default=None)
    if largest is not None:
        told += f"; {times[largest]:,} call{'s' * (times[largest] != 1)} of {largest} with {work[largest]:,} of them"
        if backend == "glsl" and times[largest] >= _MANY_CALLS:
            told += f"; SH_FOR around one call of {largest} compiles faster than a Python loop around many"
    return f"{module.name} for {backend} ({told})"


def _work(module: Module) -> dict[str, int]:
    """Return the operations of each function, as often as it is called."""
    times = copies_of(module)
    return {f.name: times[f.name] * sum(callee_of(s) is None for s in walk(f.body)) for f in reversed(module.functions)}
