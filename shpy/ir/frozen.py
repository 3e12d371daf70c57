"""Dataclasses of which type checkers, and nothing at run time, see that no field is assigned again.

Stage: represent. The compilation of a picture makes some ten thousand nodes. CPython 3.11 sets each field of a frozen
object by a call, which takes four times as long as without it: pictures compile for numpy in 0.965 of the time. This
module can go when frozen objects are made as fast.

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
