"""Things of a process that are made once, whichever thread asks first: devices, their contexts, their memory.

Stage: compile, run. `functools.cache` holds no lock while it calls, so two threads that ask first each make a thing of
their own. With two contexts of one device the streams of one would run on the queue of the other.

    @once
    def space_of(machine: Machine) -> OpenCLSpace:      # other threads wait for the first one, and get its space
        return OpenCLSpace(machine)

    class Machine:
        @once_of_each
        def wrong(self) -> frozenset[str]:              # an attribute, made under `self.lock`
            return self._asked()
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Generic, ParamSpec, Protocol, TypeVar, overload

P = ParamSpec("P")
T = TypeVar("T")


class once(Generic[P, T]):
    """Let a function of hashable, positional arguments make its result once for each; an error is not kept."""

    def __init__(self, make: Callable[P, T]) -> None:
        self._make = make
        self._results: dict[tuple[Any, ...], T] = {}
        self._lock = threading.RLock()
        _all.add(self)

    def __call__(self, *args: P.args, **none: P.kwargs) -> T:
        """Return the result for these arguments; a thread that comes while it is made waits."""
        try:
            return self._results[args]
        except KeyError:
            pass
        with self._lock:
            if args not in self._results:
                self._results[args] = self._make(*args, **none)
            return self._results[args]

    def __len__(self) -> int:
        """Return the number of results."""
        return len(self._results)

    def forget(self) -> None:
        """Make the results anew: for tests."""
        with self._lock:
            self._results.clear()


_all: weakref.WeakSet[once[..., Any]] = weakref.WeakSet()


def _renew_locks() -> None:
    """Replace the locks, in a forked child: a thread that the child does not have may hold one."""
    for each in _all:
        each._lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_locks)


class Lockable(Protocol):
    """An object with a lock that a thread may take twice."""

    @property
    def lock(self) -> AbstractContextManager[Any]:
        """The lock."""


class once_of_each(Generic[T]):
    """An attribute of an object that is made at its first use, under the lock of the object; then a plain one."""

    def __init__(self, make: Callable[[Any], T]) -> None:
        self._make, self._name, self.__doc__ = make, make.__name__, make.__doc__

    @overload
    def __get__(self, instance: None, owner: type) -> once_of_each[T]: ...
    @overload
    def __get__(self, instance: Lockable, owner: type) -> T: ...
    def __get__(self, instance: Lockable | None, owner: type) -> once_of_each[T] | T:
        """Return the value: this is called as long as the object has no attribute of this name."""
        if instance is None:
            return self
        with instance.lock:
            kept = vars(instance)
            if self._name not in kept:
                kept[self._name] = self._make(instance)
            value: T = kept[self._name]
            return value
