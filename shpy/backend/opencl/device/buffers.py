"""New buffers of an OpenCL device, and the pages of those that lie in the host's memory.

Stage: run. Linux uses pages of 2 MB for memory whose owner asks for them, where `transparent_hugepage/enabled` is set
to `madvise`, as on Debian and Ubuntu. numpy asks for its arrays. PoCL does not ask for its buffers, and kernels that
read or write ten million numbers then spend up to a fifth of their time on small pages.

    buffer = new_buffer(machine, 4096)
"""

from __future__ import annotations

import ctypes
import mmap
from functools import cache
from typing import Any, Final

import numpy as np

_TRIED: Final = 1 << 20
"""Bytes of a buffer from which on the host allocates and frees as much memory before the driver does."""
_LARGE: Final = 4 << 20
"""Bytes of a buffer from which on huge pages are asked for; numpy has the same limit for its arrays."""


def new_buffer(machine: Any, size: int) -> Any:
    """Return a new buffer; MemoryError of the driver if the host's memory, where it is used, has no such part.

    PoCL allocates a buffer at its first use, and ends the process if it cannot.
    """
    cl, shared = machine.cl, machine.shares_memory
    if shared and size >= _TRIED:
        try:
            np.empty(size, np.uint8)
        except MemoryError as error:
            raise cl.MemoryError(str(error)) from error
    buffer = cl.Buffer(machine.context, cl.mem_flags.READ_WRITE, size)
    if shared and size >= _LARGE and hasattr(mmap, "MADV_HUGEPAGE"):
        _ask_for_huge_pages(machine, buffer)
    return buffer


def _ask_for_huge_pages(machine: Any, buffer: Any) -> None:
    """Ask for huge pages in the memory of a new buffer, which is only advice: a system may not have them.

    The buffer is mapped through a queue of its own, since the device's queue would first end what it runs.
    """
    cl = machine.cl
    queue = cl.CommandQueue(machine.context)
    memory, _ = cl.enqueue_map_buffer(
        queue, buffer, cl.map_flags.WRITE_INVALIDATE_REGION, 0, (buffer.size,), np.uint8, is_blocking=True
    )
    start = memory.__array_interface__["data"][0]
    first = -(-start // mmap.PAGESIZE) * mmap.PAGESIZE
    _madvise()(first, (start + buffer.size - first) // mmap.PAGESIZE * mmap.PAGESIZE, mmap.MADV_HUGEPAGE)
    memory.base.release(queue)
    queue.finish()


@cache
def _madvise() -> Any:
    function = ctypes.CDLL(None).madvise
    function.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    return function
