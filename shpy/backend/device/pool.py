"""Things that are used again: unused memory of a device, by its kind, and things that take long to make, by their key.

Stage: run. Objects of one kind are interchangeable, so sizes are rounded to few kinds. A run gives an object back when
it ends. An object that a user holds comes back when the user's object is deleted, which may happen in any thread.

    pool = Pool()
    kind = Kind(4096)
    buffer = pool.take(kind, lambda: make(4096))
    pool.give_back(kind, buffer)                 # or else: memory.loan = pool.lend(kind, buffer)

    kernels = Recent[str, Any](256)              # those used last
    kernel = kernels.get(text, lambda: build(text))
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Callable, Hashable
from typing import Any, Final, Generic, NamedTuple, TypeVar

K = TypeVar("K")
T = TypeVar("T")

_MOST: Final = 256 << 20
"""The largest number of unused bytes that a pool keeps."""


class Kind(NamedTuple):
    """A kind of object: all have the same bytes and form, so they are interchangeable."""

    bytes: int
    form: Hashable = None


class Pool:
    """The unused objects of one device. `take` and `give_back` are called by one thread at a time."""

    def __init__(self, release: Callable[[Any], None] = lambda _: None) -> None:
        """Keep at most `_MOST` bytes; `release` frees an object beyond that, by default by dropping the reference."""
        self._release = release
        self._free: defaultdict[Kind, list[Any]] = defaultdict(list)
        self._kept = 0
        self._dropped: list[tuple[Kind, Any]] = []
        """Objects whose owner was deleted."""

    def __len__(self) -> int:
        """Return the number of unused objects."""
        return sum(map(len, self._free.values())) + len(self._dropped)

    def take(self, kind: Kind, make: Callable[[], Any]) -> Any:
        """Return an object of a kind, its contents undefined: an unused one, or else a new one."""
        while self._dropped:
            self.give_back(*self._dropped.pop())
        free = self._free[kind]
        if not free:
            return make()
        self._kept -= kind.bytes
        return free.pop()

    def give_back(self, kind: Kind, thing: Any) -> None:
        """Keep a buffer or texture that is no longer used; release it if the pool is full."""
        if self._kept + kind.bytes > _MOST:
            self._release(thing)
            return
        self._kept += kind.bytes
        self._free[kind].append(thing)

    def lend(self, kind: Kind, thing: Any) -> Loan:
        """Take an object back once the loan that this returns is deleted, with the owner that alone holds it."""
        return Loan(self._dropped, (kind, thing))


class Loan:
    """An object of a pool that an owner holds: a `weakref.finalize` of the owner would cost 1.4 µs, and this 0.3."""

    __slots__ = ("_dropped", "_entry")

    def __init__(self, dropped: list[tuple[Kind, Any]], entry: tuple[Kind, Any]) -> None:
        self._dropped = dropped
        self._entry: tuple[Kind, Any] | None = entry

    def detach(self) -> bool:
        """Leave the object to others for good; return whether it was on loan until now."""
        entry, self._entry = self._entry, None
        return entry is not None

    def __del__(self) -> None:
        entry = getattr(self, "_entry", None)  # there is none where Ctrl-C ended its `__init__`
        if entry is not None:
            self._dropped.append(entry)


class Recent(Generic[K, T]):
    """The objects that were used last, by their keys, at most a fixed number. One thread at a time calls `get`."""

    def __init__(self, most: int, release: Callable[[T], None] = lambda _: None) -> None:
        """Keep at most `most`; `release` frees one beyond that, by default by dropping the reference."""
        self._most, self._release = most, release
        self._kept: OrderedDict[K, T] = OrderedDict()

    def __len__(self) -> int:
        """Return the number of things that are kept."""
        return len(self._kept)

    def __contains__(self, key: K) -> bool:
        """Return whether the thing of this key is kept."""
        return key in self._kept

    def get(self, key: K, make: Callable[[], T]) -> T:
        """Return the object of this key; make it if it is missing."""
        value = self._kept.get(key)
        if value is None:
            value = self._kept[key] = make()
            if len(self._kept) > self._most:
                self._release(self._kept.popitem(last=False)[1])
        else:
            self._kept.move_to_end(key)
        return value


def rounded(extent: int) -> int:
    """Round a size up to a power of two: with few sizes, more requests find an unused object."""
    return 1 << max(extent - 1, 0).bit_length()
