"""Keep objects in a worker process from task to task, such as the Renderer of a scene.

Stage: cluster.

    with kept(key, lambda: Renderer(scene)) as renderer:
        ...
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

T = TypeVar("T")
KEPT = 2
"""Things that a process keeps."""
_things: OrderedDict[str, tuple[Any, Any]] = OrderedDict()
_making = threading.Lock()


@contextmanager
def kept(key: str, make: Callable[[], T], room: int = KEPT) -> Iterator[T]:
    """Yield the object of a key, to one thread at a time; `make()` makes it once for each process.

    A process keeps the `room` objects that were used last.
    """
    with _making:
        if key not in _things:
            while len(_things) >= room:
                _things.popitem(last=False)
            _things[key] = make(), threading.Lock()
        _things.move_to_end(key)
        thing, lock = _things[key]
    with lock:
        yield thing


def forget() -> None:
    """Drop all objects."""
    _things.clear()
