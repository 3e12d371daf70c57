"""Turns: threads that share a Renderer wait for each other, as its params are those of one picture.

Stage: render.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar


class Shared(Protocol):
    """An object that threads share; `turn` is its lock, which a thread may take several times."""

    turn: AbstractContextManager[Any]


_Owner = TypeVar("_Owner", bound=Shared)
_Given = ParamSpec("_Given")
_Found = TypeVar("_Found")


def in_turn(method: Callable[Concatenate[_Owner, _Given], _Found]) -> Callable[Concatenate[_Owner, _Given], _Found]:
    """Make threads that call a method of the same object wait for each other."""

    @functools.wraps(method)
    def called(self: _Owner, /, *given: _Given.args, **named: _Given.kwargs) -> _Found:
        with self.turn:
            return method(self, *given, **named)

    return called
