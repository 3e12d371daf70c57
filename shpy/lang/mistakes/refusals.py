"""Refusals of symbolic values: to be Python bools, ints or floats while the program is recorded.

Stage: record. The message names the construct that asked, found in the source where there is one.
"""

from __future__ import annotations

from typing import Never

import numpy as np

from shpy.errors import RecordError
from shpy.lang.mistakes.explain import explain_bool, explain_conversion
from shpy.lang.recording.location import here
from shpy.lang.values.abstract import AbstractValue


def refuse_bool(value: AbstractValue) -> bool:
    """Return the bool of a constant; RecordError for a symbolic value."""
    if value._frame is None:
        array = np.asarray(value)
        if array.ndim:
            raise TypeError(f"{type(value).__name__} has several components: sh.any(v) or sh.all(v)")
        return bool(array)
    loc = here()
    found = explain_bool(loc) if loc is not None else None
    message, cure = found or (
        "Python needs to know here whether a value holds, and it has none while the program is recorded",
        "with SH_IF(c): for a branch, & | ~ for and, or, not, sh.cond(c, a, b) for a choice",
    )
    raise RecordError(message, loc=loc, cure=cure)


def refuse_array(value: AbstractValue) -> Never:
    """RecordError for a symbolic value that numpy is to take: as an index, or as the argument of a function."""
    loc = here()
    found = explain_conversion(loc, "index") if loc is not None else None
    message, cure = found or (
        f"{value._called()} has no value while the program is recorded, so numpy cannot take it",
        "the function of the same name in shpy, sh.sin(x) for np.sin(x); sh.Table(array, type)[i] for array[i]",
    )
    raise RecordError(message, loc=loc, cure=cure)


def refuse_conversion(value: AbstractValue, kind: str, spoken: str) -> Never:
    """RecordError for a symbolic value that is to be an int, a float or an index."""
    loc = here()
    found = explain_conversion(loc, kind) if loc is not None else None
    cures = {
        "int": "sh.Attrib1i(x)",
        "float": "sh.Attrib1f(x)",
        "index": "sh.Table(list, sh.Attrib1f)[x]",
        "round": "sh.round(x)",
    }
    message, cure = found or (
        f"{spoken} needs a number, and this value has none while the program is recorded",
        cures.get(kind, "a value of the language"),
    )
    raise RecordError(message, loc=loc, cure=cure)
