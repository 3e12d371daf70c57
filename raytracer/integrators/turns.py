"""Turns: threads that share a Renderer wait for each other, since its params hold the values of one picture.

Stage: render.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Concatenate, ParamSpec, Protocol, TypeVar


class Turn:
    """A lock that a thread may take several times; copies and pickles of it are other locks, that nobody holds."""

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type[Turn], tuple[()]]:
        return Turn, ()


class LockedOwner(Protocol):
    """An object that threads share, with its lock."""

    turn: Turn


_Owner = TypeVar("_Owner", bound=LockedOwner)
_Given = ParamSpec("_Given")
_Found = TypeVar("_Found")


def in_turn(method: Callable[Concatenate[_Owner, _Given], _Found]) -> Callable[Concatenate[_Owner, _Given], _Found]:
    """Make threads that call a method of the same object wait for each other."""

    @functools.wraps(method)
    def called(self: _Owner, /, *arguments: _Given.args, **named: _Given.kwargs) -> _Found:
        with self.turn:
            return method(self, *arguments, **named)

    return called
