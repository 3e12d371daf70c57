"""The base class of the objects that a name may hold while a program is recorded.

Stage: record. The check of mistakes knows values by it, and lies below them.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import current_frame


class Symbolic:
    """Base class of the objects that a name may hold: a value, a matrix, a struct or an array.

    In a recording, `copy.copy` and `copy.deepcopy` call the method `copy`. Outside, they copy as pickling does.
    """

    __slots__ = ()

    def __copy__(self) -> Any:
        return _copied(self, lambda parts: parts)

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        return _copied(self, lambda parts: deepcopy(parts, memo))

    def __delitem__(self, part: Any) -> None:
        raise ShpyTypeError(
            f"del takes nothing from {type(self).__name__}, whose parts are fixed", loc=here(), cure="x[:] = …, a store"
        )

    __delattr__ = __delitem__


def _copied(value: Any, kept: Callable[[tuple[Any, ...]], tuple[Any, ...]]) -> Any:
    """Return a copy; outside of a recording, one that is made of the parts that are kept."""
    if current_frame() is not None:
        return type(value).copy(value)  # not `value.copy`: a struct may have a field of that name
    make, parts = value.__reduce__()
    return make(*kept(parts))
