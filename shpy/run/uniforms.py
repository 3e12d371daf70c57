"""Dependent uniforms at run time: numpy evaluates each as a program of one element, before the kernel runs.

Stage: run. A value is kept until one of its sources changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.backend.base import Options
from shpy.backend.registry import backend
from shpy.ir.collector import uncollected
from shpy.lang.data.tables import Table
from shpy.lang.programs.record import RecordedProgram, record_body
from shpy.lang.recording.recorder import need_frame, recording
from shpy.lang.values import arithmetic
from shpy.lang.values.dependent import Dependent, record_expression
from shpy.lang.values.structure import Leaf
from shpy.lang.values.value import CLASSES
from shpy.run.kernel import Kernel
from shpy.streams.stream import memory_of_table


@dataclass(slots=True)
class _UniformKernel:
    """A uniform's kernel at a precision and mode; `last` is the state of its sources and the result at the last run."""

    kernel: Kernel
    copies: dict[Table, Table]
    """The elements on the host of the streams that the uniform reads, wherever they lie."""
    last: tuple[Any, Any] = (None, None)


def evaluate(uniform: Dependent, precision: Any, math: Any) -> NDArray[Any]:
    """Return the uniform's value, of shape () or (size,), computed by running its expression as a program."""
    keeps = uniform._const.kept
    kept = keeps.get((precision, math))
    if kept is None:
        recorded = _recorded(uniform)
        copies = {
            t: Table(t.host_array(), t.type, "copy") for t in recorded.tables.values() if memory_of_table(t) is not None
        }
        recorded = replace(recorded, tables={name: copies.get(table, table) for name, table in recorded.tables.items()})
        kernel = Kernel(recorded, backend("numpy"), Options(precision, math=math))
        kept = keeps[precision, math] = _UniformKernel(kernel, copies)
    for stream, table in kept.copies.items():
        elements = stream.host_array()  # kernels write streams, and count no versions
        if not np.array_equal(elements.view(np.uint8), table.host_array().view(np.uint8)):
            table.update(elements)
    state = [
        kept.copies.get(source, source).version if isinstance(source, Table) else source._const
        for source in uniform.sources
    ]
    before, value = kept.last
    if before != state:
        value = np.asarray(kept.kernel())
        kept.last = state, value  # in one assignment, since other threads may read it
    result: NDArray[Any] = value
    return result


def _recorded(uniform: Dependent) -> RecordedProgram:
    """Return the program without inputs that computes the uniform."""
    value: Any = uniform
    cls = CLASSES[value.kind, value.size, value.base]

    def body(arguments: Any) -> Any:
        frame = need_frame("a uniform")
        return arithmetic.make_value(cls.kind, cls.type, frame, record_expression(frame, uniform.root))

    with uncollected(), recording(uniform.name or "uniform", value._loc) as record:
        return record_body(record, {}, Leaf(cls), body)
