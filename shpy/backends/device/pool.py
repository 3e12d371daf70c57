"""Memory of a device that is used again: whatever nobody needs any longer serves the next one who asks for its kind.

Stage: run. Things of one kind can stand for each other, so sizes are rounded to few kinds. A thing is given back by a
run that has ended, or when the object that owns it is gone, which any thread may notice.

    pool = Pool()
    kind = Kind(4096)
    buffer = pool.take(kind, lambda: make(4096))
    pool.give_back(kind, buffer)                 # or else: pool.belong(memory, kind, buffer)
"""

from __future__ import annotations

import weakref
from collections import defaultdict
from collections.abc import Callable, Hashable
from typing import Any, Final, NamedTuple

_MOST: Final = 256 << 20
"""Bytes that a pool keeps of what is not in use."""


class Kind(NamedTuple):
    """A kind of thing: all have so many bytes and one form, so that each can stand for the others."""

    bytes: int
    form: Hashable = None


class Pool:
    """The things of one device that are not in use. `take` and `give_back` are called by one thread at a time."""

    def __init__(self, release: Callable[[Any], None] = lambda _: None) -> None:
        """Keep at most `_MOST` bytes; `release` frees a thing beyond that, which needs no more than to be forgotten."""
        self._release = release
        self._free: defaultdict[Kind, list[Any]] = defaultdict(list)
        self._kept = 0
        self._dropped: list[tuple[Kind, Any]] = []
        """Things whose owner is gone."""

    def __len__(self) -> int:
        """Return the number of things that are not in use."""
        return sum(map(len, self._free.values())) + len(self._dropped)

    def take(self, kind: Kind, make: Callable[[], Any]) -> Any:
        """Return a thing of a kind, whatever it holds: one that is free, or else a new one."""
        while self._dropped:
            self.give_back(*self._dropped.pop())
        if not self._free[kind]:
            return make()
        self._kept -= kind.bytes
        return self._free[kind].pop()

    def give_back(self, kind: Kind, thing: Any) -> None:
        """Keep a buffer or texture that is no longer used; release it if the pool is full."""
        if self._kept + kind.bytes > _MOST:
            self._release(thing)
            return
        self._kept += kind.bytes
        self._free[kind].append(thing)

    def belong(self, owner: object, kind: Kind, thing: Any) -> weakref.finalize[Any, Any]:
        """Take a thing back once its owner is gone, unless the finalizer that this returns is detached."""
        finalizer = weakref.finalize(owner, self._dropped.append, (kind, thing))
        finalizer.atexit = False
        return finalizer


def rounded(extent: int) -> int:
    """Return the next power of two: of things of few sizes, more are found again."""
    return 1 << max(extent - 1, 0).bit_length()
