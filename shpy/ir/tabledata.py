"""The data of a table, as programs hold it and runtimes take it.

Stage: represent. Kept beside the IR because `lang` makes it and `backends` read it.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray


class TableData:
    """`array` is (*shape, size) for vectors, (*shape,) for scalars, of the working dtype; an update brings another one.

    `version` counts updates. A runtime keeps the device's copy by the object's identity (weakly) and uploads again
    only when `version` has changed.
    """

    __slots__ = ("__weakref__", "array", "version")

    def __init__(self, array: NDArray[Any], version: int = 0) -> None:
        self.array = array
        self.version = version
