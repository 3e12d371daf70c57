"""Dataclasses of which type checkers, and nothing at run time, see that no field is assigned again.

Stage: represent. A compilation makes a hundred thousand nodes. A class with `dataclass(frozen=True, slots=True)` sets
each field by a call, and takes four times as long to make an object as one that is not frozen (0.8 and 0.2 us, CPython
3.11).

    @dataclass(frozen=True, slots=True)
    class Break:
        loc: Loc | None
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(*, frozen: bool, **options: bool) -> Callable[[type], type]:
        """Return the decorator of the standard library with a hash for a class that is called frozen."""
        return dataclasses.dataclass(unsafe_hash=frozen, **options)
