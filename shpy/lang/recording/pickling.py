"""Pickling: values that other processes are given, and the error for those that cannot be sent.

Stage: record, and above. Programs, kernels, chains, Params, Tables and streams travel by value: the process that gets
one needs neither the user's module nor the classes of the user's structs.
"""

from __future__ import annotations

from typing import Any, Self

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here


class Unchanging:
    """A value that does not change, so a copy of it is the value itself."""

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: Any) -> Self:
        return self


def cannot_travel(what: str, cause: str, cure: str) -> ShpyTypeError:
    """Return the error for a value that cannot be sent to another process."""
    return ShpyTypeError(f"{what} cannot travel: {cause}", loc=here(), cure=cure)
