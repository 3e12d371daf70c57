"""The private memory that a work group may have on a processor, whose drivers put it on the stack of a thread.

Stage: compile. PoCL lays the local arrays of all work items of a group on the stack of the thread that runs it. Nothing
checks them against its end, so a kernel with more ends the process by SIGSEGV. The size of the stack is that of every
new thread of the process: 8 MB where `ulimit -s` says so, 2 MB where it says "unlimited", 512 kB on macOS, 128 kB with
musl. A driver may choose another one, so trials of `SIZES` are run in another process, too.

    limit = most_private(tried=6 << 20, stack=thread_stack())
"""

from __future__ import annotations

import ctypes
import threading
from typing import Final

from shpy.backend.opencl.device.trial import Trial

SIZES: Final = tuple(96 << 10 << 2 * k for k in range(4))
"""Bytes of private memory that are tried: three quarters of 128 kB, 512 kB, 2 MB and 8 MB."""
_LEAST: Final = 16 << 10
"""Bytes that every thread has: the smallest stack that POSIX allows a system to give is as large."""
_STRIDE: Final = 256
"""Ints between two places that a trial touches: less than a page, so that every page is."""


def trial_of(size: int) -> Trial:
    """Return the trial that succeeds where a work item may have an array of this many bytes."""
    length = size // 4
    up, down = f"int i = 0; i < {length}; i += {_STRIDE}", f"int i = {length - _STRIDE}; i >= 0; i -= {_STRIDE}"
    stored, loaded = (f"big[i + (a[{k}] & {_STRIDE - 1})]" for k in (1, 2))
    loops = f"for ({up}) {{ {stored} = i + n; }} for ({down}) {{ s ^= {loaded}; }}"
    statements = f"int big[{length}], n = a[0], s = 0; {loops} a[0] = s;"
    expected = 0
    for i in range(0, length, _STRIDE):
        expected ^= i + 5
    return Trial("int", statements, (5, 3, 3), (expected, 3, 3))


def name_of(size: int) -> str:
    """Return the name of the trial of a size."""
    return f"private{size}"


def thread_stack() -> int | None:
    """Return the bytes of the stack that the C library gives to a new thread; None where it does not tell them."""
    try:
        library = ctypes.CDLL(None)
        attributes, size = ctypes.create_string_buffer(1024), ctypes.c_size_t()
        if library.pthread_attr_init(attributes) or library.pthread_attr_getstacksize(attributes, ctypes.byref(size)):
            return None
        library.pthread_attr_destroy(attributes)
    except (AttributeError, OSError, TypeError):  # Windows has no such functions
        return None
    # A driver may run kernels in the thread that waits for them, which is one of Python's.
    return min(size.value, threading.stack_size() or size.value)


def most_private(tried: int, stack: int | None) -> int:
    """Return the most bytes of local arrays of a work group; `tried`: those that a trial had.

    The rest of the stack is for all else that a kernel holds there, whose size only its compiler knows.
    """
    sizes = [n for n in (tried // 2, None if stack is None else stack * 3 // 8) if n]
    return max(min(sizes, default=0), _LEAST)
