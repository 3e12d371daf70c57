"""A queue, and a run of steps over a grid by a kernel written by hand, for pyopencl's versions of the chains."""

from typing import Any

import numpy as np

import shpy as sh
from benchmarks.work import Run


def new_queue() -> Any:
    """Return a queue of a context of its own on the device that ours take, so that nothing of ours runs in it."""
    import pyopencl as cl

    device = sh.Stream.empty(1, sh.Attrib1i, "opencl").native().queue.device
    return cl.CommandQueue(cl.Context([device]))


def run_by_hand(text: str, name: str, start: np.ndarray, border: str, steps: int) -> Run:
    """Return a run of an even number of steps over a grid (n, n), n >= 8: each step enqueues one kernel.

    The kernel `name` of `text` reads one grid and writes another, eight columns in each item. A row has a border of one
    element on both sides: `np.pad(mode=border)` fills it at the start, and the kernel in each step.
    """
    import pyopencl as cl

    queue, n = new_queue(), len(start)
    step = getattr(cl.Program(queue.context, text).build([f"-DN={n}"]), name)
    size = n * (n + 2) * start.itemsize
    a, b = (cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, size) for _ in range(2))
    items = (-(-n // 8), n)

    def run() -> np.ndarray:
        field = np.pad(start, ((0, 0), (1, 1)), mode=border)
        cl.enqueue_copy(queue, a, field)
        for _ in range(steps // 2):
            step(queue, items, None, a, b)
            step(queue, items, None, b, a)
        cl.enqueue_copy(queue, field, a)
        return field[:, 1:-1].copy()

    return run
