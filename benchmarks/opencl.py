"""OpenCL C by hand, through pyopencl alone: the contender `hand` of some works.

device = Device.opened()
twice = device.kernel("__kernel void twice(__global float *x) { x[get_global_id(0)] *= 2; }", "twice", 1024, 16)
twice(device.shared(array))
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Device:
    """The first device of the first platform, with a queue of its own and the programs of each text."""

    cl: Any
    queue: Any
    programs: dict[str, Any] = field(default_factory=dict)

    @classmethod
    @cache
    def opened(cls) -> Device:
        """Open it, once."""
        import pyopencl as cl

        return cls(cl, cl.CommandQueue(cl.Context([cl.get_platforms()[0].get_devices()[0]])))

    def kernel(self, text: str, name: str, size: int, group: int, *bound: Any) -> Callable[..., None]:
        """Return a function that starts `size` work items with the arguments `bound`, or with those of its call."""
        if text not in self.programs:
            self.programs[text] = self.cl.Program(self.queue.context, text).build(["-cl-std=CL1.2"])
        kernel = self.cl.Kernel(self.programs[text], name)
        if bound:
            kernel.set_args(*bound)

        def start(*arguments: Any, _kept: Any = bound) -> None:  # a kernel does not keep its arguments
            if arguments:
                kernel.set_args(*arguments)
            self.cl.enqueue_nd_range_kernel(self.queue, kernel, (size,), (group,))

        return start

    def shared(self, array: np.ndarray) -> Any:
        """Return a buffer that is the array's own memory."""
        flags = self.cl.mem_flags
        return self.cl.Buffer(self.queue.context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=array)

    def empty(self, size: int) -> Any:
        """Return a buffer of `size` bytes."""
        return self.cl.Buffer(self.queue.context, self.cl.mem_flags.READ_WRITE, size)

    def copy(self, target: Any, source: Any) -> None:
        """Copy a buffer or an array to the other after all that was started, and wait."""
        self.cl.enqueue_copy(self.queue, target, source)

    def finish(self, shared: Any) -> None:
        """Wait until all has ended, and make results visible in the array of a shared buffer."""
        read = self.cl.map_flags.READ
        mapped, _ = self.cl.enqueue_map_buffer(self.queue, shared, read, 0, (shared.size,), np.uint8)
        mapped.base.release(self.queue)
        self.queue.finish()
