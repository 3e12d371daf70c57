"""Things that take long to make, such as programs of a device, kept as long as they are among those used last.

Stage: run.

    kernels = Recent[str, Any](256)
    kernel = kernels.get(text, lambda: build(text))
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

K = TypeVar("K")
T = TypeVar("T")


class Recent(Generic[K, T]):
    """The things used last, at most so many, by their keys. One thread at a time calls `get`."""

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
        """Return the thing of this key, made if there is none."""
        value = self._kept.get(key)
        if value is None:
            value = self._kept[key] = make()
            if len(self._kept) > self._most:
                self._release(self._kept.popitem(last=False)[1])
        else:
            self._kept.move_to_end(key)
        return value
