"""Guards: a program that discards the elements for which a condition does not hold.

Stage: record, from recordings to a recording.

    guarded(shade, None, "alive")        # shade with one more input, alive: Attrib1b
    guarded(shade, is_alive, "")         # shade with the inputs of is_alive, evaluated first
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shpy.ir.types import Base
from shpy.lang.programs.control import SH_DISCARD
from shpy.lang.programs.inline import call_recorded
from shpy.lang.programs.record import InputType, RecordedProgram, rerecorded
from shpy.lang.values.structure import Leaf
from shpy.lang.values.value import CLASSES

MASK = CLASSES["Attrib", 1, Base.B]


def guarded(recorded: RecordedProgram, condition: RecordedProgram | None, mask: str) -> RecordedProgram:
    """Return `recorded` with the elements discarded first for which the condition does not hold.

    The condition is a program that returns one bool, whose inputs are shared with those of the same names, or, if None,
    the input `mask`, which is added unless it is there. Who calls it has checked that shared inputs have one type.
    """
    added: Mapping[str, InputType] = {mask: Leaf(MASK)} if condition is None else condition.inputs
    types = {**recorded.inputs, **{name: type_ for name, type_ in added.items() if name not in recorded.inputs}}

    def body(arguments: Mapping[str, Any]) -> Any:
        if condition is None:
            holds = arguments[mask]
        else:
            holds = call_recorded(condition, {name: arguments[name] for name in condition.inputs})
        SH_DISCARD(~holds)
        return call_recorded(recorded, {name: arguments[name] for name in recorded.inputs})

    defaults = {**(condition.defaults if condition is not None else {}), **recorded.defaults}
    return rerecorded(recorded.module.name, recorded, types, recorded.output, body, defaults)
