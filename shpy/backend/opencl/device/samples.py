"""Samples of a run: the same elements, or the middle rows of many, into memory of their own.

Stage: run. A trial of two widths runs each of them over the same sample again and again, and nobody sees what it
writes.

    sample = sample_of(call, 0.1)              # or sample_on_device(device_call, 0.1, space)
    run = sample.prepare(executable)
    run()                                      # waits for the end
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from shpy.backend.base import Call, DeviceCall, Executable
from shpy.backend.opencl.device.memory import OpenCLSpace

Shape = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Sample:
    """Runs over `count` elements: `prepare` returns a function that makes an executable run and waits for its end."""

    count: int
    prepare: Callable[[Executable], Callable[[], object]]


def sample_of(call: Call, share: float) -> Sample:
    """Return about this share, from 0 to 1, of a run over arrays."""
    shape, begin, end = _middle(call.shape, share)
    inputs = tuple(a[begin:end] if len(a) == call.count else a for a in call.inputs)
    outputs = tuple(np.empty_like(o[begin:end]) for o in call.outputs)
    part = replace(call, shape=shape, inputs=inputs, outputs=outputs)
    return Sample(part.count, lambda executable: lambda: executable.run(part))


def sample_on_device(call: DeviceCall, share: float, space: OpenCLSpace) -> Sample:
    """Return about this share, from 0 to 1, of a run over memory of the device."""
    shape, begin, end = _middle(call.shape, share)
    all_, count = math.prod(call.shape), end - begin
    inputs = tuple(space.part(m, begin, count) if m.count == all_ > count else m for m in call.inputs)
    outputs = tuple(space.allocate(count, m.type, m.dtype) for m in call.outputs)
    status = None if call.status is None else space.allocate(count, call.status.type, call.status.dtype)
    part = replace(call, shape=shape, inputs=inputs, outputs=outputs, status=status)

    def prepare(executable: Executable) -> Callable[[], None]:
        run = executable.ready(part)

        def run_to_the_end() -> None:
            space.start([run])
            space.finish()

        return run_to_the_end

    return Sample(count, prepare)


def _middle(shape: Shape, share: float) -> tuple[Shape, int, int]:
    """Return the shape of the middle rows that are about this share of all rows, their first element and their end."""
    if not shape:
        return shape, 0, 1
    rows, *rest = shape
    kept = max(1, min(rows, int(rows * share)))
    each = math.prod(rest)
    begin = (rows - kept) // 2 * each
    return (kept, *rest), begin, begin + kept * each
