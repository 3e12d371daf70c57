"""Values that belong to one process: `copy` gives the value itself, and `pickle` an error that names the way.

Stage: record, and above.
"""

from __future__ import annotations

from typing import Any, ClassVar, NoReturn, Self

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here


class OfOneProcess:
    """A value that does not change, so that its copies are itself, and that cannot be pickled."""

    _instead_of_pickle: ClassVar[str]
    """The cure that the error names."""

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: Any) -> Self:
        return self

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        raise ShpyTypeError(f"{self!r} cannot be pickled", loc=here(), cure=self._instead_of_pickle)
