"""Small runs over arrays: their elements pass through arrays of ours that the device knows already.

Stage: run. Of a run over a few elements, most time goes into making buffers and setting arguments. So a kernel keeps,
for the shapes that it was run over last, arrays that are the memory of buffers and an OpenCL kernel whose arguments are
set: then a run copies the elements, starts the kernel and waits.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from shpy.backend.base import Array, Call
from shpy.backend.opencl.device.memory import MEMORY

if TYPE_CHECKING:
    from shpy.backend.opencl.device.driver import Machine
    from shpy.ir.types import Type

_SMALL: Final = 1 << 15
"""The most bytes of all inputs and outputs together. To copy more takes longer than to lend the arrays."""
_KEPT: Final = 8
"""The most shapes of runs for which a kernel keeps arrays."""
_ALIGNMENT: Final = 128
"""Bytes: the size of the longest vector of OpenCL, to which the memory of a buffer has to be aligned."""


def is_small(call: Call) -> bool:
    """Return whether it is faster to copy the arrays of a run than to lend them."""
    return sum(a.nbytes for a in call.inputs) + sum(a.nbytes for a in call.outputs) <= _SMALL


@dataclass(slots=True)
class Staged:
    """Arrays for one shape of run: `start` starts the kernel on them, with the params that were set last."""

    inputs: list[tuple[int, Array]]
    outputs: list[Array]
    buffers: list[Any]
    set_params: Callable[[list[Any]], None]
    start: Callable[[], None]


class Stages:
    """The staged runs of one kernel, by the shape of the run and the lengths of its inputs."""

    def __init__(self) -> None:
        self._runs: OrderedDict[tuple[Any, ...], Staged] = OrderedDict()

    def get(self, call: Call, make: Callable[[Call], Staged]) -> Staged:
        """Return the staged run for a call of this shape, made if there is none."""
        key = (call.shape, *map(len, call.inputs))
        run = self._runs.get(key)
        if run is None:
            run = self._runs[key] = make(call)
            if len(self._runs) > _KEPT:
                self._runs.popitem(last=False)
        else:
            self._runs.move_to_end(key)
        return run


def staged_array(machine: Machine, type: Type, count: int) -> tuple[Array, Any]:
    """Return an array for `count` elements of a type, and the buffer whose memory it is."""
    dtype = np.dtype(MEMORY[type.base])
    shape = (count, type.size) if type.size > 1 else (count,)
    size = count * type.size * dtype.itemsize
    room = np.empty(size + 2 * _ALIGNMENT, np.uint8)
    first = -room.__array_interface__["data"][0] % _ALIGNMENT
    array = room[first : first + size].view(dtype).reshape(shape)
    flags = machine.cl.mem_flags
    return array, machine.cl.Buffer(machine.context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=array)
