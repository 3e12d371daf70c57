"""The base of sessions: the state of a view that every page has, and its clock.

Stage: view. A worker (`child`) calls a session from one thread; other threads call `wake` alone.

    class Session(Live):
        def next(self):
            if self.playing:
                self.time += self.passed(1 / 60)
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_LONGEST: Final = 0.25
"""The most seconds by which time advances between frames, so that it does not jump after a long computation."""


class Live(ABC):
    """One version of a file, and the frames of it."""

    def __init__(self, request: dict[str, Any], wake: Callable[[], None], backend: str) -> None:
        """`request` names the file and its options; `wake` lets the worker call `woken`, from any thread."""
        self.request, self.wake, self.backend = request, wake, backend
        self.size = (512, 512)
        """Width and height of the page's picture in pixels."""
        self.time, self.frame = 0.0, 0
        self.playing, self.mark = False, False
        self._changed, self._single = True, False
        self._clock = time.monotonic()

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return the description of this version for the page: its names, controls and choices."""

    @abstractmethod
    def files(self) -> list[str]:
        """Return the files whose changes open the file again."""

    @abstractmethod
    def next(self) -> tuple[dict[str, Any], NDArray[np.uint8]] | None:
        """Return the header and the pixels (height, width, 4) of the next frame; None if nothing has changed."""

    @abstractmethod
    def woken(self) -> None:
        """Look for the results of other threads."""

    @abstractmethod
    def answer(self, question: dict[str, Any]) -> tuple[dict[str, Any], Any]:
        """Return the answer to a question about the picture, and its bytes."""

    @abstractmethod
    def cancel(self, page: int | None) -> None:
        """Cancel the long answers that a page waits for; None cancels them for all pages."""

    @abstractmethod
    def explain(self, error: BaseException) -> dict[str, Any]:
        """Return an error for the page."""

    def set(self, changes: dict[str, Any]) -> list[str]:
        """Change the state of the view; return a message for each change that is refused."""
        width, height = changes.get("size", self.size)
        self.size = int(width), int(height)
        self.backend = changes.get("backend") or self.backend
        self.time, self.frame = float(changes.get("time", self.time)), int(changes.get("frame", self.frame))
        self.playing, self.mark = changes.get("playing", self.playing), changes.get("mark", self.mark)
        self._clock = time.monotonic()
        return []

    def reset(self) -> None:
        """Restart at the time 0."""
        self.time, self.frame = 0.0, 0
        self._changed = True

    def step(self) -> None:
        """Advance by one frame."""
        self._single = self._changed = True

    def passed(self, single: float) -> float:
        """Return the seconds since the last frame, or `single` where the user advances frame by frame."""
        now = time.monotonic()
        seconds, self._clock = min(now - self._clock, _LONGEST), now
        return single if self._single else seconds

    def wake_after(self, seconds: float) -> None:
        """Let the worker call `woken` after some seconds."""
        timer = threading.Timer(seconds, self.wake)
        timer.daemon = True
        timer.start()
