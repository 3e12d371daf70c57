"""Merging: store the written elements of a kernel in the streams; discarded elements keep their old values.

Stage: run. The merge is a program that runs on the device between the kernels. It also counts how often each element
was written, so that the host need not wait for the counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from shpy.ir.nodes import Status
from shpy.ir.types import Base
from shpy.lang.programs.record import InputType, record_body
from shpy.lang.recording.recorder import recording
from shpy.lang.values.builtins import cond
from shpy.lang.values.structure import Leaf
from shpy.lang.values.value import CLASSES, Value
from shpy.programs import Program

COUNT = CLASSES["Attrib", 1, Base.I]
"""The type of a status, and of the number of executions in which an element was written."""


def merge_of(types: Sequence[type[Value]], stops: bool) -> Program:
    """Return the program that selects the new or the old element by the status; its inputs are status, new, old.

    The elements have these types. A further input and output is the number of times that the element was written. If a
    loop may stop elements, the last one is the status of the first execution that was stopped, or 0.
    """
    return _merge_of(tuple((cls.size, cls.base) for cls in types), stops)


@lru_cache(maxsize=256)
def _merge_of(kinds: tuple[tuple[int, Base], ...], stops: bool) -> Program:
    leaves = [Leaf(CLASSES["Attrib", size, base]) for size, base in kinds]
    inputs: dict[str, InputType] = {"status": Leaf(COUNT)}
    inputs |= {f"new_{k}": leaf for k, leaf in enumerate(leaves)}
    inputs |= {f"old_{k}": leaf for k, leaf in enumerate(leaves)}
    inputs["times"] = Leaf(COUNT)
    if stops:
        inputs["stop"] = Leaf(COUNT)

    def body(values: Mapping[str, Any]) -> Any:
        status = values["status"]
        written = status == Status.WRITTEN
        kept = [cond(written, values[f"new_{k}"], values[f"old_{k}"]) for k in range(len(leaves))]
        times = cond(written, values["times"] + 1, values["times"])
        if not stops:
            return (*kept, times)
        stopped = (status != Status.WRITTEN) & (status != Status.DISCARDED) & (values["stop"] == Status.DISCARDED)
        return (*kept, times, cond(stopped, status, values["stop"]))

    with recording("merge", None) as record:
        return Program(record_body(record, inputs, None, body))
