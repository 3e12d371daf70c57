"""The outputs of a run over arrays of the host: memory for them, and what the caller gets.

Stage: run. Where the device uses the host's memory, a kernel writes the caller's arrays and the statuses in their
places: to copy four megabytes takes as long as a million elements of a short loop. Only arrays whose unwritten elements
have to stay as they are get a copy of those that were written.

    outputs = outputs_of(machine, prepared, call, used)
    ...                                                     # run with their buffers
    status = collect(machine, prepared, call, outputs)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from shpy.backend.base import Array, Call
from shpy.backend.opencl.device.driver import Machine
from shpy.backend.opencl.device.memory import MEMORY
from shpy.ir.nodes import Status
from shpy.ir.types import Type
from shpy.passes.pipeline import PreparedModule


class Output(NamedTuple):
    """The buffer that a kernel writes; and the array whose memory it is, None for memory of the device."""

    buffer: Any
    array: Array | None


def shape_of(type: Type, count: int) -> tuple[int, ...]:
    """Return the shape of an array of `count` elements."""
    return (count, type.size) if type.size > 1 else (count,)


def outputs_of(machine: Machine, prepared: PreparedModule, call: Call, used: list[Any]) -> list[Output]:
    """Return the outputs of a run, the statuses last; buffers of the device's pool join `used`."""
    outputs = []
    for k, slot in enumerate(prepared.module.entry.outputs):
        dtype, size = np.dtype(MEMORY[slot.type.base]), slot.type.size
        if k == len(call.outputs):
            array = np.empty(call.count, dtype) if machine.shares_memory else None
        else:
            array = call.outputs[k] if call.fresh or not prepared.status else None
        if array is not None and (array.dtype != dtype or not array.flags.c_contiguous):
            array = None
        buffer = None if array is None else machine.lend(array, size, write=True)
        if buffer is None:
            buffer, array = machine.take(call.count * size * dtype.itemsize), None
            used.append(buffer)
        outputs.append(Output(buffer, array))
    return outputs


def collect(machine: Machine, prepared: PreparedModule, call: Call, outputs: Sequence[Output]) -> Array | None:
    """Wait for a run, copy what lies on the device to the host, and return the statuses as `hand_over` does."""
    machine.finish([output.buffer for output in outputs if output.array is not None])
    arrays: list[Array] = []
    for slot, (buffer, array) in zip(prepared.module.entry.outputs, outputs, strict=True):
        if array is None:
            array = np.empty(shape_of(slot.type, call.count), MEMORY[slot.type.base])
            machine.download(array, buffer)
        arrays.append(array)
    return hand_over(prepared, call, arrays)


def hand_over(prepared: PreparedModule, call: Call, arrays: Sequence[Array]) -> Array | None:
    """Copy written elements to the caller's outputs; return the statuses if some elements were not written.

    An output that is the caller's array gets zeros where an element was not written.
    """
    status: Array | None = None
    written: Any = True
    if prepared.status and not (arrays[-1] == Status.WRITTEN).all():
        status = arrays[-1].copy()
        written = status == Status.WRITTEN
    for out, array in zip(call.outputs, arrays, strict=False):
        if array is not out:
            where = written if status is None else written.reshape(-1, *[1] * (out.ndim - 1))
            np.copyto(out, array, casting="unsafe", where=where)
        elif status is not None:
            out[~written] = 0
    return status
